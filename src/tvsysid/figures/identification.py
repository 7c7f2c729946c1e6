"""What was identified from one recording."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from tvsysid.errors import DataQualityWarning
from tvsysid.estimates import IMPEDANCE, UNITS
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
from tvsysid.figures.words import unit_name
from tvsysid.models import Model

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

OVER_TIME = (("time",), ("realization", "time"))


@styled
def identified_impedance(models: Mapping[str, Model], vaf: Mapping[str, Array], title: str = "") -> Figure:
    """Every quantity that the models estimate, with 95 % bands: stiffness above the time-varying VAF, others beside it.

    Parameters
    ----------
    models
        By label.
    vaf
        Time-varying VAF in per cent, shape (time,), by label.
    title
        Above all.

    Returns
    -------
    matplotlib.figure.Figure
        Axes for stiffness, VAF, viscosity, inertia, and each further quantity, which is drawn over its own axis. A
        quantity of the impedance says so where no method identified it. Estimates of single realizations are averaged.
    """
    further = [name for model in models.values() for name in model.estimates if name not in IMPEDANCE]
    beside = [*IMPEDANCE[1:], *dict.fromkeys(further)]
    figure = blank(11.0, max(6.0, 2.2 * len(beside) + 0.8), title)
    grid = figure.add_gridspec(3 * len(beside), 2, width_ratios=[1.6, 1])
    largest = figure.add_subplot(grid[: 2 * len(beside), 0])
    below = figure.add_subplot(grid[2 * len(beside) :, 0], sharex=largest)
    looks = lines(list(models))
    _quantity(largest, "stiffness", models)
    largest.tick_params(labelbottom=False)
    for label, model in models.items():
        hue, style = looks[label]
        below.plot(model.time, vaf[label], color=hue, linestyle=style, linewidth=1.4)
    below.set_ylabel("time-varying VAF (%)")
    below.set_ylim(0, 102)
    below.set_xlabel(REALIZATION_TIME)
    for place, name in enumerate(beside):
        axes = figure.add_subplot(grid[3 * place : 3 * place + 3, 1])
        over = _quantity(axes, name, models)
        axes.set_xlabel(REALIZATION_TIME if over == "time" else over)
        if over == "time":
            axes.sharex(largest)
            if place < len(beside) - 1:
                axes.set_xlabel("")
                axes.tick_params(labelbottom=False)
    legend_below(figure, [line_key(label, color=hue, linestyle=style) for label, (hue, style) in looks.items()])
    return figure


def _quantity(axes: Axes, name: str, models: Mapping[str, Model]) -> str:
    """Draw what every model says of a quantity; return the axis that it is over."""
    shown, unit, over = [np.array([np.nan])], UNITS.get(name, ""), "time"
    for (label, model), (hue, style) in zip(models.items(), lines(list(models)).values(), strict=True):
        estimate = model.estimates.get(name)
        if estimate is None or not np.isfinite(estimate.values).any():
            continue
        unit = estimate.unit
        values, where = model.over_time(name), model.time
        if estimate.axes not in OVER_TIME:
            over = estimate.axes[-1]
            values, where = np.atleast_2d(estimate.values).mean(axis=0), np.asarray(model.coordinates[over])
        band = None
        if estimate.values.ndim == 1:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", DataQualityWarning)  # that there is none
                band = estimate.band()
        curve_with_band(axes, where, values, band, hue, linestyle=style, label=label)
        shown.append(values)
    axes.set_ylabel(f"{name.replace('_', ' ')} ({unit_name(unit)})")
    _limit(axes, np.concatenate(shown))
    return over


def _limit(axes: Axes, shown: Array) -> None:
    """Limits by what is usual: a method that is out of its depth has spikes, which shall not hide the others."""
    if not np.isfinite(shown).any():
        remark(axes, "not identified")
        return
    low, high = np.nanpercentile(shown, [3, 97])
    room = 0.35 * max(high - low, 0.2 * max(abs(low), abs(high))) or 1.0  # all zero, as where a method prunes
    axes.set_ylim(low - room, high + room)
