"""Figure of adaptive regression: impedance with bands, switches, and probabilities of changes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid.figures import style
from tvsysid.figures.words import unit_name
from tvsysid.methods.adaptive.model import AdaptiveModel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HUES = dict(zip(("stiffness", "viscosity", "inertia", "reflex_gain"), style.PALETTE, strict=False))
MAX_LISTED = 8  # smooth parts
LABEL_WIDTH = 0.3  # of a switch, as a share of the axes
MIN_RANGE = 0.2  # of an axis, as a share of its largest value


@style.styled
def adaptive_impedance(model: AdaptiveModel, title: str = "") -> Figure:
    """Draw estimates of adaptive regression with bands, switches and probabilities of changes."""
    names = [name for name in HUES if name in model.estimates]
    figure = style.blank(9.0, 1.6 + 1.5 * len(names), title)
    heights = [2.2, *[1.0] * (len(names) - 1)]
    grid = figure.subplot_mosaic(
        [[name, "probability"] for name in names], width_ratios=[2.2, 1], height_ratios=heights
    )
    for name in names:
        _over_time(grid[name], model, name)
    grid[names[-1]].set_xlabel(style.REALIZATION_TIME)
    _probabilities(grid["probability"], model)
    return figure


def _over_time(axes: Axes, model: AdaptiveModel, name: str) -> None:
    estimate, time = model.estimates[name], model.time
    band = np.stack(estimate.band())
    style.curve_with_band(axes, time, estimate.values, band, HUES[name])
    switches = [switch for switch in model.switches if switch.quantity == name]
    axes.set_ylabel(f"{name.replace('_', ' ')}\n({unit_name(estimate.unit)})")
    axes.set_xlim(time[0], time[-1])
    low, high = float(np.nanmin(band)), float(np.nanmax(band))
    span = max(high - low, MIN_RANGE * max(abs(low), abs(high))) or 1.0
    room = 0.3 * span if switches else 0.0  # for labels
    axes.set_ylim((low + high - 1.1 * span) / 2, (low + high + 1.1 * span) / 2 + room)
    for number, switch in enumerate(switches):
        faint = {"alpha": 0.3 * switch.probability, "linewidth": 0}
        axes.axvspan(switch.earliest, switch.latest, color=style.GREY, **faint)
        line: dict[str, Any] = {"linestyle": "--", "linewidth": 0.8, "alpha": switch.probability}
        axes.axvline(switch.time, color=style.INK, **line)
        size = f"{switch.size:+.3g}".replace("-", "−")
        # Labels of neighbours alternate in height.
        axes.annotate(
            f" {size} at {switch.time:.3f} s, {100 * switch.probability:.0f} % ",
            (switch.time, 0.98 - 0.13 * (number % 2)),
            xycoords=("data", "axes fraction"),
            fontsize=7,
            va="top",
            ha="right" if switch.time > (1 - LABEL_WIDTH) * time[-1] else "left",
        )


def _probabilities(axes: Axes, model: AdaptiveModel) -> None:
    """Draw the probability of each smooth part of the stiffness."""
    rows = [row for row in model.smoothness if row.quantity == "stiffness"][:MAX_LISTED]
    for place, row in enumerate(rows):
        label = f"{row.kind}: {row.amplitude:.2g} N·m/rad over {row.length:.2g} s"
        axes.barh(place, 100 * row.probability, color=HUES["stiffness"], alpha=0.6)
        axes.text(1.0, place, "none" if row.kind == "none" else label, fontsize=7, va="center")
    axes.set_yticks([])
    axes.set_ylim(MAX_LISTED - 0.5, -0.5)
    axes.set_xlim(0, 100)
    axes.set_xlabel("probability (%)")
    axes.set_title("smooth part of stiffness")
