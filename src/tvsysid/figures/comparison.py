"""Methods side by side, like figures 3, 4 and A.1 of van de Ruit et al. 2021."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tvsysid.figures.style import TRUTH, lines, plain
from tvsysid.figures.words import TRAITS, differing, wrapped

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

BARS = {
    "bias_error": "bias error\n(N·m/rad)",
    "random_error": "random error\n(N·m/rad)",
    "total_error": "total error\n(N·m/rad)",
    "rise_time": "rise time\n(s)",
    "vaf": "VAF\n(%)",
}
OUTLYING = 5.0
"""Bars are cut off at this multiple of what is usual among the methods, so that one does not hide the others."""
SMALL = 7.5
"""Points of the small print."""


def method_comparison(
    results: xr.Dataset, summary: pd.DataFrame, shown: Sequence[str], bars: Sequence[str], title: str = ""
) -> Figure:
    """Stiffness and time-varying VAF over time, and bars of every metric; a column for each method.

    Parameters
    ----------
    results
        As of :func:`tvsysid.study.run`.
    summary
        Of these results, as of :func:`tvsysid.study.summarize`.
    shown
        Labels of the scenarios whose stiffness and time-varying VAF are drawn over time: mean ± 2 standard deviations
        over trials.
    bars
        Labels of the scenarios that have a bar in each of the lower axes: value ± its standard error. A bar that is
        far longer than is usual among the methods is cut off, and its value printed.
    title
        Above all.

    Returns
    -------
    matplotlib.figure.Figure
        Rows of axes with common vertical scales.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415  # heavy

    methods = [str(name) for name in results.method_key.values]
    table = _table(summary, methods, bars)
    names = [name for name in BARS if np.isfinite(table[name][0]).any()]
    over_time = 2 * len(shown)
    width = max((1.6 if len(methods) <= 5 else 1.4) * len(methods), 3.2) + 0.8
    figure = Figure(figsize=(width, 1.25 * over_time + 1.0 * len(names) + 1.4), layout="constrained")
    rows = over_time + len(names)
    grid = figure.subplots(
        rows, len(methods), sharey="row", squeeze=False, height_ratios=[1.25] * over_time + [1.0] * len(names)
    )
    for axes in grid.ravel():
        plain(axes).tick_params(labelsize=SMALL)
    for axes, method in zip(grid[0], methods, strict=True):
        axes.set_title(wrapped(method, 20 if len(methods) <= 5 else 17), fontsize=9 if len(method) <= 20 else 8)
    told = [f"{text}\n" for text in differing(_traits(results, shown))] if len(shown) > 1 else [""]
    for row, (label, which) in enumerate(zip(shown, told, strict=True)):
        _stiffness(grid[row], results.sel(scenario=label), which)
        _varying_vaf(grid[row + len(shown)], results.sel(scenario=label), which)
    for row in range(over_time):
        _share_ticks(grid[row], last=row == over_time - 1)
    for axes in grid[over_time - 1]:
        axes.set_xlabel("time (s)", fontsize=SMALL)
    ticks = differing(_traits(results, bars)) if names else []
    room = 0.4 if len(bars) > 2 else 0.9
    for row, name in enumerate(names, start=over_time):
        _bars(grid[row], name, *table[name], methods)
        for axes in grid[row]:
            axes.set_xticks(range(len(bars)), ticks if row == rows - 1 else [])
            axes.set_xlim(-0.3 - room, len(bars) - 0.7 + room)
            axes.grid(visible=False, axis="x")
            if row == rows - 1:
                crowded = sum(map(len, ticks)) + 2 * len(ticks) > 20
                axes.tick_params(axis="x", labelrotation=90 if crowded else 0)
    figure.align_ylabels(grid[:, 0])
    _legend(figure, grid[0, 0], bool(names), results.sizes["trial"])
    figure.suptitle(title, fontsize=10)
    return figure


def _traits(results: xr.Dataset, labels: Sequence[str]) -> list[dict[str, Any]]:
    return [{name: results[name].sel(scenario=label).item() for name in TRAITS} for label in labels]


def _table(summary: pd.DataFrame, methods: Sequence[str], scenarios: Sequence[str]) -> dict[str, tuple[Array, Array]]:
    """Value and standard error of each metric, each of shape (method, scenario)."""
    tables = {}
    for name in BARS:
        rows = summary[summary.metric == name].set_index(["method", "scenario"])
        wide = [
            rows[column].unstack("scenario").reindex(index=list(methods), columns=list(scenarios))
            for column in ("value", "standard_error")
        ]
        tables[name] = (wide[0].to_numpy(dtype=float), wide[1].to_numpy(dtype=float))
    return tables


def _stiffness(row: Sequence[Axes], cell: xr.Dataset, which: str) -> None:
    truth = cell.true_stiffness.values
    for axes, method in zip(row, cell.method_key.values, strict=True):
        axes.plot(cell.time.values, truth, color=TRUTH, linewidth=1.0, linestyle="--", label="truth", zorder=3)
        _band(axes, cell.time.values, cell.stiffness.sel(method_key=method), _hue(cell, method))
    span = max(float(np.ptp(truth)), 0.5 * float(np.abs(truth).max()))
    row[0].set_ylim(min(0.0, float(truth.min()) - 0.5 * span), float(truth.max()) + 0.6 * span)
    row[0].set_ylabel(f"{which}stiffness\n(N·m/rad)", fontsize=SMALL)


