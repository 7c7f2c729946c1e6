"""Methods side by side: estimates over time, and bars of every metric."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tvsysid.figures import style
from tvsysid.figures.results import estimates, traits_of, truth, unique
from tvsysid.figures.words import differing, wrapped
from tvsysid.numerics import Array

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import GridSpec

BARS = {
    "bias_error": "bias error\n(N·m/rad)",
    "random_error": "random error\n(N·m/rad)",
    "total_error": "total error\n(N·m/rad)",
    "rise_time": "rise time\n(s)",
    "vaf": "VAF\n(%)",
}
BARS_OF_PATHWAYS = {
    "bias_error": "bias error\n(N·m/rad)",
    "total_error": "total error\n(N·m/rad)",
    "reflex_gain total_error": "error of gain\n(N·m·s/rad)",
    "intrinsic pathway_vaf": "VAF intrinsic\n(%)",
    "reflex pathway_vaf": "VAF reflex\n(%)",
}
OVER_TIME = {"stiffness": "stiffness\n(N·m/rad)", "reflex_gain": "reflex gain\n(N·m·s/rad)"}
# bars are cut off at this multiple of what is usual among the methods: one would hide the others
OUTLYING = 5.0
# between the bars of two methods, beside the room on either side, as a share of a method's width
GAP = 0.1


@style.styled
def method_comparison(
    results: xr.Dataset,
    summary: pd.DataFrame,
    shown: Sequence[str],
    bars: Sequence[str],
    title: str = "",
    metrics: Mapping[str, str] = BARS,
) -> Figure:
    """Draw estimates and VAF over time, and bars of every metric; a column for each method.

    For each scenario shown a row of axes for each quantity and one for the VAF, and an axes for
    each metric that is known.

    Parameters
    ----------
    results, summary
        Of a simulation study; what lies along ``quantity`` is drawn, the stiffness if nothing does.
    shown
        Labels of the scenarios that are drawn over time: mean ± 2 standard deviations over trials.
    bars
        Labels of the scenarios that have a bar in each of the lower axes: value ± its standard
        error. A bar that is far longer than is usual among the methods is cut off, and its value
        printed. A VAF, whose axis need not begin at zero, is a dot with ± 2 standard deviations
        over trials.
    metrics
        Of the summary, and what their axes are called.
    """
    methods = unique(results.method_key.values)
    table = _table(summary, methods, bars, metrics)
    names = [name for name in metrics if np.isfinite(table[name][0]).any()]
    quantities = unique(results.quantity.values) if "quantity" in results.dims else ["stiffness"]
    over_time, crowd = (len(quantities) + 1) * len(shown), len(methods) > 5
    width = max((1.4 if crowd else 1.6) * len(methods), 3.2) + 0.8
    traits = traits_of(results)
    ticks = differing([traits[label] for label in bars])
    upright = 0.065 * max(map(len, ticks)) if names and _crowded(ticks) else 0.0  # inches
    figure = style.blank(width, 1.25 * over_time + 1.0 * len(names) + 1.4 + upright, title)
    spec = figure.add_gridspec(
        over_time + len(names), len(methods), height_ratios=[1.25] * over_time + [1.0] * len(names)
    )
    grid = _shared(figure, spec, over_time, len(methods))
    for axes, method in zip(grid[0], methods, strict=True):
        axes.set_title(wrapped(method, 17 if crowd else 20), fontsize=9 if len(method) <= 20 else 8)
    which = (
        [f"{text}\n" for text in differing([traits[each] for each in shown])]
        if len(shown) > 1
        else [""]
    )
    for row, (label, text) in enumerate(zip(shown, which, strict=True)):
        cell = results.sel(scenario=label)
        for place, quantity in enumerate(quantities):
            _estimates(grid[row + place * len(shown)], cell, quantity, text)
        _varying_vaf(grid[row + len(quantities) * len(shown)], cell, text)
    for axes in grid[-1]:
        axes.set_xlabel("time (s)")
    below: list[Axes] = []
    for row, name in enumerate(names, start=over_time):
        below.append(figure.add_subplot(spec[row, :], sharex=below[0] if below else None))
        _bars(below[-1], metrics[name], *table[name], methods)
        below[-1].tick_params(labelbottom=name == names[-1])
    if below:
        _label_bars(below[0], len(methods), ticks)
    figure.align_ylabels([*grid[:, 0], *below])
    trials = results.sizes["trial"]
    keys = [style.line_key(**style.TRUE_LINE), *style.band_keys(trials, "trial")]
    if names and trials > 1:
        keys.append(style.line_key("± 1 standard error", color="black", marker="|", linewidth=0.9))
        if any("(%)" in metrics[name] for name in names):
            keys.append(
                style.line_key(
                    "VAF ± 2 SD over trials", color=style.GREY, marker="o", linewidth=0.9
                )
            )
    style.legend_below(figure, keys)
    return figure


def _shared(figure: Figure, spec: GridSpec, rows: int, columns: int) -> NDArray[Any]:
    """Return the axes of the first rows of a grid, which share scales of time and values."""
    grid: NDArray[Any] = np.empty((rows, columns), dtype=object)
    for row, column in np.ndindex(rows, columns):
        axes = figure.add_subplot(
            spec[row, column], sharex=grid[0, 0], sharey=grid[row, 0] if column else None
        )
        axes.tick_params(labelbottom=row == rows - 1, labelleft=column == 0)
        axes.margins(x=0)
        grid[row, column] = axes
    return grid


def _table(
    summary: pd.DataFrame,
    methods: Sequence[str],
    scenarios: Sequence[str],
    metrics: Mapping[str, str],
) -> dict[str, tuple[Array, Array]]:
    """Return value, lower and upper whisker of each metric, each of shape (method, scenario)."""
    tables = {}
    for name in metrics:
        rows = summary[summary.metric == name].set_index(["method", "scenario"])
        value, error = (
            rows[column]
            .unstack("scenario")
            .reindex(index=list(methods), columns=list(scenarios))
            .to_numpy(dtype=float)
            for column in ("value", "standard_error")
        )
        if "(%)" in metrics[name]:  # of a mean over trials: their standard deviation follows
            trials = (
                rows["trials"]
                .unstack("scenario")
                .reindex(index=list(methods), columns=list(scenarios))
            )
            error = 2 * error * np.sqrt(trials.to_numpy(dtype=float))
        tables[name] = (value, error)
    return tables


def _estimates(row: Sequence[Axes], cell: xr.Dataset, quantity: str, which: str) -> None:
    true = truth(cell, quantity).values
    for axes in row:
        axes.plot(cell.time.values, true, **style.TRUE_LINE)
    _means(row, cell, estimates(cell, quantity))
    span = max(float(np.ptp(true)), 0.5 * float(np.abs(true).max())) or 1.0
    row[0].set_ylim(min(0.0, float(true.min()) - 0.5 * span), float(true.max()) + 0.6 * span)
    row[0].set_ylabel(f"{which}{OVER_TIME[quantity]}")


def _varying_vaf(row: Sequence[Axes], cell: xr.Dataset, which: str) -> None:
    _means(row, cell, cell.time_varying_vaf, most=100.0)
    known = cell.time_varying_vaf.values[np.isfinite(cell.time_varying_vaf.values)]
    lowest = _floor(float(np.quantile(known, 0.01)) if known.size else 0.0)
    row[0].set_ylim(lowest, 102)
    row[0].set_ylabel(f"{which}time-varying VAF\n{_percent(lowest)}")


def _means(
    row: Sequence[Axes], cell: xr.Dataset, values: xr.DataArray, most: float = np.inf
) -> None:
    """Draw mean and two standard deviations over trials of values with an upper limit."""
    mean = values.mean("trial")
    spread = 2 * ((values - mean) ** 2).mean("trial") ** 0.5  # .std warns where there is no trial
    several = values.notnull().sum("trial").max("time") > 1
    for axes, (method, hue) in zip(
        row, style.hues(unique(cell.method_key.values)).items(), strict=True
    ):
        middle, reach = mean.sel(method_key=method).values, spread.sel(method_key=method).values
        band = (
            (middle - reach, np.minimum(middle + reach, most))
            if several.sel(method_key=method)
            else None
        )
        style.curve_with_band(axes, cell.time.values, middle, band, hue)


def _floor(lowest: float) -> float:
    """Return where an axis of VAF begins: 10 % below the lowest value, rounded, at most 90 %."""
    return float(np.clip(10 * np.floor((lowest - 5) / 10), 0, 90))


def _percent(floor: float) -> str:
    return f"(%, from {floor:.0f} %)" if floor > 0 else "(%)"


def _places(methods: int, bars: int) -> Array:
    """Return the position of each bar, shape (method, bar), below the column of its method."""
    room = 0.4 if bars > 2 else 0.9
    width = bars - 0.4 + 2 * room
    first = (1 + GAP) * width * np.arange(methods, dtype=float)
    return first[:, None] + np.arange(bars) + 0.3 + room


def _label_bars(axes: Axes, methods: int, ticks: list[str]) -> None:
    """Write below each bar what it is of; the axes end where the columns above do."""
    places = _places(methods, len(ticks))
    axes.set_xticks(places.ravel(), ticks * methods)
    axes.set_xlim(0, places[-1, -1] + places[0, 0])
    axes.grid(visible=False, axis="x")
    for each in axes.get_shared_x_axes().get_siblings(axes):
        each.grid(visible=False, axis="x")
        each.tick_params(axis="x", labelrotation=90 if _crowded(ticks) else 0)


def _crowded(ticks: list[str]) -> bool:
    """Whether labels have no room side by side."""
    return sum(map(len, ticks)) + 2 * len(ticks) > 20


def _bars(axes: Axes, label: str, values: Array, errors: Array, methods: Sequence[str]) -> None:
    """Draw the bars of one metric from values and standard errors, shape (method, scenario)."""
    if "(%)" in label:
        _dots(axes, label, values, errors, methods)
        return
    top = _top(values)
    reach = np.nanmax(np.where(values <= top, values + np.nan_to_num(errors), np.nan))
    highest = 1.22 * top if bool(np.nanmax(values) > top) else 1.06 * float(reach)
    places = _places(*values.shape)
    colours = np.repeat(list(style.hues(methods).values()), values.shape[1])
    axes.bar(places.ravel(), np.minimum(values, top).ravel(), width=0.72, color=colours)
    sure = (values <= top) & np.isfinite(errors)
    axes.errorbar(
        places[sure],
        values[sure],
        errors[sure],
        fmt="none",
        ecolor="black",
        elinewidth=0.9,
        capsize=1.8,
    )
    for place, value in zip(places[values > top], values[values > top], strict=True):
        axes.plot(
            [place - 0.5, place + 0.5], [0.84 * top, 0.92 * top], color="white", linewidth=1.8
        )
        axes.text(place, 1.01 * top, f"{value:.3g}", ha="center", va="bottom")
    for place in places[~np.isfinite(values)]:
        axes.text(place, 0, "–", ha="center", va="bottom", fontsize=10)
    axes.set_ylim(0, highest if highest > 0 else 1)
    axes.set_ylabel(label)


def _dots(axes: Axes, label: str, values: Array, reach: Array, methods: Sequence[str]) -> None:
    """Draw VAFs as dots with whiskers. Bars would mislead because the axis is cut."""
    places, ends = _places(*values.shape), np.nan_to_num(reach)
    for row, hue in enumerate(style.hues(methods).values()):
        # A list: Matplotlib would convert a one-element array to a number, and NumPy would warn.
        whiskers = np.stack([ends[row], np.clip(100.0 - values[row], 0.0, ends[row])]).tolist()
        axes.errorbar(
            places[row],
            values[row],
            whiskers,
            fmt="o",
            color=hue,
            markersize=4,
            elinewidth=0.9,
            capsize=1.8,
        )
    base = _floor(float(np.nanmin(values - ends)))
    for place in places[~np.isfinite(values)]:
        axes.text(place, base, "–", ha="center", va="bottom", fontsize=10)
    axes.set_ylim(base, 100.0 + 0.04 * (100 - base))
    axes.set_ylabel(label.replace("(%)", _percent(base)))


def _top(values: Array) -> float:
    """Return the height at which bars are cut off: the longest, unless it is an outlier."""
    each = np.sort([row[np.isfinite(row)].max() for row in values if np.isfinite(row).any()])
    usual = OUTLYING * each[(len(each) - 1) // 2]
    if each[-1] <= usual or usual == 0:
        return float(each[-1])
    cut = 1.15 * float(values[values <= usual].max())
    # Cut the axis only where that saves a third of its height
    return cut if each[-1] > 1.5 * cut else float(each[-1])
