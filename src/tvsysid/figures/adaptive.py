"""Figure of adaptive regression: impedance with bands, switches, and probabilities of changes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tvsysid.figures import style
from tvsysid.figures.words import unit_name
from tvsysid.methods.adaptive.model import AdaptiveModel
from tvsysid.signals import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HUES = dict(zip(("stiffness", "viscosity", "inertia", "reflex_gain"), style.PALETTE, strict=False))
MOST = 8  # smooth parts that are listed
WIDE = 0.3  # of the axes, that a switch's label is
LEAST = 0.2  # range of an axis at least, as a share of its largest value


@style.styled
def adaptive_impedance(model: AdaptiveModel, title: str = "") -> Figure:
    """Draw estimates of adaptive regression with bands, switches and probabilities of changes."""
    names = [name for name in HUES if name in model.estimates]
    figure = style.blank(9.0, 1.6 + 1.5 * len(names), title)
    grid = figure.add_gridspec(
        len(names), 2, width_ratios=[2.2, 1], height_ratios=[2.2, *[1] * (len(names) - 1)]
    )
    for row, name in enumerate(names):
        axes = figure.add_subplot(grid[row, 0])
        _over_time(axes, model, name)
        if row == len(names) - 1:
            axes.set_xlabel(style.REALIZATION_TIME)
    _smoothness(figure.add_subplot(grid[:, 1]), model)
    return figure


def _over_time(axes: Axes, model: AdaptiveModel, name: str) -> None:
    estimate, hue = model.estimates[name], HUES[name]
    lower, upper = estimate.band()
    axes.fill_between(model.time, lower, upper, color=hue, alpha=0.25, linewidth=0)
    axes.plot(model.time, estimate.values, color=hue, linewidth=1.5)
    switches = [each for each in model.switches if each.quantity == name]
    axes.set_ylabel(f"{name.replace('_', ' ')}\n({unit_name(estimate.unit)})")
    axes.set_xlim(model.time[0], model.time[-1])
    axes.set_ylim(*_limits(lower, upper, 0.3 * bool(switches)))
    # Level and time of the previous label: labels of close switches alternate in height
    late, last = 0.0, -np.inf
    for switch in switches:
        axes.axvspan(
            switch.earliest,
            switch.latest,
            color=style.GREY,
            alpha=0.3 * switch.probability,
            linewidth=0,
        )
        axes.axvline(
            switch.time, color=style.INK, linestyle="--", linewidth=0.8, alpha=switch.probability
        )
        late = 0.13 - late if switch.time - last < WIDE * model.time[-1] else 0.0
        last = switch.time
        size = f"{switch.size:+.3g}".replace("-", "−")
        text = f" {size} at {switch.time:.3f} s, {100 * switch.probability:.0f} % "
        side = "right" if switch.time > (1 - WIDE) * model.time[-1] else "left"
        axes.annotate(
            text,
            (last, 0.98 - late),
            xycoords=("data", "axes fraction"),
            fontsize=7,
            va="top",
            ha=side,
        )


def _limits(lower: Array, upper: Array, more: float) -> tuple[float, float]:
    """Return limits around a band, wide enough to show a small change as small."""
    low, high = float(np.nanmin(lower)), float(np.nanmax(upper))
    middle, half = (low + high) / 2, max(high - low, LEAST * max(abs(low), abs(high))) / 2 or 1.0
    return middle - 1.1 * half, middle + (1.1 + 2 * more) * half


def _smoothness(axes: Axes, model: AdaptiveModel) -> None:
    rows = [row for row in model.smoothness if row.quantity == "stiffness"][:MOST]
    places = np.arange(len(rows))[::-1]
    axes.barh(places, [100 * row.probability for row in rows], color=HUES["stiffness"], alpha=0.6)
    labels = [
        "none"
        if row.kind == "none"
        else f"{row.kind}: {row.amplitude:.2g} N·m/rad over {row.length:.2g} s"
        for row in rows
    ]
    for place, label in zip(places, labels, strict=True):
        axes.text(1.0, place, label, fontsize=7, va="center")
    axes.set_yticks([])
    # Keep a single bar slim
    axes.set_ylim(len(rows) - max(len(rows), MOST) - 0.5, len(rows) - 0.5)
    axes.set_xlim(0, 100)
    axes.set_xlabel("probability (%)")
    axes.set_title("smooth part of stiffness", fontsize=9)