def _varying_vaf(row: Sequence[Axes], cell: xr.Dataset, which: str) -> None:
    for axes, method in zip(row, cell.method_key.values, strict=True):
        _band(axes, cell.time.values, cell.time_varying_vaf.sel(method_key=method), _hue(cell, method), most=100.0)
    known = cell.time_varying_vaf.values[np.isfinite(cell.time_varying_vaf.values)]
    lowest = _floor(float(np.quantile(known, 0.01)) if known.size else 0.0)
    row[0].set_ylim(lowest, 102)
    row[0].set_ylabel(f"{which}time-varying VAF\n{_percent(lowest)}", fontsize=SMALL)


def _hue(cell: xr.Dataset, method: str) -> str:
    return lines([str(name) for name in cell.method_key.values])[str(method)][0]


def _floor(lowest: float) -> float:
    """Where an axis of VAF begins: ten per cent below the lowest value, rounded, but at 90 % at most."""
    return float(np.clip(10 * np.floor((lowest - 5) / 10), 0, 90))


def _percent(floor: float) -> str:
    return f"(%, from {floor:.0f} %)" if floor > 0 else "(%)"


def _band(axes: Axes, time: Array, values: Any, hue: str, most: float = np.inf) -> None:
    """Mean and twice the standard deviation of values (trial, time) that cannot be more than so much."""
    known = values.notnull()
    if not bool(known.any()):
        axes.text(0.5, 0.5, "no estimate", transform=axes.transAxes, ha="center", va="center", fontsize=SMALL)
        return
    mean, spread = values.mean("trial"), 2 * values.std("trial")
    if int(known.sum("trial").max()) > 1:
        axes.fill_between(time, mean - spread, np.minimum(mean + spread, most), color=hue, alpha=0.25, linewidth=0)
    axes.plot(time, mean, color=hue, linewidth=1.4)


def _share_ticks(row: Sequence[Axes], last: bool) -> None:
    for axes in row:
        axes.sharex(row[0])
        axes.margins(x=0)
        axes.tick_params(labelbottom=last)


def _bars(row: Sequence[Axes], name: str, values: Array, errors: Array, methods: Sequence[str]) -> None:
    """Bars of one metric; values and standard errors of shape (method, scenario)."""
    base = 0.0
    if name == "vaf":
        base = _floor(float(np.nanmin(values)))
        top, highest = 100.0, 100.0 + 0.02 * (100 - base)
    else:
        top = _top(values)
        reach = np.nanmax(np.where(values <= top, values + np.nan_to_num(errors), np.nan))
        cut = bool(np.nanmax(values) > top)
        highest = 1.22 * top if cut else 1.06 * float(reach)
    for axes, heights, spread, hue in zip(
        row, values, errors, [hue for hue, _ in lines(methods).values()], strict=True
    ):
        places = np.arange(len(heights))
        axes.bar(places, np.minimum(heights, top) - base, bottom=base, width=0.72, color=hue)
        told = (heights <= top) & np.isfinite(spread)
        axes.errorbar(
            places[told], heights[told], spread[told], fmt="none", ecolor="black", elinewidth=0.9, capsize=1.8
        )
        for place in places[heights > top]:
            axes.plot([place - 0.5, place + 0.5], [0.84 * top, 0.92 * top], color="white", linewidth=1.8)
            axes.annotate(
                f"{heights[place]:.3g}",
                (place, top),
                (0, 1),
                textcoords="offset points",
                ha="left" if place == 0 and len(places) > 2 else "center",
                va="bottom",
                fontsize=SMALL,
            )
        for place in places[~np.isfinite(heights)]:
            axes.text(place, base, "–", ha="center", va="bottom", fontsize=10)
    row[0].set_ylim(base, highest if highest > base else base + 1)
    row[0].set_ylabel(BARS[name].replace("(%)", _percent(base)), fontsize=SMALL)


def _top(values: Array) -> float:
    """Height at which bars are cut off: that of the longest, unless it is far from what is usual among methods."""
    each = np.sort([row[np.isfinite(row)].max() for row in values if np.isfinite(row).any()])
    usual = OUTLYING * each[(len(each) - 1) // 2]
    if each[-1] <= usual or usual == 0:
        return float(each[-1])
    cut = 1.15 * float(values[values <= usual].max())
    return cut if each[-1] > 1.5 * cut else float(each[-1])  # little is gained by cutting off a little


def _legend(figure: Figure, axes: Axes, bars: bool, trials: int) -> None:
    from matplotlib.lines import Line2D  # noqa: PLC0415  # heavy
    from matplotlib.patches import Patch  # noqa: PLC0415  # heavy

    grey = "#777777"
    handles: list[Any] = [Line2D([], [], color=TRUTH, linewidth=1.0, linestyle="--", label="truth")]
    handles.append(Line2D([], [], color=grey, label="mean over trials" if trials > 1 else "the only trial"))
    if trials > 1:
        handles.append(Patch(color=grey, alpha=0.35, linewidth=0, label="± 2 standard deviations"))
        if bars:
            line = Line2D([], [], color="black", marker="|", linewidth=0.9, label="± 1 standard error")
            handles.append(line)
    wide = figure.get_figwidth() > 6
    figure.legend(
        handles=handles, frameon=False, fontsize=8, loc="outside lower center", ncols=len(handles) if wide else 2
    )
