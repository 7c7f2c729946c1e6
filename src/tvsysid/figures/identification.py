"""What was identified from one recording."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from tvsysid.figures.style import (
    REALIZATION_TIME,
    Array,
    blank,
    curve_with_band,
    legend_below,
    line_key,
    lines,
    remark,
    styled,
)
from tvsysid.models import Model

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Bands = Mapping[str, tuple[Array, Array]]
"""Lower and upper band over time, shape (time,) each, by quantity."""

PANELS = {
    "stiffness": "stiffness (N·m/rad)",
    "viscosity": "viscosity (N·m·s/rad)",
    "inertia": "inertia (kg·m²)",
}


@styled
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
    figure = blank(11.0, 6.0, title)
    # Stiffness has two thirds of the height, viscosity a half: six rows.
    places = figure.subplot_mosaic("KB;KB;KB;KI;VI;VI", sharex=True, width_ratios=[1.6, 1])
    axes = dict(zip((*PANELS, "vaf"), (places[letter] for letter in "KBIV"), strict=True))
    looks = lines(list(models))
    for label, model in models.items():
        hue, style = looks[label]
        for name in PANELS:
            values = getattr(model, name)
            if np.isfinite(values).any():
                curve_with_band(axes[name], model.time, values, bands[label][name], hue, linestyle=style)
        axes["vaf"].plot(model.time, vaf[label], color=hue, linestyle=style, linewidth=1.4)
    for name, words in PANELS.items():
        axes[name].set_ylabel(words)
        _limit(axes[name], np.concatenate([getattr(model, name) for model in models.values()]))
    axes["vaf"].set_ylabel("time-varying VAF (%)")
    axes["vaf"].set_ylim(0, 102)
    for name in ("vaf", "inertia"):
        axes[name].set_xlabel(REALIZATION_TIME)
    for name in ("stiffness", "viscosity"):
        axes[name].tick_params(labelbottom=False)
    legend_below(figure, [line_key(label, color=hue, linestyle=style) for label, (hue, style) in looks.items()])
    return figure


def _limit(axes: Axes, shown: Array) -> None:
    """Limits by what is usual: a method that is out of its depth has spikes, which shall not hide the others."""
    if not np.isfinite(shown).any():
        remark(axes, "not identified")
        return
    low, high = np.nanpercentile(shown, [3, 97])
    room = 0.35 * max(high - low, 0.2 * max(abs(low), abs(high))) or 1.0  # all zero, as where a method prunes
    axes.set_ylim(low - room, high + room)
