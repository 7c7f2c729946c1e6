"""What was identified from one recording, and how settings were chosen."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from tvsysid.errors import DataQualityWarning
from tvsysid.estimates import IMPEDANCE, UNITS
from tvsysid.figures import style
from tvsysid.figures.words import unit_name
from tvsysid.methods import Evidence
from tvsysid.models import Model
from tvsysid.numerics import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

OVER_TIME = (("time",), ("realization", "time"))


@style.styled
def identified_impedance(models: Mapping[str, Model], vaf: Mapping[str, Array], title: str = "") -> Figure:
    """Every quantity that the models estimate, with 95 % bands: stiffness above the time-varying VAF, others beside it.

    The first of the models is in front, with a thicker line.

    Axes for stiffness, VAF, viscosity, inertia, and each further quantity, which is drawn over its own axis. A quantity
    of the impedance says so where no method identified it. Estimates of single realizations are averaged.

    Parameters
    ----------
    models, vaf
        By label: the models, and their time-varying VAF in per cent, shape (time,); no axes for it if it is empty.
    """
    further = [name for model in models.values() for name in model.estimates if name not in IMPEDANCE]
    beside = [*IMPEDANCE[1:], *dict.fromkeys(further)]
    figure = style.blank(11.0, max(6.0, 2.2 * len(beside) + 0.8), title)
    grid = figure.add_gridspec(3 * len(beside), 2, width_ratios=[1.6, 1])
    largest = figure.add_subplot(grid[: 2 * len(beside) if vaf else 3 * len(beside), 0])
    looks = style.lines(list(models))
    draw_quantity(largest, "stiffness", models)
    if vaf:
        largest.tick_params(labelbottom=False)
        _varying_vaf(figure.add_subplot(grid[2 * len(beside) :, 0], sharex=largest), models, vaf)
    else:
        largest.set_xlabel(style.REALIZATION_TIME)
    for place, name in enumerate(beside):
        axes = figure.add_subplot(grid[3 * place : 3 * place + 3, 1])
        over = draw_quantity(axes, name, models)
        axes.set_xlabel(style.REALIZATION_TIME if over == "time" else over)
        if over == "time":
            axes.sharex(largest)
            if place < len(beside) - 1:
                axes.set_xlabel("")
                axes.tick_params(labelbottom=False)
    style.legend_below(
        figure, [style.line_key(label, color=hue, linestyle=dash) for label, (hue, dash) in looks.items()]
    )
    return figure


def _varying_vaf(axes: Axes, models: Mapping[str, Model], vaf: Mapping[str, Array]) -> None:
    looks = style.lines(list(models))
    for label, model in reversed(list(models.items())):
        hue, dash = looks[label]
        axes.plot(model.time, vaf[label], color=hue, linestyle=dash, linewidth=_width(label, models))
    if not any(np.isfinite(vaf[label]).any() for label in models):
        style.remark(axes, "takes several realizations")
    axes.set_ylabel("time-varying VAF (%)")
    axes.set_ylim(0, 102)
    axes.set_xlabel(style.REALIZATION_TIME)


def draw_quantity(axes: Axes, name: str, models: Mapping[str, Model]) -> str:
    """Draw what every model says of a quantity; return the axis that it is over."""
    shown, unit, over = [np.array([np.nan])], UNITS.get(name, ""), "time"
    band: list[Array] | None = None
    looks = style.lines(list(models))
    for label, model in reversed(list(models.items())):
        estimate, (hue, dash) = model.estimates.get(name), looks[label]
        if estimate is None or not np.isfinite(estimate.values).any():
            continue
        unit = estimate.unit
        values, where = model.over_time(name), model.time
        if estimate.axes not in OVER_TIME:
            over = estimate.axes[-1]
            values, where = np.atleast_2d(estimate.values).mean(axis=0), np.asarray(model.coordinates[over])
        band = None
        if estimate.values.size == len(values):  # no mean over realizations
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", DataQualityWarning)  # that there is none
                band = [limit.ravel() for limit in estimate.band()]
        look = {"linestyle": dash, "linewidth": _width(label, models), "label": label}
        style.curve_with_band(axes, where, values, band, hue, **look)
        shown.append(values)
    axes.set_ylabel(f"{name.replace('_', ' ')} ({unit_name(unit)})")
    _limit(axes, np.concatenate(shown), band)  # that of the first model
    return over


def _width(label: str, models: Mapping[str, Model]) -> float:
    """Of a line: the first of several methods stands out."""
    return 2.2 if len(models) > 1 and label == next(iter(models)) else 1.4


def _limit(axes: Axes, shown: Array, band: list[Array] | None) -> None:
    """Limits by what is usual: a method that is out of its depth has spikes, which shall not hide the others.

    The ``band`` of the one in front is shown.
    """
    if not np.isfinite(shown).any():
        style.remark(axes, "not identified")
        return
    low, high = np.nanpercentile(shown, [3, 97])
    room = 0.35 * max(high - low, 0.2 * max(abs(low), abs(high))) or 1.0  # all zero, as where a method prunes
    low, high = low - room, high + room
    if band is not None and np.isfinite(band).any():
        lower, upper = np.nanpercentile(band[0], 3), np.nanpercentile(band[1], 97)
        low, high = min(low, 1.1 * lower - 0.1 * upper), max(high, 1.1 * upper - 0.1 * lower)
    axes.set_ylim(low, high)


@style.styled
def tuning_curves(evidence: Mapping[str, Evidence], title: str = "") -> Figure:
    """By how much all settings that were tried are worse than the best; axes for each method, three side by side."""
    columns = min(len(evidence), 3)
    rows = -(-len(evidence) // columns)
    figure, grid = style.panels(rows, columns, 0.6 + 3.6 * columns, 0.4 + 3.6 * rows, title)
    for axes, (label, item) in zip(grid.flat, evidence.items(), strict=False):
        _tried(axes, item)
        axes.set_title(label)
    for axes in grid.flat[len(evidence) :]:
        axes.remove()
    return figure


def _tried(axes: Axes, evidence: Evidence) -> None:
    values = evidence.values
    worse = np.nanmax(values) - values if evidence.better == "higher" else values - np.nanmin(values)
    for number, name in enumerate(dict.fromkeys(evidence.lines[1:])):
        on_line = np.array([place for place, line in enumerate(evidence.lines) if line == name])
        on_line = on_line[np.argsort(evidence.positions[on_line], kind="stable")]
        axes.plot(
            evidence.positions[on_line],
            worse[on_line],
            color=style.PALETTE[number % len(style.PALETTE)],
            linestyle=style.STYLES[number // 4 % len(style.STYLES)],
            linewidth=1.2,
            marker=".",
            label=name or "tried",
        )
    kept = "kept: nothing is clearly better" if evidence.chosen == 0 else "chosen"
    for name, place, marker, size in (("as given", 0, "o", 9), (kept, evidence.chosen, "*", 11)):
        axes.plot(
            evidence.positions[place],
            worse[place],
            color=style.TRUTH,
            marker=marker,
            markersize=size,
            markerfacecolor="none" if marker == "o" else style.TRUTH,
            linestyle="none",
            label=name,
        )
    if evidence.positions.min() > 0 and evidence.positions.max() > 20 * evidence.positions.min():
        axes.set_xscale("log")
    axes.set_yscale("symlog", linthresh=1.0)
    axes.set_ylim(-0.3, 3 * max(float(np.nanmax(worse)), 1.0))
    axes.set_xlabel(evidence.axis)
    axes.set_ylabel(f"worse than the best by ({evidence.unit})")
    axes.legend(fontsize=7)
