"""Figures of a simulation study: methods side by side, errors, impulse responses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from tvsysid.figures import style
from tvsysid.figures.results import scenario_traits, unique
from tvsysid.figures.words import count, differing, wrapped

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

MAX_WIDTH = 11.5  # inches, as wide as a page shows without scaling
METRICS = {
    "bias_error": "bias error\n(N·m/rad)",
    "random_error": "random error\n(N·m/rad)",
    "total_error": "total error\n(N·m/rad)",
    "rise_time": "rise time\n(s)",
    "vaf": "VAF\n(%)",
}
METRICS_OF_PATHWAYS = {
    "bias_error": "bias error\n(N·m/rad)",
    "total_error": "total error\n(N·m/rad)",
    "reflex_gain total_error": "error of gain\n(N·m·s/rad)",
    "intrinsic pathway_vaf": "VAF intrinsic\n(%)",
    "reflex pathway_vaf": "VAF reflex\n(%)",
}
SMOOTHED_S = 0.05  # over which the share of trials is averaged: of few it is a coarse number
OVER_TIME = {
    "stiffness": "stiffness\n(N·m/rad)",
    "reflex_gain": "reflex gain\n(N·m·s/rad)",
}
BELOW = "time-varying VAF\n(%)", "in 95 % band\n(% of trials)"


@style.styled
def method_comparison(
    results: xr.Dataset,
    summary: pd.DataFrame,
    shown: str,
    compared: Sequence[str],
    title: str = "",
    metrics: Mapping[str, str] = METRICS,
) -> Figure:
    """Draw estimates, VAF and coverage over time, a column for each method, above its metrics.

    Coverage is the share of trials whose 95 % band of the stiffness holds the truth. Metrics that
    differ much are over a logarithmic axis.

    Parameters
    ----------
    results, summary
        Of a simulation study.
    shown
        Label of the scenario that is drawn over time: mean ± 2 standard deviations over trials.
    compared
        Labels of the scenarios whose metrics are drawn: value ± its standard error.
    metrics
        Of the summary, and what their axes are called.
    """
    methods, time = unique(results.method_key.values), results.time.values
    quantities = [name for name in OVER_TIME if name in results.quantity]
    cell = results.sel(scenario=shown, quantity=quantities)
    cell = cell.transpose("quantity", "trial", "method_key", "time", ...)
    rows = summary[summary.scenario.isin(compared) & summary.value.notna()]
    rows = rows.assign(size=rows.scenario.map(list(compared).index))
    names = [name for name in metrics if name in set(rows.metric)]
    words = enumerate(differing(scenario_traits(results).loc[list(compared)]))
    ticks = {place: wrapped(each, 25) for place, each in words if len(compared) > 1}
    heights = [1.25 * len(quantities) + 3.25, 1.2 * len(names) + 0.8]
    width = min(max(1.5 * len(methods), 3.2) + 0.8, MAX_WIDTH)
    figure = style.blank(width, sum(heights) + 0.8, wrapped(title, round(12 * width)))
    upper, lower = figure.subfigures(2, 1, squeeze=False, height_ratios=heights)[:, 0]
    labels = [*(OVER_TIME[name] for name in quantities), *BELOW]
    headings = [wrapped(method, round(12 * width / len(methods))) for method in methods]
    grid = style.grid_of(upper, labels, headings, "time (s)", sharex=True, sharey="row")
    draws, truth = cell.estimate.values, cell.truth.values
    style.rows_by_method(grid[:-2], methods, time, draws, truth)
    window = max(1, round(SMOOTHED_S / (time[1] - time[0])))
    held = 100 * cell.covered.sel(quantity="stiffness").mean("trial")
    smooth = held.rolling(time=window, center=True, min_periods=1).mean().where(held.notnull())
    shares = [cell.time_varying_vaf.values, smooth.values[None]]
    style.rows_by_method(grid[-2:], methods, time, shares)
    for axes in grid[-1]:
        axes.axhline(95, color=style.INK, linestyle=":")
        axes.set_ylim(-2, 115)  # with room for a remark
    labels = [metrics[name] for name in names]
    for name, (axes,) in zip(names, style.grid_of(lower, labels, [""], sharex=True), strict=True):
        here = rows[rows.metric == name]
        style.points_by_method(axes, here, methods, 0.8, linestyle="")
        if 0 < 6 * here.value.min() < here.value.max():
            axes.set_yscale("log")
            style.log_ticks(axes.yaxis)
        axes.set_xticks([*ticks], ticks.values())
        axes.set_xlim(-0.5, len(compared) - 0.5)
    text = "mean ± 2 standard deviations; metrics ± 1 standard error"
    return style.finish(figure, f"{count(results.sizes['trial'], 'trial')}: {text}")


@style.styled
def error_against(what: str, rows: pd.DataFrame, title: str = "") -> Figure:
    """Draw the mean bias over a setting, a line for each method: value ± standard error.

    ``what`` varies, with its unit; the rows have columns method, size (of what varies), value and
    standard_error.
    """
    figure, ((axes,),) = style.panels(title, (6.6, 3.1), ["mean bias (N·m/rad)"], xlabel=what)
    axes.axhline(0, color=style.INK, linestyle="--")
    ticks = rows["size"].unique()
    if 0 < 20 * min(ticks) < max(ticks):
        axes.set_xscale("log")
    style.points_by_method(axes, rows, unique(rows.method))
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    return style.finish(figure)


@style.styled
def impulse_responses(responses: xr.Dataset, title: str = "") -> Figure:
    """Draw true and identified impulse responses over each other, an axes for each instant.

    Parameters
    ----------
    responses
        ``impulse_response`` over (method_key, instant, lag) and ``true_impulse_response`` over
        (instant, lag), in N·m/(rad·s); coordinates lag and instant in s, and stiffness over
        (instant,) in N·m/rad.
    """
    figure, (row,) = style.panels(
        title,
        (3.2, 2.5),
        ["impulse response (N·m/(rad·s))"],
        [""] * responses.sizes["instant"],
        "lag (s)",
        sharex=True,
        sharey=True,
    )
    lag, methods = responses.lag.values, unique(responses.method_key.values)
    for place, axes in enumerate(row):
        here = responses.isel(instant=place)
        axes.plot(lag, here.true_impulse_response, **style.TRUE_LINE | {"linewidth": 5})
        for method, look in style.lines(methods).items():
            style.curve(axes, lag, here.impulse_response.sel(method_key=method).values, **look)
        axes.set_title(f"k = {here.stiffness:.0f} N·m/rad, at {here.instant:g} s")
    return style.finish(figure)
