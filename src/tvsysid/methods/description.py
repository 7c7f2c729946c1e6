"""Description of a method: its purpose, needs, results, assumptions and settings."""

from __future__ import annotations

from typing import NamedTuple

from tvsysid.methods.registry import parse
from tvsysid.methods.tuning import rounded
from tvsysid.models import IMPEDANCE
from tvsysid.validators import settings_of

NEEDS = {
    "reference": "the disturbance that was applied (channel {0.name!r})",
    "scheduling": "a scheduling variable (channel {0.name!r})",
    "input": "the channel {0.name!r}, in {0.unit}",
}
PURPOSES = {"reference": "closed loops", "scheduling": "a scheduling variable"}


class Description(NamedTuple):
    """Description of a method. Settings are texts such as ``"window = 0.1"``."""

    title: str
    purpose: str
    needs: tuple[str, ...]
    reports: tuple[str, ...]
    assumptions: tuple[str, ...]
    settings: tuple[str, ...]


def describe(text: str) -> Description:
    """Describe a method. Text and errors are those of :func:`parse`.

    Examples
    --------
    >>> describe("birf:reference=disturbance")[1:3]
    ('closed loops', ("the disturbance that was applied (channel 'disturbance')",))
    """
    method = parse(text)
    purpose, reports = "repeated movements", []
    if len(method.pathway_names) > 1:
        purpose, reports = "two pathways", ["the torque of each pathway"]
    needs = [NEEDS[item.kind].format(item) for item in method.inputs]
    for item in method.inputs:
        purpose = PURPOSES.get(item.kind, purpose)
    if method.perturbation:
        purpose = "special perturbations"
        needs.append(f"a perturbation of this kind: {method.perturbation}")
    if method.contiguous:
        needs.append("realizations that follow each other")
    return Description(
        title=method.title,
        purpose=purpose,
        needs=tuple(needs),
        reports=(*dict.fromkeys([*IMPEDANCE, *method.quantities]), *reports),
        assumptions=method.assumptions,
        settings=tuple(f"{name} = {rounded(value)}" for name, value in settings_of(method).items()),
    )
