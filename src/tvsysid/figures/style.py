"""One look for all figures, and what several of them draw."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import ContextDecorator
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import pyplot, rc_params_from_file
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.style import context
from matplotlib.ticker import LogLocator
from numpy.typing import ArrayLike, NDArray

from tvsysid.errors import printable
from tvsysid.figures.saving import LOOK, drawn, size_in_pixels
from tvsysid.methods import METHODS, key_of
from tvsysid.numerics import Array
from tvsysid.numerics.bands import mean_and_spread

if TYPE_CHECKING:
    import pandas as pd

# Each colour has a contrast of 3:1 or more on white. The first six differ by 19 or more (CIEDE2000)
# to all eyes, also without one kind of cone (Machado et al. 2009), the next three by 11, the last
# by 8. Markers tell methods apart as well.
PALETTE: list[str] = rc_params_from_file(LOOK, use_default_template=False)[
    "axes.prop_cycle"
].by_key()["color"]
TRUTH = "#5E5E5E"  # wide and behind: as far from every method as they are from each other
INK = "#444444"  # lines that are no data: limits, means, zero
TARGET = "#111111"  # the torque to be followed
KEPT = "#B8B8B8"  # realizations that were kept
TRUE_LINE: dict[str, Any] = {"color": TRUTH, "linewidth": 2.6, "label": "truth"}
TARGET_LINE: dict[str, Any] = {"color": TARGET, "linewidth": 0.8, "label": "torque to be followed"}
REALIZATION_TIME = "time within a realization (s)"
STYLES = ("-", "--", ":", "-.")
FILLS = ("full", "none", "left", "top")
MARKERS = "osD^vPX<>hp*8dH"
MARKERS_PER_CURVE = 8
MAX_REACH = 0.75  # of the median range of the curves, by which axes extend beyond it
MARGINS = 0.8, 1.1  # of a figure, in inches
LEGEND_ENTRY = 0.6, 0.07  # width in inches, without text and of a letter

styled: ContextDecorator = context(LOOK)
"""Decorator of a function that draws a figure: it draws in the common look."""


class OwnFigure(Figure):
    """Figure that a notebook shows once, whatever its backend."""

    def _repr_mimebundle_(self, **_: object) -> tuple[dict[str, bytes], dict[str, Any]]:
        pyplot.close(self)  # a notebook would show it again at the end of the cell
        width, height = size_in_pixels(self)
        size = {"width": width, "height": height}
        return {"image/png": drawn(self, "png")}, {"image/png": size}


def blank(width: float, height: float, title: str = "") -> Figure:
    """Return a figure of a size in inches without axes."""
    figure = OwnFigure(figsize=(width, height), layout="constrained")
    figure.suptitle(printable(title))
    return figure


def panels(
    title: str,
    size: tuple[float, float],
    ylabels: Sequence[str] = ("",),
    headings: Sequence[str] = ("",),
    *args: Any,
    **words: Any,
) -> tuple[Figure, NDArray[Any]]:
    """Return a figure, and its axes as of :func:`grid_of`, each of a size in inches."""
    width, height = np.multiply(size, (len(headings), len(ylabels))) + MARGINS
    figure = blank(width, height, title)
    return figure, grid_of(figure, ylabels, headings, *args, **words)


def grid_of(
    figure: Any, ylabels: Sequence[str], headings: Sequence[str], xlabel: str = "", **words: Any
) -> NDArray[Any]:
    """Return new axes of a figure or a part of it, labelled on the left, above and below.

    A row for each of the ``ylabels``, a column for each of the headings. Further words as of
    ``Figure.subplots``.
    """
    grid: NDArray[Any] = figure.subplots(len(ylabels), len(headings), squeeze=False, **words)
    for axes, label in zip(grid[:, 0], ylabels, strict=True):
        axes.set_ylabel(label)
    for axes, heading in zip(grid[0], headings, strict=True):
        axes.set_title(heading)
    for axes in grid[-1]:
        axes.set_xlabel(xlabel)
    return grid


def finish(figure: Figure, caption: str | None = None) -> Figure:
    """Draw a legend of all that has a label, below all axes; return the figure."""
    entries: dict[str, Any] = {}
    for axes in figure.axes:
        handles, labels = axes.get_legend_handles_labels()
        entries |= dict(zip(labels, handles, strict=True))
    if entries or caption:
        room, letter = LEGEND_ENTRY
        width = room + letter * max(map(len, entries), default=0)
        columns = max(1, int(figure.get_figwidth() / width))
        figure.legend(
            entries.values(), entries, loc="outside lower center", ncols=columns, title=caption
        )
    # To align axes without a label, too, would take an eighth of the time of drawing.
    figure.align_ylabels([axes for axes in figure.axes if axes.get_ylabel()])
    return figure


def lines(methods: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return settings of Matplotlib for the line of each method, by its label.

    Colour and marker are a method's own. Further settings of it have another dash and filling.
    Methods of one's own have the last colours. A method that is shown alone has no marker.
    """
    # The label of a method object is its repr.
    classes = {method.__name__: key for key, method in METHODS.items()}
    keys = [classes.get(label.partition("(")[0], key_of(label)) for label in methods]
    places = {key: place for place, key in enumerate(METHODS)}
    own = [key for key in dict.fromkeys(keys) if key not in places]
    places |= {key: -1 - place % len(PALETTE) for place, key in enumerate(own)}
    looks = {}
    for number, (label, key) in enumerate(zip(methods, keys, strict=True)):
        color, variant = PALETTE[places[key]], keys[:number].count(key)
        looks[label] = {
            "label": label,
            "color": color,
            "linestyle": STYLES[variant % len(STYLES)],
            "fillstyle": FILLS[variant % len(FILLS)],
            "marker": MARKERS[places[key]] if len(set(keys)) > 1 else "",
        }
    return looks


