"""What was identified from one recording."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tvsysid.figures.style import lines, plain
from tvsysid.models import Model

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Bands = Mapping[str, tuple[Array, Array]]
"""Lower and upper band over time, shape (time,) each, by quantity."""

PANELS = {
    "stiffness": "stiffness (N·m/rad)",
    "viscosity": "viscosity (N·m·s/rad)",
    "inertia": "inertia (kg·m²)",
}


def identified_impedance(
    models: Mapping[str, Model], bands: Mapping[str, Bands], vaf: Mapping[str, Array], title: str = ""
) -> Figure:
    """Stiffness over time by each method, above its time-varying VAF; viscosity and inertia beside them.

    Parameters
    ----------
    models
        By label.
    bands
        Of ``"stiffness"``, ``"viscosity"`` and ``"inertia"``, by label; drawn as shades.
    vaf
        Time-varying VAF in per cent, shape (time,), by label.
    title
        Above all.

    Returns
    -------
    matplotlib.figure.Figure
        Four axes. Viscosity and inertia say so where no method identified them.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415  # heavy

    figure = Figure(figsize=(11.0, 6.0), layout="constrained")
    # Stiffness has two thirds of the height, viscosity a half: six rows.
    rows = ["KB", "KB", "KB", "KI", "VI", "VI"]
    places = figure.subplot_mosaic("\n".join(rows), sharex=True, width_ratios=[1.6, 1])
    axes = dict(zip((*PANELS, "vaf"), (places[letter] for letter in "KBIV"), strict=True))
    looks = lines(list(models))
    for name, words in PANELS.items():
        for label, model in models.items():
            hue, style = looks[label]
            lower, upper = bands[label][name]
            axes[name].fill_between(model.time, lower, upper, color=hue, alpha=0.18, linewidth=0)
            axes[name].plot(model.time, getattr(model, name), color=hue, linestyle=style, linewidth=1.4, label=label)
        plain(axes[name]).set_ylabel(words)
        _limit(axes[name], np.concatenate([getattr(model, name) for model in models.values()]))
    for label, model in models.items():
        hue, style = looks[label]
        axes["vaf"].plot(model.time, vaf[label], color=hue, linestyle=style, linewidth=1.4)
    plain(axes["vaf"]).set_ylabel("time-varying VAF (%)")
    axes["vaf"].set_ylim(0, 102)
    for name in ("vaf", "inertia"):
        axes[name].set_xlabel("time within a realization (s)")
    for name in ("stiffness", "viscosity"):
        axes[name].tick_params(labelbottom=False)
    figure.legend(
        *axes["stiffness"].get_legend_handles_labels(),
        frameon=False,
        loc="outside lower center",
        ncols=max(1, min(len(models), 100 // (6 + max(map(len, models))))),
    )
    figure.suptitle(title, fontsize=11)
    return figure


def _limit(axes: Axes, shown: Array) -> None:
    """Limits by what is usual: a method that is out of its depth has spikes, which shall not hide the others."""
    if not np.isfinite(shown).any():
        axes.text(0.5, 0.5, "not identified", transform=axes.transAxes, ha="center", color="#666666")
        return
    low, high = np.nanpercentile(shown, [3, 97])
    room = 0.35 * max(high - low, 0.2 * max(abs(low), abs(high)))
    axes.set_ylim(low - room, high + room)
