"""Describe how stiffness changes in a model of adaptive regression, and how certain that is."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tvsysid.methods.adaptive.model import AdaptiveModel, Switch

CERTAIN, LIKELY = (
    0.995,
    0.8,
)  # probabilities from which on they are not mentioned; and below which something is open


def changes(model: AdaptiveModel) -> list[str]:
    """Describe the changes of stiffness in sentences.

    They say when stiffness switches, in the order of time, whether it changes smoothly, and whether
    a reflex was separated from it.
    """
    switches = [each for each in model.switches if each.quantity == "stiffness"]
    constant = sum(
        row.probability
        for row in model.smoothness
        if (row.quantity, row.kind) == ("stiffness", "none")
    )
    likely = any(each.probability > 0.5 for each in switches)
    lines = [*map(_switch, switches), _smoothly(constant, " between switches" if likely else "")]
    if model.beside is not None:
        lines.append("a stretch reflex is shown, and taken out of it")
    return lines


def _switch(switch: Switch) -> str:
    size = f"by {switch.size:+.1f} ± {1.96 * switch.size_error:.1f} N·m/rad at {switch.time:.3f} s"
    share = f"{100 * switch.probability:.0f} %"
    if switch.probability >= CERTAIN:
        return f"it switches {size}"
    if switch.probability > 0.5:
        return f"it probably switches {size} (probability {share})"
    return f"it may switch {size}, but more likely does not (probability {share})"


def _smoothly(constant: float, where: str) -> str:
    share = max(constant, 1 - constant)
    if share < LIKELY:
        return (
            f"whether it changes smoothly{where} is open (probability {100 * (1 - constant):.0f} %)"
        )
    words = "it is constant" if constant > 0.5 else "it changes smoothly"
    return f"{words}{where}" + (f" (probability {100 * share:.0f} %)" if share < CERTAIN else "")