def curve(axes: Axes, x: Array, values: Array, band: ArrayLike = np.nan, **look: Any) -> None:
    """Draw a curve above its band of a lighter shade, or say that there is no estimate.

    Its markers are few, and not where those of other curves are.
    """
    if not np.isfinite(values).any():
        remark(axes, "no estimate")
        return
    if np.isfinite(band).any():
        axes.fill_between(x, *np.asarray(band), color=look["color"], alpha=0.2, linewidth=0)
    every = max(1, len(x) // MARKERS_PER_CURVE)
    axes.plot(x, values, markevery=(3 * len(axes.lines) % every, every), **look)


def rows_by_method(
    rows: Iterable[Sequence[Axes]],
    methods: Sequence[str],
    time: Array,
    draws: Iterable[Array],
    truths: Iterable[Array] = (),
) -> None:
    """Draw mean ± 2 standard deviations over draws, a row for each array (draw, method, time).

    Each row has an axes for each method. With a truth, it is limited to what is usual.
    """
    looks = lines(methods).values()
    for row, values, truth in zip_longest(rows, draws, truths):
        for axes, look, mean, spread in zip(row, looks, *mean_and_spread(values), strict=True):
            if truth is not None and np.isfinite(truth).any():
                axes.plot(time, truth, **TRUE_LINE)
            curve(axes, time, mean, (mean - 2 * spread, mean + 2 * spread), color=look["color"])
        if truth is not None:
            limit_to_usual(row[0], values.swapaxes(0, 1), [truth])


def points_by_method(
    axes: Axes, rows: pd.DataFrame, methods: Sequence[str], width: float = 0.0, **look: Any
) -> None:
    """Draw value ± standard error over the column ``size`` of the rows, a line for each method.

    Points of different methods stand beside each other over a ``width``.
    """
    offsets = width * ((np.arange(len(methods)) + 0.5) / len(methods) - 0.5)
    for offset, (method, line) in zip(offsets, lines(methods).items(), strict=True):
        mine = rows[rows.method == method].sort_values("size")
        points = line | {"marker": line["marker"] or "o"} | look
        axes.errorbar(mine["size"] + offset, mine.value, mine.standard_error.fillna(0.0), **points)
    axes.margins(x=0.05)


def remark(axes: Axes, text: str) -> None:
    """Say in the axes why nothing is drawn."""
    axes.text(0.5, 0.96, text, transform=axes.transAxes, ha="center", va="top")


def limit_to_usual(axes: Axes, curves: Iterable[Array], always: Iterable[Array]) -> None:
    """Limit the vertical axis to what is usual of the curves, and to those shown ``always``.

    A method that has spikes, or is far off, does not hide the others.
    """
    ranges, shown = (
        [np.nanpercentile(each, [1, 99]) for each in group if np.isfinite(each).any()]
        for group in (curves, always)
    )
    if not ranges:
        return
    low, high = np.median(ranges, axis=0)
    reach = MAX_REACH * max(high - low, abs(high + low) / 4)  # also of constants
    ends = np.append(np.clip(ranges, low - reach, high + reach), shown)
    room = 0.1 * np.abs(ends).max() or 1.0  # what hardly changes does not look as if it did
    axes.set_ylim(ends.min() - room, ends.max() + room)


def log_ticks(axis: Axis) -> None:
    """Put plain numbers at the powers of ten of a logarithmic axis, and at 2 and 5 times a few."""
    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 300 * low else (1.0,)))
    axis.set_major_formatter("{x:g}")
    axis.minorticks_off()
