"""Figures of a simulation study: methods side by side, errors, coverage, impulse responses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tvsysid.figures import style
from tvsysid.figures.results import of_quantity, scenario_traits, unique
from tvsysid.figures.words import differing, perturbation_name, wrapped

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

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
OVER_TIME = {
    "stiffness": "stiffness\n(N·m/rad)",
    "reflex_gain": "reflex gain\n(N·m·s/rad)",
    "VAF": "time-varying VAF\n(%)",
}
NOMINAL = 95.0
# seconds over which the share of trials is averaged: of a hundred trials it is a coarse number
SMOOTHED = 0.05


@style.styled
def method_comparison(
    results: xr.Dataset,
    summary: pd.DataFrame,
    shown: Sequence[str],
    compared: Sequence[str],
    title: str = "",
    metrics: Mapping[str, str] = METRICS,
) -> Figure:
    """Draw estimates and VAF over time, a column for each method, above every metric that is known.

    For each scenario shown a row of axes for each quantity and one for the VAF. Metrics that differ
    much are over a logarithmic axis.

    Parameters
    ----------
    results, summary
        Of a simulation study; what lies along ``quantity`` is drawn, the stiffness if nothing does.
    shown
        Labels of the scenarios that are drawn over time: mean ± 2 standard deviations over trials.
    compared
        Labels of the scenarios whose metrics are drawn: value ± its standard error.
    metrics
        Of the summary, and what their axes are called.
    """
    methods, trials = unique(results.method_key.values), results.sizes["trial"]
    which, ticks = (
        differing(scenario_traits(results).loc[list(labels)]) for labels in (shown, compared)
    )
    rows = summary[summary.scenario.isin(compared) & summary.value.notna()]
    names = [name for name in metrics if name in set(rows.metric)]
    quantities = unique(results.quantity.values) if "quantity" in results.dims else ["stiffness"]
    over_time = []
    for name in (*quantities, "VAF"):
        for scenario, text in zip(shown, which, strict=True):
            label = f"{text}\n" * (len(shown) > 1) + OVER_TIME[name]
            cell = results.sel(scenario=scenario)
            if name == "VAF":
                draws, truth = cell.time_varying_vaf, np.nan
            else:
                cell = of_quantity(cell, name)
                draws, truth = cell.estimate, cell.truth.values
            draws = draws.transpose("trial", ...).values
            over_time.append(style.Row(label, draws, truth, name == "VAF"))
    heights = [1.25 * len(over_time) + 0.7, *[1.2 * len(names) + 0.8] * bool(names)]
    figure = style.blank(max(1.5 * len(methods), 3.2) + 0.8, sum(heights) + 0.8, title)
    parts = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
    titles = [wrapped(method, 17) for method in methods]
    style.rows_by_method(parts[0], over_time, methods, titles, results.time.values)
    if names:
        lower = style.grid_of(
            parts[1], len(names), 1, ylabels=[metrics[name] for name in names], sharex=True
        )
        for axes, name in zip(lower[:, 0], names, strict=True):
            _draw_metric(axes, rows[rows.metric == name], methods, compared)
        lower[-1, 0].set_xticks(range(len(ticks)), [wrapped(each, 25) for each in ticks])
    text = f"mean over {trials} trials ± 2 standard deviations; metrics ± 1 standard error"
    return style.finish(figure, text if trials > 1 else "the only trial")


def _draw_metric(
    axes: Axes, rows: pd.DataFrame, methods: Sequence[str], scenarios: Sequence[str]
) -> None:
    """Draw a metric with its standard errors, the methods of each scenario side by side."""
    for number, (method, look) in enumerate(style.lines(methods).items()):
        mine = rows[rows.method == method].set_index("scenario").reindex(list(scenarios))
        places = np.arange(len(scenarios)) + 0.8 * ((number + 0.5) / len(methods) - 0.5)
        points = look | {"linestyle": "", "marker": look["marker"] or "o"}
        axes.errorbar(places, mine.value, mine.standard_error.fillna(0.0), **points)
    axes.set_xlim(-0.5, len(scenarios) - 0.5)
    style.scale_errors(axes, rows.value)


@style.styled
def error_against(
    what: str,
    rows: pd.DataFrame,
    title: str = "",
    error: str = "mean bias of the stiffness (N·m/rad)",
) -> Figure:
    """Draw an error over a setting, a line for each method: value ± standard error.

    ``what`` varies and which ``error``, with their units; the rows have columns method, size (of
    what varies), value and standard_error.
    """
    figure, grid = style.panels(1, 1, 4.6, 3.8, title, xlabel=what, ylabels=[error])
    grid[0, 0].axhline(0, color=style.INK, linestyle="--")
    _draw_errors(grid[0, 0], rows)
    return style.finish(figure)


def _draw_errors(axes: Axes, rows: pd.DataFrame) -> None:
    """Draw a line with error bars for each method."""
    for method, look in style.lines(unique(rows.method)).items():
        mine = rows[rows.method == method].sort_values("size")
        axes.errorbar(mine["size"], mine.value, mine.standard_error.fillna(0.0), **look)
    ticks = sorted(rows["size"].unique())
    if ticks and 0 < 10 * ticks[0] < ticks[-1]:
        axes.set_xscale("log")
        axes.minorticks_off()
    axes.margins(x=0.05)
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])


@style.styled
def coverage_over_time(results: xr.Dataset, scenarios: Sequence[str], title: str = "") -> Figure:
    """Draw the coverage of the 95 % band over a realization, a line for each method.

    It is the mean over 0.05 s and over trials that have a band at each time, as in
    :func:`tvsysid.metrics.coverage`; no line where none has. The scenarios, given by their labels,
    have an axes each, with the true stiffness below.
    """
    cells, time = of_quantity(results).sel(scenario=list(scenarios)), results.time.values
    held = cells.covered.transpose("scenario", "method_key", ...)
    window = {"time": max(1, round(SMOOTHED / (time[1] - time[0])))}
    hits, bands = (
        each.rolling(window, center=True, min_periods=1).sum()
        for each in (held.sum("trial"), held.count("trial"))
    )
    shares = (100 * hits / bands).where(held.notnull().any("trial")).values
    labels = ["trials whose 95 % band\nholds the truth (%)", "true stiffness\n(N·m/rad)"]
    figure, grid = style.panels(
        2,
        len(shares),
        3.6 * len(shares) + 0.8,
        4.4,
        title,
        xlabel=style.REALIZATION_TIME,
        ylabels=labels,
        headings=map(perturbation_name, cells.perturbation.values),
        sharex=True,
        sharey="row",
        height_ratios=(3, 1),
    )
    looks = style.lines(unique(results.method_key.values)).values()
    for place, (above, below) in enumerate(grid.T):
        for share, look in zip(shares[place], looks, strict=True):
            if np.isfinite(share).any():
                style.curve(above, time, share, **look)
        above.axhline(NOMINAL, color=style.INK, linestyle=":", label="nominal")
        above.set_ylim(-2, 102)
        below.plot(time, cells.truth.values[place], color=style.TRUTH)
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
    count = responses.sizes["instant"]
    figure, grid = style.panels(
        1,
        count,
        3.2 * count + 0.8,
        3.6,
        title,
        xlabel="lag (s)",
        ylabels=["impulse response (N·m/(rad·s))"],
        sharex=True,
        sharey=True,
    )
    lag, methods = responses.lag.values, unique(responses.method_key.values)
    for place, axes in enumerate(grid[0]):
        here = responses.isel(instant=place)
        axes.plot(lag, here.true_impulse_response, **style.TRUE_LINE | {"linewidth": 5})
        for number, (method, look) in enumerate(style.lines(methods).items()):
            # Dashes begin at different places, so that lines on top of each other all show.
            look["linestyle"] = (3.0 * number, (5.0, 2.5))
            response = here.impulse_response.sel(method_key=method).values
            style.curve(axes, lag, response, **look)
        axes.set_title(f"k = {here.stiffness:.0f} N·m/rad, at {here.instant:g} s")
    return style.finish(figure)
