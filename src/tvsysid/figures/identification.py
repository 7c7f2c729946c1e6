"""What was identified from one recording, and how settings were chosen."""

from __future__ import annotations

from collections.abc import Mapping
from textwrap import fill
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tvsysid.dataset_layout import UNITS
from tvsysid.figures import style
from tvsysid.figures.words import unit_name
from tvsysid.methods import Evidence
from tvsysid.models import IMPEDANCE, OVER_TIME, Estimate, Model
from tvsysid.numerics import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


LETTERS = 44  # of a title above axes of 3.6 inches
REMARK_LETTERS = 64  # of a line of a remark within these axes
# multiple of the upper quartile of the methods' reaches beyond which one is drawn by thin lines
WIDE = 1.6


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
        figure, [style.line_key(label, **look.line) for label, look in looks.items()]
    )
    return figure


def drawn_quantities(models: Mapping[str, Model], but_over: str = "") -> list[str]:
    """Return the names of the quantities to draw, stiffness first."""
    every = [each for model in models.values() for each in model.estimates.items()]
    further = [
        name for name, estimate in every if name not in IMPEDANCE and estimate.axes != (but_over,)
    ]
    return [*IMPEDANCE, *dict.fromkeys(further)]


def _varying_vaf(axes: Axes, models: Mapping[str, Model], vaf: Mapping[str, Array]) -> None:
    looks = style.lines(list(models))
    for label, model in reversed(list(models.items())):
        curve = looks[label].curve(len(model.time), list(models).index(label), len(models))
        axes.plot(model.time, vaf[label], linewidth=_width(label, models), **curve)
    axes.set_ylabel("time-varying VAF (%)")
    axes.set_ylim(0, 102)
    axes.set_xlabel(style.REALIZATION_TIME)


class Found(NamedTuple):
    """What a method says of a quantity: values and the edges of their band, over an axis."""

    where: Array
    values: Array
    band: list[Array] | None

    @property
    def extent(self) -> tuple[float, float]:
        """Lowest and highest of what is drawn, but for single spikes."""
        if self.band is None:
            return _extent(self.values)
        return _extent(self.band[0])[0], _extent(self.band[1])[1]


def _extent(values: Array) -> tuple[float, float]:
    low, high = np.nanpercentile(values, [2, 98])
    return float(low), float(high)


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
    """Draw what every model says of a quantity; return the axis that it is over."""
    unit, over = UNITS.get(name, ""), "time"
    found: dict[str, Found] = {}
    for label, model in models.items():
        estimate = model.estimates.get(name)
        if estimate is None or not np.isfinite(estimate.values).any():
            continue
        unit = estimate.unit
        values, where = model.over_time(name), model.time
        if estimate.axes not in OVER_TIME:
            over = estimate.axes[-1]
            values, where = (
                np.atleast_2d(estimate.values).mean(axis=0),
                np.asarray(model.coordinates[over]),
            )
        found[label] = Found(where, values, _band(estimate, len(values), simultaneous))
    axes.set_ylabel(f"{name.replace('_', ' ')} ({unit_name(unit)})")
    if not found:
        style.remark(axes, "not identified")
        return over
    looks, wide = style.lines(list(models)), _wide(found)
    for label in _behind_to_front(found):
        where, values, band = found[label]
        look = looks[label].curve(len(values), list(models).index(label), len(models)) | {
            "label": label
        }
        look |= (
            {"linewidth": 0.7, "zorder": 1.2}
            if label in wide
            else {"linewidth": _width(label, models)}
        )
        opacity = style.EDGES if label in wide else 0.3 if label == next(iter(models)) else 0.14
        style.curve_with_band(axes, where, values, band, looks[label].hue, opacity, **look)
    _limit(axes, found, wide)
    return over


def _band(estimate: Estimate, samples: int, simultaneous: bool) -> list[Array] | None:
    if estimate.values.size != samples:  # a mean over realizations
        return None
    edges = [limit.ravel() for limit in estimate.limits(simultaneous=simultaneous)]
    return edges if np.isfinite(edges[0]).any() else None


def _width(label: str, models: Mapping[str, Model]) -> float:
    """Return the style of a line: the first of several methods stands out."""
    return 2.2 if len(models) > 1 and label == next(iter(models)) else 1.2


