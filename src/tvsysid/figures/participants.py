"""Figures of an experiment: stiffness of people over time, metrics and errors of methods."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from tvsysid.errors import InputError
from tvsysid.figures import style
from tvsysid.figures.results import headings, of_least_data, unique
from tvsysid.figures.words import perturbation_name
from tvsysid.numerics.bands import mean_and_spread

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
CAPTION = "bars: mean ± 2 SD over participants; dots: participants"
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
    titles = [*map(perturbation_name, perturbations), "torque (N·m)"]
    figure, grid = style.panels(
        len(people),
        len(titles),
        2.6 * len(titles) + 1.0,
        1.45 * len(people) + 1.2,
        title,
        xlabel="time (s)",
        ylabels=[f"{person}\n{STIFFNESS}" for person in people],
        headings=titles,
        sharex=True,
        sharey="col",
    )
    looks, time = style.lines(unique(results.method_key.values)).values(), results.time.values
    labels = headings(results, 60)
    for place in range(results.sizes["recording"]):
        one = results.isel(recording=place)
        row, column = people.index(one.participant), perturbations.index(one.perturbation)
        axes, torque = grid[row, [column, -1]]
        if np.isfinite(one.truth).any():
            axes.plot(time, one.truth, **style.TRUE_LINE)
        means = mean_and_spread(one.estimate.values)[0]
        for mean, look, label in zip(means, looks, labels, strict=True):
            style.curve(axes, time, mean, **look | {"label": label, "linewidth": 1.0})
        torque.plot(time, one.mean_torque, color=MEAN_TORQUE, label="mean torque")
        if np.isfinite(one.target_torque).any():
            torque.plot(time, one.target_torque, **style.TARGET_LINE)
    for axes in grid[0, :-1]:
        style.limit_to_usual(axes, results.estimate.mean("bootstrap").values, results.truth)
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
    methods, time = unique(here.method_key.values), here.time.values
    names = [perturbation_name(each) for each in here.perturbation.values]
    labels = [f"{name}\n{label}" for label in (STIFFNESS, VAF) for name in names]
    if np.isfinite(here.target_torque).any():
        labels.append("torque\n(N·m)")
    figure, grid = style.panels(
        len(labels),
        len(methods),
        max(1.25 * len(methods), 2.6) + 0.84,
        1.35 * len(labels) + 1.1,
        title,
        xlabel="time (s)",
        ylabels=labels,
        headings=headings(here, 15),
        sharex=True,
        sharey="row",
    )
    stiffness, vaf, torque = np.split(grid, [len(names), 2 * len(names)])
    for row, draws, truth in zip(stiffness, here.estimate.values, here.truth.values, strict=True):
        style.columns_by_method(row, methods, time, draws, truth)
        style.limit_to_usual(row[0], draws.swapaxes(0, 1), truth)
    for row, draws in zip(vaf, here.time_varying_vaf.values, strict=True):
        style.columns_by_method(row, methods, time, draws)
        row[0].set_ylim(0, 102)
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
    known = {"vaf", *summary.metric}
    metrics = {name: label for name, label in METRICS.items() if name in known}
    perturbations = unique(summary.perturbation)
    kinds = ["method", "realizations"]
    bars = summary.set_index(kinds).index.unique()
    methods = bars.get_level_values("method").tolist()
    looks = style.lines(unique(methods))
    colors = [looks[method]["color"] for method in methods]
    figure, grid = style.panels(
        len(metrics),
        len(perturbations),
        (0.26 * len(bars) + 0.8) * len(perturbations),
        1.5 * len(metrics) + 1.4,
        title,
        xlabel="realizations drawn",
        ylabels=metrics.values(),
        headings=map(perturbation_name, perturbations),
        sharex=True,
        sharey="row",
    )
    for (row, column), axes in np.ndenumerate(grid):
        metric, perturbation = list(metrics)[row], perturbations[column]
        shown = summary[(summary.metric == metric) & (summary.perturbation == perturbation)]
        shown = shown.dropna(subset="value").set_index(kinds)
        groups = shown.value.groupby(level=kinds)
        means, spreads = groups.mean().reindex(bars), groups.std().reindex(bars)
        axes.bar(range(len(bars)), means, yerr=2 * spreads, color=colors, alpha=0.6, label=methods)
        # Dots beside each other, so that equal ones show, in the order of the participants.
        beside = (groups.cumcount() + 1) / (groups.transform("size") + 1) - 0.5
        places = bars.get_indexer(shown.index) + 0.5 * beside
        axes.plot(places, shown.value, ".", color="black", alpha=0.7)
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
    figure, grid = style.panels(
        len(labels),
        len(methods),
        1.45 * len(methods) + 0.8,
        1.5 * len(labels) + 1.2,
        title,
        xlabel="time (s)",
        ylabels=labels,
        headings=headings(here, 18),
        sharex=True,
        sharey="row",
    )
    errors = (here.estimate.mean("bootstrap") - here.truth).transpose("recording", "analysis", ...)
    for row, perturbation in zip(grid, perturbations, strict=True):
        mine = errors.values[here.perturbation.values == perturbation]
        style.columns_by_method(row, methods, here.time.values, mine, np.zeros(mine.shape[-1]))
    return style.finish(figure, "mean over participants ± 2 standard deviations")
