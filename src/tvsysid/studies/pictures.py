"""Figures that all simulation studies have."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from tvsysid.figures import (
    METRICS,
    METRICS_OF_PATHWAYS,
    Illustration,
    coverage_over_time,
    error_against,
    method_comparison,
)
from tvsysid.figures.results import scenario_traits, unique
from tvsysid.figures.words import TRAITS, count, described

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

BIAS_LABEL = "mean bias of the stiffness (N·m/rad)"


def illustrated(draw: Callable[..., Any], *data: Any, title: str, text: str = "") -> Illustration:
    """Return the figure that a function draws of data, with its title and its content in words."""
    return Illustration(partial(draw, *data, title=title), title, text)


def differing_in(traits: pd.DataFrame, label: str, *names: str) -> pd.DataFrame:
    """Return the scenarios that differ from one of them in these traits alone."""
    others = [name for name in TRAITS if name not in names]
    return traits[(traits[others] == traits.loc[label, others]).all(axis=1)]


def scenario_figures(
    results: xr.Dataset, summary: pd.DataFrame, stem: str, labels: Sequence[str]
) -> dict[str, Illustration]:
    """Return the figures of scenarios: methods compared, and coverage of their bands.

    ``"comparison-STEM"`` and ``"coverage-STEM"`` show the scenario in the middle over time, the
    former with the reflex gain if it was estimated, and below it the metrics of all.

    Parameters
    ----------
    results, summary
        Of a study.
    labels
        Of the scenarios.
    """
    shown = labels[len(labels) // 2]
    title = described(scenario_traits(results).to_dict("index")[shown])
    rows = summary[summary.scenario.isin(labels)]
    methods = [each for each in unique(results.method_key.values) if each in set(rows.method)]
    is_separated = "reflex_gain" in results.quantity
    quantities = ["stiffness", "reflex_gain"] if is_separated else ["stiffness"]
    data = results.sel(quantity=quantities, method_key=methods)
    comparison = (
        f"A column for each method. Upper rows, over one realization of {shown}: "
        f"estimated {' and '.join(quantities).replace('_', ' ')}, mean and two standard deviations "
        f"over {count(results.sizes['trial'], 'trial')}, against the truth, and time-varying VAF. "
        f"Lower rows: metrics of {count(len(labels), 'scenario')} with standard errors; the "
        "ranking has the numbers."
    )
    coverage = (
        "Share of trials in which the 95 % band of each method holds the true stiffness, over one "
        f"realization of {shown}, averaged over 0.05 s. A band covers the random error, not the "
        "bias of what a method smooths: about a switch bands miss the truth. Times and trials "
        "without a band do not count."
    )
    draw = partial(method_comparison, metrics=METRICS_OF_PATHWAYS if is_separated else METRICS)
    return {
        f"comparison-{stem}": illustrated(
            draw, data, rows, [shown], labels, title=f"Methods compared: {title}", text=comparison
        ),
        f"coverage-{stem}": illustrated(
            coverage_over_time,
            results,
            [shown],
            title=f"How often the bands hold the truth: {title}",
            text=coverage,
        ),
    }


def error_over_size(
    stem: str, summary: pd.DataFrame, sizes: pd.Series, size_label: str, metric: str, label: str
) -> dict[str, Illustration]:
    """Return the figure of a metric against the size of something, if it has several sizes.

    Parameters
    ----------
    stem
        Of the name of the figure's file.
    sizes
        By the label of the scenario.
    size_label, label
        Labels of the axes.
    """
    if sizes.nunique() < 2:
        return {}
    rows = summary[(summary.metric == metric) & summary.scenario.isin(sizes.index)]
    rows = rows.assign(size=rows.scenario.map(sizes)).dropna(subset=["value"])
    title, text = f"{label} against {size_label}", "A line for each method, with standard errors."
    draw = partial(error_against, error=label)
    return {stem: illustrated(draw, size_label, rows, title=title, text=text)}