def _behind_to_front(found: Mapping[str, Found]) -> list[str]:
    """Return the order of drawing: the roughest curve behind, the first method in front."""
    first, *others = found
    return [
        *sorted(others, key=lambda label: -float(np.nansum(np.abs(np.diff(found[label].values))))),
        first,
    ]


def _wide(found: Mapping[str, Found]) -> set[str]:
    """Return the methods with outlying ranges, which would hide the others.

    Never the first.
    """
    if len(found) < 3:
        return set()
    reaches = np.array(
        [[np.ptp(_extent(each.values)), np.ptp(each.extent)] for each in found.values()]
    )
    wide = (reaches > WIDE * np.percentile(reaches, 75, axis=0)).any(axis=1)
    return {label for label, far in list(zip(found, wide, strict=True))[1:] if far}


def _limit(axes: Axes, found: Mapping[str, Found], wide: set[str]) -> None:
    """Set limits by the first method's band and by the others. Say which are cut as outliers."""
    extents = [next(iter(found.values())).extent]
    extents += [_extent(each.values) for label, each in found.items() if label not in wide]
    low, high = min(low for low, _ in extents), max(high for _, high in extents)
    # Show narrow bands whole
    whole = [each.extent for label, each in found.items() if label not in wide]
    span = high - low
    low, high = (
        max(min(low for low, _ in whole), low - span),
        min(max(high for _, high in whole), high + span),
    )
    # What hardly changes shall not look as if it did.
    room = max(0.15 * (high - low), (0.15 * max(abs(low), abs(high)) - (high - low)) / 2) or 1.0
    axes.set_ylim(low - room, high + room)
    reached = {
        label: (np.nanmin(each.values), np.nanmax(each.values)) for label, each in found.items()
    }
    cut = [
        f"{label} ({least:.4g} to {most:.4g})"
        for label, (least, most) in reached.items()
        if least < low - room or most > high + room
    ]
    if cut:
        text = fill(f"cut off: {', '.join(cut)}", REMARK_LETTERS)
        paper = {"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1.5}
        told = axes.text(
            0.01,
            0.99,
            text.replace("-", "−"),
            transform=axes.transAxes,
            va="top",
            fontsize=7,
            bbox=paper,
        )
        told.set_in_layout(False)


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
        axes.set_title(fill(label, LETTERS))
    for axes in grid.flat[len(evidence) :]:
        axes.remove()
    return figure


def _tried(axes: Axes, evidence: Evidence) -> None:
    values = evidence.values
    worse = (
        np.nanmax(values) - values if evidence.better == "higher" else values - np.nanmin(values)
    )
    for number, name in enumerate(dict.fromkeys(evidence.lines[1:])):
        on_line = np.array([place for place, line in enumerate(evidence.lines) if line == name])
        on_line = on_line[np.argsort(evidence.positions[on_line], kind="stable")]
        axes.plot(
            evidence.positions[on_line],
            worse[on_line],
            color=style.PALETTE[number % len(style.PALETTE)],
            linestyle=style.STYLES[number // 4 % len(style.STYLES)],
            linewidth=1.2,
            marker=style.MARKERS[number % len(style.MARKERS)],
            markersize=3.5,
            label=name or "tried",
        )
    kept = "kept: nothing is clearly better" if evidence.chosen == 0 else "chosen"
    for name, place, marker, size in (("as given", 0, "o", 9), (kept, evidence.chosen, "*", 11)):
        axes.plot(
            evidence.positions[place],
            worse[place],
            color=style.INK,
            marker=marker,
            markersize=size,
            markerfacecolor="none" if marker == "o" else style.INK,
            linestyle="none",
            label=name,
        )
    if evidence.positions.min() > 0 and evidence.positions.max() > 20 * evidence.positions.min():
        axes.set_xscale("log")
    axes.set_yscale("symlog", linthresh=1.0)
    axes.set_ylim(-0.3, 3 * max(float(np.nanmax(worse)), 1.0))
    axes.set_xlabel(evidence.axis)
    axes.set_ylabel(f"worse than the best by ({evidence.unit})")
    axes.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2)
