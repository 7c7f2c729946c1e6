"""Figures of an experiment: stiffness of people over time, metrics and errors of methods."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from tvsysid.errors import InputError
from tvsysid.figures import style
from tvsysid.figures.results import headings, of_least_data, unique
from tvsysid.figures.words import perturbation_name

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

MEAN_TORQUE = "#8A5A24"
METRICS = {
    "vaf": "VAF (%)",
    "bandpassed_vaf": "VAF, 1–10 Hz (%)",
    "random_error": "random error\n(N·m/rad)",
    "bias_error": "bias error\n(N·m/rad)",
    "mean_bias": "mean bias\n(N·m/rad)",
}
CAPTION = "bars: mean ± 2 SD; dots: participants"
STIFFNESS, VAF = "stiffness\n(N·m/rad)", "time-varying VAF\n(%)"


@style.styled
def stiffness_of_participants(results: xr.Dataset, title: str = "") -> Figure:
    """Draw the mean stiffness of every participant, a line for each method, beside the torque.

    A row for each participant; a column for each perturbation, and one for the torque. Vertical
    scales are common.

    Parameters
    ----------
    results
        Of an experiment: the estimates, the truth, ``target_torque`` and ``mean_torque``, the last
        three NaN where not known. Each method is shown with the fewest realizations that it was
        given.
    """
    results = of_least_data(results).transpose("bootstrap", "analysis", ...)
    people, perturbations = (
        unique(results[name].values) for name in ("participant", "perturbation")
    )
    rows = [f"{person}\n{STIFFNESS}" for person in people]
    columns = [*map(perturbation_name, perturbations), "torque (N·m)"]
    size, xlabel = (2.6, 1.45), "time (s)"
    figure, grid = style.panels(title, size, rows, columns, xlabel, sharex=True, sharey="col")
    looks, time = style.lines(unique(results.method_key.values)).values(), results.time.values
    labels, means = headings(results, 60), results.estimate.mean("bootstrap")
    for recording in results.recording.values:
        one = results.sel(recording=recording)
        row, column = people.index(one.participant), perturbations.index(one.perturbation)
        axes, torque = grid[row, [column, -1]]
        if np.isfinite(one.truth).any():
            axes.plot(time, one.truth, **style.TRUE_LINE)
        lines = zip(means.sel(recording=recording).values, looks, labels, strict=True)
        for mean, look, label in lines:
            style.curve(axes, time, mean, **look | {"label": label, "linewidth": 1.0})
        torque.plot(time, one.mean_torque, color=MEAN_TORQUE, label="mean torque")
        if np.isfinite(one.target_torque).any():
            torque.plot(time, one.target_torque, **style.TARGET_LINE)
    for axes in grid[0, :-1]:
        style.limit_to_usual(axes, means.values, [results.truth])
    return style.finish(figure)


@style.styled
def participant_in_detail(results: xr.Dataset, participant: str, title: str = "") -> Figure:
    """Draw stiffness and VAF over time of one participant: mean ± 2 SD over bootstraps.

    A column for each method, with the fewest realizations that it was given; a row for each
    perturbation with the stiffness, one with the VAF, and one with the torque to be followed if
    there is one.

    Parameters
    ----------
    results
        As of :func:`stiffness_of_participants`, with ``time_varying_vaf``.
    participant
        Whose recordings are shown; ``InputError`` if there is none of that name.
    """
    if participant not in results.participant.values:
        known = unique(results.participant.values)
        raise InputError(f"figure: there is no participant {participant!r}; there are {known}")
    here = of_least_data(results.isel(recording=results.participant.values == participant))
    here = here.transpose("recording", "bootstrap", "analysis", "time", ...)
    names = [perturbation_name(each) for each in here.perturbation.values]
    labels = [f"{name}\n{label}" for label in (STIFFNESS, VAF) for name in names]
    if np.isfinite(here.target_torque).any():
        labels.append("torque\n(N·m)")
    figure, grid = _by_method(here, labels, title)
    stiffness, vaf, torque = np.split(grid, [len(names), 2 * len(names)])
    methods, time = unique(here.method_key.values), here.time.values
    style.rows_by_method(stiffness, methods, time, here.estimate.values, here.truth.values)
    style.rows_by_method(vaf, methods, time, here.time_varying_vaf.values)
    for axes in vaf[:, 0]:
        axes.set_ylim(0, 102)
    for axes in torque.flat:
        axes.plot(time, here.target_torque[0], **style.TARGET_LINE)
    return style.finish(figure, "mean over bootstraps ± 2 standard deviations")


@style.styled
def variance_and_spread(summary: pd.DataFrame, title: str = "") -> Figure:
    """Draw VAF, random error and, where the truth is known, bias at every amount of data.

    A row for each metric, a column for each perturbation, a bar for each method and number of
    realizations drawn: the mean over participants ± twice their standard deviation. A dot is one
    participant.

    Parameters
    ----------
    summary
        Of an experiment: columns participant, perturbation, method, realizations, metric, value.
    """
    metrics = [name for name in METRICS if name in {"vaf", *summary.metric}]
    perturbations = unique(summary.perturbation)
    kinds = ["method", "realizations"]
    summary = summary.set_index(kinds)
    bars = summary.index.unique()
    methods = bars.get_level_values("method").tolist()
    looks = style.lines(unique(methods))
    colors = [looks[method]["color"] for method in methods]
    rows = [METRICS[name] for name in metrics]
    columns = [perturbation_name(each) for each in perturbations]
    size, xlabel = (0.26 * len(bars) + 0.4, 1.5), "realizations drawn"
    figure, grid = style.panels(title, size, rows, columns, xlabel, sharex=True, sharey="row")
    for axes, (metric, name) in zip(grid.flat, product(metrics, perturbations), strict=True):
        is_shown = (summary.metric == metric) & (summary.perturbation == name)
        values = summary.value[is_shown].dropna()
        groups = values.groupby(level=kinds)
        means, spreads = groups.mean().reindex(bars), groups.std().reindex(bars)
        axes.bar(range(len(bars)), means, yerr=2 * spreads, color=colors, alpha=0.6, label=methods)
        beside = bars.get_indexer(values.index) + 0.25
        axes.plot(beside, values, ".", color="black", alpha=0.7)
        axes.set_xticks(range(len(bars)), [f"{amount:g}" for _, amount in bars])
        if "vaf" in metric:
            axes.set_ylim(0, 102)
    return style.finish(figure, CAPTION)


@style.styled
def error_against_truth(results: xr.Dataset, title: str = "") -> Figure:
    """Draw the error of the mean stiffness over bootstraps, where the truth is known.

    A column for each method with the fewest realizations that it was given, a row for each
    perturbation: mean ± 2 SD over participants.

    Parameters
    ----------
    results
        Of an experiment, as of :func:`stiffness_of_participants`.
    """
    here = of_least_data(results).transpose("bootstrap", "recording", "analysis", "time")
    perturbations, methods = (unique(here[name].values) for name in ("perturbation", "method_key"))
    labels = [f"{perturbation_name(each)}\nestimate − truth\n(N·m/rad)" for each in perturbations]
    figure, grid = _by_method(here, labels, title)
    for axes in grid.flat:
        axes.axhline(0, **style.TRUE_LINE)
    errors = here.estimate.mean("bootstrap") - here.truth
    draws = [errors[here.perturbation.values == each].values for each in perturbations]
    style.rows_by_method(grid, methods, here.time.values, draws)
    return style.finish(figure, "mean over participants ± 2 standard deviations")


def _by_method(results: xr.Dataset, labels: Sequence[str], title: str) -> tuple[Figure, Any]:
    """Return a figure with a row for each label and a column for each method of the results."""
    size = max(1.35, 2.6 / results.sizes["analysis"]), 1.4
    columns = headings(results, 16)
    return style.panels(title, size, labels, columns, "time (s)", sharex=True, sharey="row")
