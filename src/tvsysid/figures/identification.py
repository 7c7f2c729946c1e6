"""What was identified from one recording, and how settings were chosen."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid.dataset_layout import UNITS
from tvsysid.figures import style
from tvsysid.figures.words import unit_name, wrapped
from tvsysid.methods import Evidence
from tvsysid.models import IMPEDANCE, OVER_TIME, Model
from tvsysid.numerics import Array
from tvsysid.signals import Ensemble

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BINS = 40


@style.styled
def identified_impedance(
    models: Mapping[str, Model], vaf: Mapping[str, Array], title: str = "", but_over: str = ""
) -> Figure:
    """Draw every quantity of the models with 95 % bands: stiffness above its VAF, others beside it.

    The first of the models is in front, with a thicker line.

    Axes for stiffness, VAF, viscosity, inertia, and each further quantity, which is drawn over its
    own axis. A quantity of the impedance says so where no method identified it. Estimates of single
    realizations are averaged.

    Parameters
    ----------
    models, vaf
        By label: the models, and their time-varying VAF in per cent, shape (time,); no axes for it
        if it is empty.
    but_over
        Variable over which nothing is drawn, because :func:`scheduled_estimates` does.
    """
    beside = drawn_quantities(models, but_over)[1:]
    left = ["stiffness", "stiffness", "VAF" if vaf else "stiffness"]
    figure = style.blank(11.0, max(6.0, 2.2 * len(beside) + 0.8), title)
    rows = range(3 * len(beside))
    mosaic: Any = [[left[row // len(beside)], beside[row // 3]] for row in rows]
    grid = figure.subplot_mosaic(mosaic, width_ratios=[1.6, 1])
    for name in ("stiffness", *beside):
        over = draw_quantity(grid[name], name, models)
        grid[name].set_xlabel(style.REALIZATION_TIME if over == "time" else over)
    if vaf:
        grid["stiffness"].set_xlabel("")
        looks = style.lines(list(models))
        for number, (label, look) in reversed(list(enumerate(looks.items()))):
            time = models[label].time
            curve = look.curve(len(time), number, len(models))
            grid["VAF"].plot(time, vaf[label], linewidth=_width(number, models), **curve)
        grid["VAF"].set_ylabel("time-varying VAF (%)")
        grid["VAF"].set_ylim(0, 102)
        grid["VAF"].set_xlabel(style.REALIZATION_TIME)
    style.legend_below(figure, style.method_keys(list(models)))
    return figure


def drawn_quantities(models: Mapping[str, Model], but_over: str = "") -> list[str]:
    """Return the names of the quantities to draw, stiffness first."""
    further = [
        name
        for model in models.values()
        for name, estimate in model.estimates.items()
        if estimate.axes != (but_over,)
    ]
    return list(dict.fromkeys([*IMPEDANCE, *further]))


@style.styled
def identified_quantity(
    models: Mapping[str, Model],
    name: str = "stiffness",
    title: str = "",
    simultaneous: bool = False,
) -> Figure:
    """Draw one quantity over time by the models, with 95 % bands, pointwise or ``simultaneous``."""
    figure, axes = style.panels(1, 1, 6.4, 3.4, title)
    over = draw_quantity(axes[0, 0], name, models, simultaneous)
    axes[0, 0].set_xlabel(style.REALIZATION_TIME if over == "time" else over)
    return figure


def draw_quantity(
    axes: Axes, name: str, models: Mapping[str, Model], simultaneous: bool = False
) -> str:
    """Draw a quantity by every model that estimates it; return the axis that it is over.

    The roughest curve is behind, the first model in front.
    """
    unit, over = UNITS.get(name, ""), "time"
    known = {
        label: model.estimates[name].values
        for label, model in models.items()
        if name in model.estimates and np.isfinite(model.estimates[name].values).any()
    }
    behind = sorted(known, key=lambda label: -float(np.nansum(np.abs(np.diff(known[label])))))
    behind.sort(key=lambda label: label == next(iter(models)))
    drawn: list[Array] = []
    ends = np.zeros(0)
    looks = style.lines(list(models))
    for label in behind:
        model, number = models[label], list(models).index(label)
        estimate = model.estimates[name]
        unit, values, where = estimate.unit, model.over_time(name), model.time
        if estimate.axes not in OVER_TIME:
            over = estimate.axes[-1]
            values = np.atleast_2d(estimate.values).mean(axis=0)
            where = np.asarray(model.coordinates[over])
        # A mean over realizations has no band.
        single = estimate.values.size == len(values)
        band = np.stack([np.ravel(each) for each in estimate.limits(simultaneous=simultaneous)])
        curve = looks[label].curve(len(values), number, len(models)) | {"label": label}
        style.curve_with_band(
            axes,
            where,
            values,
            band if single and np.isfinite(band).any() else None,
            looks[label].hue,
            0.14 if number else 0.3,
            linewidth=_width(number, models),
            **curve,
        )
        drawn.append(values)
        ends = np.nanpercentile(band, [2, 98]) if single and np.isfinite(band).any() else ends
    axes.set_ylabel(f"{name.replace('_', ' ')} ({unit_name(unit)})")
    if not drawn:
        style.remark(axes, "not identified")
        return over
    low, high = style.usual_limits(drawn, ends)
    # What hardly changes shall not look as if it did.
    room = max(0.0, 0.15 * max(abs(low), abs(high)) - (high - low)) / 2
    axes.set_ylim(low - room, high + room)
    return over


def _width(number: int, models: Mapping[str, Model]) -> float:
    """Return the width of a line: the first of several methods stands out."""
    return 2.2 if len(models) > 1 and number == 0 else 0.9


def variable_of(models: Mapping[str, Model], ensemble: Ensemble) -> str:
    """Name the first channel that a model estimates something over; nothing if there is none."""
    axes = [estimate.axes for model in models.values() for estimate in model.estimates.values()]
    return next((over[0] for over in axes if len(over) == 1 and over[0] in ensemble.channels), "")


@style.styled
def scheduled_estimates(
    models: Mapping[str, Model], ensemble: Ensemble, variable: str, title: str = ""
) -> Figure:
    """Draw each quantity over a variable, with 95 % bands, above a histogram of the variable.

    Parameters
    ----------
    models
        By label; one at least estimates something over the ``variable``.
    ensemble
        With the variable as a channel.
    """
    estimated = {
        name: None
        for model in models.values()
        for name, estimate in model.estimates.items()
        if estimate.axes == (variable,)
    }
    names = list(estimated)
    figure, grid = style.panels(len(names) + 1, 1, 6.2, 2.2 * len(names) + 2.0, title, sharex=True)
    for axes, name in zip(grid[:, 0], names, strict=False):
        draw_quantity(axes, name, models)
    values = ensemble.signal(variable)[:, ensemble.core].ravel()
    below, weight = grid[-1, 0], np.full(len(values), 1 / ensemble.sampling_rate)
    below.hist(values, BINS, weights=weight, color=style.GREY)
    below.set_xlabel(variable)
    below.set_ylabel("time spent there (s)")
    figure.align_ylabels(grid)
    style.legend_below(figure, style.method_keys(list(models)))
    return figure


@style.styled
def tuning_curves(evidence: Mapping[str, Evidence], title: str = "") -> Figure:
    """Draw by how much all settings tried are worse than the best.

    Axes for each method, three side by side.
    """
    columns = min(len(evidence), 3)
    rows = -(-len(evidence) // columns)
    figure, grid = style.panels(rows, columns, 0.6 + 3.6 * columns, 0.4 + 4.2 * rows, title)
    for axes, (label, item) in zip(grid.flat, evidence.items(), strict=False):
        _tried(axes, item)
        axes.set_title(wrapped(label, 44))
    for axes in grid.flat[len(evidence) :]:
        axes.remove()
    return figure


def _tried(axes: Axes, evidence: Evidence) -> None:
    values, positions = evidence.values, evidence.positions
    best = np.nanmax(values) if evidence.better == "higher" else np.nanmin(values)
    worse = np.abs(values - best)
    for number, name in enumerate(dict.fromkeys(evidence.lines[1:])):
        on_line = np.flatnonzero([line == name for line in evidence.lines])
        on_line = on_line[np.argsort(positions[on_line], kind="stable")]
        axes.plot(
            positions[on_line],
            worse[on_line],
            color=style.PALETTE[number % len(style.PALETTE)],
            linestyle=style.STYLES[number // 4 % len(style.STYLES)],
            linewidth=1.2,
            marker=style.MARKERS[number % len(style.MARKERS)],
            markersize=3.5,
            label=name or "tried",
        )
    kept = "kept: nothing is clearly better" if evidence.chosen == 0 else "chosen"
    for name, place, marker, face in (
        ("as given", 0, "o", "none"),
        (kept, evidence.chosen, "*", style.INK),
    ):
        look: dict[str, Any] = {
            "color": style.INK,
            "markerfacecolor": face,
            "markersize": 10,
            "linestyle": "",
        }
        axes.plot(positions[place], worse[place], marker=marker, label=name, **look)
    if positions.min() > 0 and positions.max() > 20 * positions.min():
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter("{x:g}")
    axes.set_yscale("symlog", linthresh=1.0)
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_ylim(-0.3, 3 * max(float(np.nanmax(worse)), 1.0))
    axes.set_xlabel(evidence.axis)
    axes.set_ylabel(f"worse than the best by ({evidence.unit})")
    axes.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2)
