"""Methods side by side: estimates over time, and bars of every metric."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid.figures import style
from tvsysid.figures.results import of_quantity, scenario_traits, unique
from tvsysid.figures.words import differing, wrapped
from tvsysid.numerics import Array

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
VAF_LABEL = "time-varying VAF\n(%)"
MAX_BAR = 5.0  # multiple of the median bar at which an axis of bars ends
MAX_TICKS = 20  # letters of the labels below one method's bars, which else stand upright


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

    For each scenario shown a row of axes for each quantity and one for the VAF, and a row for each
    metric that is known.

    Parameters
    ----------
    results, summary
        Of a simulation study; what lies along ``quantity`` is drawn, the stiffness if nothing does.
    shown
        Labels of the scenarios that are drawn over time: mean ± 2 standard deviations over trials.
    bars
        Labels of the scenarios that have a bar in each of the lower axes: value ± its standard
        error. A bar that is far longer than is usual among the methods has its value above it. A
        VAF, whose axis need not begin at zero, is a dot.
    metrics
        Of the summary, and what their axes are called.
    """
    methods = unique(results.method_key.values)
    rows = summary[summary.scenario.isin(bars) & summary.value.notna()]
    names = [name for name in metrics if name in set(rows.metric)]
    quantities = unique(results.quantity.values) if "quantity" in results.dims else ["stiffness"]
    over_time = [(name, label) for name in (*quantities, VAF_LABEL) for label in shown]
    traits: Any = scenario_traits(results).to_dict("index")
    ticks = differing([traits[label] for label in bars])
    upright = 0.065 * max(map(len, ticks)) if names and _crowded(ticks) else 0.0  # inches
    heights = [1.25] * len(over_time) + [1.0] * len(names)
    figure, grid = style.panels(
        len(heights),
        len(methods),
        max(1.5 * len(methods), 3.2) + 0.8,
        sum(heights) + 1.4 + upright,
        title,
        sharey="row",
        height_ratios=heights,
    )
    for axes, method in zip(grid[0], methods, strict=True):
        axes.set_title(wrapped(method, 17))
    which = differing([traits[label] for label in shown])
    for row, (name, label) in zip(grid, over_time, strict=False):
        text = f"{which[list(shown).index(label)]}\n" if len(shown) > 1 else ""
        row[0].set_ylabel(f"{text}{OVER_TIME.get(name, name)}")
        _over_time(row, results.sel(scenario=label), name)
    hues = list(style.hues(methods).values())
    for row, name in zip(grid[len(over_time) :], names, strict=True):
        row[0].set_ylabel(metrics[name])
        values, errors = (
            rows[rows.metric == name]
            .pivot(index="method", columns="scenario", values=column)
            .reindex(index=methods, columns=list(bars))
            .to_numpy(dtype=float)
            for column in ("value", "standard_error")
        )
        _bars(row, values, np.nan_to_num(errors), hues, as_dots="(%)" in metrics[name])
        for axes in row:
            axes.set_xticks(range(len(bars)), ticks if name == names[-1] else [""] * len(bars))
            axes.tick_params(axis="x", labelrotation=90 if _crowded(ticks) else 0)
    figure.align_ylabels(grid[:, 0])
    trials = results.sizes["trial"]
    keys = [style.line_key(**style.TRUE_LINE), *style.band_keys(trials, "trial")]
    if names and trials > 1:
        keys.append(style.line_key("± 1 standard error", color="black", marker="|", linewidth=0.9))
    style.legend_below(figure, keys)
    return figure


def _over_time(row: Sequence[Axes], cell: xr.Dataset, name: str) -> None:
    """Draw mean and two standard deviations over trials of a quantity, or of the VAF."""
    is_vaf, time = name == VAF_LABEL, cell.time.values
    values = cell.time_varying_vaf if is_vaf else of_quantity(cell, name).estimate
    true = of_quantity(cell, *([] if is_vaf else [name])).truth.values
    mean = values.mean("trial")
    spread = 2 * ((values - mean) ** 2).mean("trial") ** 0.5  # .std warns where there is no trial
    several = values.notnull().sum("trial").max("time") > 1
    for axes, (method, hue) in zip(
        row, style.hues(unique(cell.method_key.values)).items(), strict=True
    ):
        if not is_vaf:
            axes.plot(time, true, **style.TRUE_LINE)
        middle, reach = mean.sel(method_key=method).values, spread.sel(method_key=method).values
        band = [middle - reach, np.minimum(middle + reach, 100.0 if is_vaf else np.inf)]
        drawn = band if several.sel(method_key=method) else None
        style.curve_with_band(axes, time, middle, drawn, hue)
        axes.set_xlabel("time (s)" if is_vaf else "")
        axes.tick_params(labelbottom=is_vaf)
        axes.margins(x=0)
    if is_vaf:
        known = values.values[np.isfinite(values.values)]
        row[0].set_ylim(_floor(float(np.quantile(known, 0.01)) if known.size else 0.0), 102)
    else:
        low, high = float(np.min(true)), float(np.max(true))
        span = max(high - low, 0.5 * max(abs(low), abs(high))) or 1.0
        row[0].set_ylim(min(0.0, low - 0.5 * span), high + 0.6 * span)


def _floor(lowest: float) -> float:
    """Return where an axis of VAF begins: 10 % below the lowest value, rounded, at most 90 %."""
    return float(np.clip(10 * np.floor((lowest - 5) / 10), 0, 90))


def _crowded(ticks: list[str]) -> bool:
    """Whether labels have no room side by side."""
    return sum(map(len, ticks)) + 2 * len(ticks) > MAX_TICKS


def _bars(
    row: Sequence[Axes], values: Array, errors: Array, hues: Sequence[str], as_dots: bool
) -> None:
    """Draw a metric, (method, scenario), with its errors; a dash where there is no value."""
    places = range(values.shape[1])
    bottom = _floor(float(np.nanmin(values - errors))) if as_dots else 0.0
    usual = MAX_BAR * float(np.nanmedian(values)) or np.inf
    top = 102.0 if as_dots else 1.06 * min(float(np.nanmax(values + errors)), usual) or 1.0
    for axes, hue, heights, reach in zip(row, hues, values, errors, strict=True):
        if as_dots:
            axes.errorbar(places, heights, reach, fmt="o", color=hue, markersize=4)
        else:
            axes.bar(places, heights, 0.72, color=hue, yerr=reach)
        for place, height in zip(places, heights, strict=True):
            if not np.isfinite(height):
                axes.text(place, bottom, "–", ha="center", va="bottom", fontsize=10)
            elif height > top:
                axes.text(place, top, f"{height:.3g}", ha="center", va="bottom")
        axes.grid(visible=False, axis="x")
        axes.set_xlim(-0.7, values.shape[1] - 0.3)
    row[0].set_ylim(bottom, top)
