"""Figures that several studies have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from tvsysid.figures import (
    METRICS,
    Illustration,
    coverage_over_time,
    error_against,
    method_comparison,
)
from tvsysid.figures.results import unique
from tvsysid.figures.words import count

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


def comparison(
    results: xr.Dataset,
    summary: pd.DataFrame,
    shown: Sequence[str],
    compared: Sequence[str],
    title: str,
    quantities: Sequence[str] = ("stiffness",),
    metrics: Mapping[str, str] = METRICS,
) -> Illustration:
    """Return the figure that compares methods over time, and by their metrics.

    Parameters
    ----------
    results, summary
        Of a study, the summary with full names.
    shown, compared
        Labels of the scenarios that are drawn over time, and of those whose metrics are drawn.
    quantities, metrics
        What is drawn over time and below, the latter with the labels of their axes.
    """
    labels = unique([*shown, *compared])
    mine = summary[summary.scenario.isin(labels)]
    methods = [each for each in unique(results.method_key.values) if each in set(mine.method)]
    data = results.sel(scenario=labels, quantity=list(quantities), method_key=methods)
    text = (
        f"A column for each method. Upper rows, over one realization of {', '.join(shown)}: "
        f"estimated {' and '.join(quantities).replace('_', ' ')}, mean and two standard deviations "
        f"over {count(results.sizes['trial'], 'trial')}, against the truth, and time-varying VAF. "
        f"Lower rows: metrics of {count(len(compared), 'scenario')} with standard errors; the "
        "ranking has the numbers."
    )
    return Illustration(
        lambda: method_comparison(data, mine, shown, compared, title, metrics), title, text
    )


def coverage(results: xr.Dataset, labels: Sequence[str], title: str) -> Illustration:
    """Return the figure of how often the bands hold the true stiffness in scenarios."""
    data = results.sel(scenario=list(labels), quantity="stiffness")
    text = (
        "Share of trials in which the 95 % band of each method holds the true stiffness, over one "
        f"realization of {', '.join(labels)}, averaged over 0.05 s. A band covers the random "
        "error, not the bias of what a method smooths: about a switch bands miss the truth. Times "
        "and trials without a band do not count."
    )
    return Illustration(lambda: coverage_over_time(data, labels, title), title, text)


def error_over_size(
    summary: pd.DataFrame,
    metric: str,
    sizes: pd.Series,
    title: str,
    size_label: str,
    error_label: str = "mean bias of the stiffness (N·m/rad)",
) -> Illustration:
    """Return the figure of a metric against the size of something in each scenario.

    Parameters
    ----------
    sizes
        By the label of the scenario.
    size_label, error_label
        Labels of the axes.
    """
    rows = summary[(summary.metric == metric) & summary.scenario.isin(sizes.index)]
    rows = rows.assign(size=rows.scenario.map(sizes)).dropna(subset=["value"])
    rows = rows[rows.groupby("method")["size"].transform("nunique") > 1]
    text = (
        f"{error_label[:1].upper()}{error_label[1:]} against {size_label}, a line for each method, "
        "with standard errors."
    )
    return Illustration(lambda: error_against(size_label, rows, title, error_label), title, text)
