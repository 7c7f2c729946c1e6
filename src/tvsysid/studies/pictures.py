"""Figures that several studies have, with what they show in words."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

from tvsysid.figures import Illustration, coverage_over_time, error_against, method_comparison
from tvsysid.figures.comparison import BARS
from tvsysid.figures.results import BANDS, OVER_TIME, unique
from tvsysid.figures.words import count

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


def in_words(rows: pd.DataFrame, by: Sequence[str], metrics: Collection[str]) -> str:
    """Return the known values of metrics, in a sentence for each group of rows.

    A column ``size`` is mentioned, if there is one.
    """
    known = rows[rows.metric.isin(list(metrics))].dropna(subset=["value"])
    texts = [
        f"{each['metric'].replace('_', ' ')} {each['value']:.3g} {each['unit']}"
        + (f" at {each['size']:g}" if "size" in each else "")
        for each in known.to_dict("records")
    ]
    groups = known.assign(text=texts).groupby(list(by), sort=False).text
    return " ".join(f"{', '.join(map(str, names))}: {', '.join(mine)}." for names, mine in groups)


def comparison(
    results: xr.Dataset,
    summary: pd.DataFrame,
    shown: Sequence[str],
    bars: Sequence[str],
    title: str,
    quantities: Sequence[str] = ("stiffness",),
    metrics: Mapping[str, str] = BARS,
) -> Illustration:
    """Return the figure that compares methods over time, and by bars of their metrics.

    Parameters
    ----------
    results, summary
        Of a study, the summary with full names.
    shown, bars
        Labels of the scenarios that are drawn over time, and of those that have bars.
    quantities, metrics
        What is drawn over time and as bars, the latter with the labels of their axes.
    """
    mine = summary[summary.scenario.isin([*shown, *bars])]
    labels = unique([*shown, *bars])
    methods = [each for each in unique(results.method_key.values) if each in set(mine.method)]
    what = " and ".join(quantities).replace("_", " ")
    data = results[OVER_TIME].sel(scenario=labels, quantity=list(quantities), method_key=methods)
    text = (
        f"A column for each of {count(len(methods), 'method')}. Upper rows, over one realization "
        f"of {', '.join(shown)}: estimated {what}, mean and two standard "
        f"deviations over {count(results.sizes['trial'], 'trial')}, against the truth, and "
        f"time-varying VAF. Lower rows: bars of the metrics for {count(len(bars), 'scenario')}: "
        f"{', '.join(bars)}. "
    )
    text += in_words(mine[mine.scenario.isin(shown)], ["scenario", "method"], metrics)
    drawing = partial(method_comparison, data, mine, shown, bars, title, metrics)
    return Illustration(drawing, title, text)


def coverage(
    results: xr.Dataset, summary: pd.DataFrame, labels: Sequence[str], title: str
) -> Illustration:
    """Return the figure of how often the bands hold the true stiffness in scenarios."""
    data = results[BANDS].sel(scenario=list(labels), quantity="stiffness")
    mine = summary[summary.scenario.isin(labels)]
    mine = mine[(mine.metric != "without_band") | (mine.value > 0)]
    text = (
        "Share of trials in which the 95 % band of each method holds the true stiffness, over one "
        "realization, averaged over 0.05 s. A band covers the random error, not the bias of what a "
        "method smooths: about a switch bands miss the truth. Without band is the share of times "
        "and trials that have none, which do not count. "
    )
    text += in_words(mine, ["scenario", "method"], ("coverage", "without_band"))
    return Illustration(partial(coverage_over_time, data, labels, title), title, text)


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
    rows = rows.sort_values("size", kind="stable")
    rows = rows[rows.groupby("method")["size"].transform("nunique") > 1]
    text = f"{error_label} against {size_label}. {in_words(rows, ['method'], [metric])}"
    drawing = partial(error_against, size_label, rows, title, error_label)
    return Illustration(drawing, title, text[:1].upper() + text[1:])
