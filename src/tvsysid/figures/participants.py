"""Figures of an experiment: stiffness of people over time, metrics and errors of methods."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tvsysid.errors import InputError
from tvsysid.figures import style
from tvsysid.figures.results import headings, of_least_data, unique
from tvsysid.figures.words import perturbation_name, wrapped
from tvsysid.numerics.bands import mean_and_spread, mean_known

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

TARGET: dict[str, Any] = {"color": style.TARGET, "linewidth": 0.8, "label": "torque to be followed"}
MEAN_TORQUE = "#8A5A24"
SPREAD = {
    "vaf": "VAF (%)",
    "bandpassed_vaf": "VAF, 1–10 Hz (%)",
    "random_error": "random error (N·m/rad)",
}
AGAINST_TRUTH = {"bias_error": "bias error (N·m/rad)", "mean_bias": "mean bias (N·m/rad)"}
FAINT, FULL = 0.35, 0.85  # opacity of the bars for the least and the most data
MAX_ABREAST = 12  # letters of a label below bars, which else stands upright
CAPTION = "below: realizations drawn; bars: mean ± 2 SD over participants; dots: participants"
LABELS = {"estimate": "stiffness\n(N·m/rad)", "time_varying_vaf": "time-varying VAF\n(%)"}


@style.styled
def stiffness_of_participants(results: xr.Dataset, title: str = "") -> Figure:
    """Draw the mean stiffness of every participant, a line for each method, beside the torque.

    A row for each participant; a column for each perturbation, and one for the torque if it is
    known. Vertical scales are common.

    Parameters
    ----------
    results
        Of an experiment: the estimates, the truth, ``target_torque`` and ``mean_torque``, the last
        three NaN where not known. Each method is shown with the fewest realizations that it was
        given.
    """
    results = of_least_data(results).transpose("analysis", ...)
    people, perturbations = (
        unique(results[name].values) for name in ("participant", "perturbation")
    )
    titles = [perturbation_name(each) for each in perturbations]
    if np.isfinite([results.target_torque, results.mean_torque]).any():
        titles.append("torque (N·m)")
    figure, grid = style.panels(
        len(people),
        len(titles),
        2.6 * len(titles) + 1.0,
        1.45 * len(people) + 1.2,
        title,
        xlabel="time (s)",
        ylabels=[f"{person}\n{LABELS['estimate']}" for person in people],
        headings=titles,
        sharex=True,
        sharey="col",
    )
    for first in grid[0, : len(perturbations)]:
        style.limit_to_usual(first, results.estimate.values, results.truth)
    looks, time = style.lines(unique(results.method_key.values)).values(), results.time.values
    means = mean_and_spread(results.estimate.transpose("bootstrap", "recording", ...).values)[0]
    recordings = list(zip(results.participant.values, results.perturbation.values, strict=True))
    for row, column in np.ndindex(len(people), len(perturbations)):
        axes: Any = grid[row, column]
        key = people[row], perturbations[column]
        if key not in recordings:
            style.remark(axes, "not recorded")
            continue
        place = recordings.index(key)
        one = results.isel(recording=place)
        if np.isfinite(one.truth).any():
            axes.plot(time, one.truth, **style.TRUE_LINE)
        for mean, look, label in zip(means[place], looks, headings(results, 60), strict=True):
            style.curve(axes, time, mean, **look | {"label": label, "linewidth": 1.0})
        if np.isfinite(one.mean_torque).any():
            label, line = f"mean torque, {titles[column]}", style.STYLES[column % 4]
            grid[row, -1].plot(time, one.mean_torque, line, color=MEAN_TORQUE, label=label)
        if np.isfinite(one.target_torque).any():
            grid[row, -1].plot(time, one.target_torque, **TARGET)
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
        known = ", ".join(unique(results.participant.values))
        raise InputError(f"figure: there is no participant {participant!r}; there are {known}")
    here = of_least_data(results.isel(recording=results.participant.values == participant))
    here = here.transpose("bootstrap", "analysis", "recording", "time", ...)
    methods, time = unique(here.method_key.values), here.time.values
    rows, cells = [], [here.isel(recording=place) for place in range(here.sizes["recording"])]
    for variable, label in LABELS.items():
        is_vaf = variable == "time_varying_vaf"
        for cell in cells:
            text = f"{perturbation_name(cell.perturbation.item())}\n{label}"
            truth = np.nan if is_vaf else cell.truth.values
            rows.append(style.Row(text, cell[variable].values, truth, is_vaf))
    if np.isfinite(here.target_torque).any():
        nothing = np.full((1, len(methods), len(time)), np.nan)
        rows.append(style.Row("torque\n(N·m)", nothing, here.target_torque.values[0]))
    width, height = max(1.25 * len(methods), 2.6) + 0.84, 1.35 * len(rows) + 1.1
    figure = style.blank(width, height, title)
    grid = style.rows_by_method(figure, rows, methods, headings(here, 15), time)
    for (first, *_), row in zip(grid[: 2 * len(cells)], rows, strict=False):
        if row.is_vaf:
            first.set_ylim(0, 102)
        else:  # one scale for all perturbations
            style.limit_to_usual(first, here.estimate.transpose("analysis", ...).values, here.truth)
    several = here.sizes["bootstrap"] > 1
    text = "mean over bootstraps ± 2 standard deviations" if several else "the only bootstrap"
    return style.finish(figure, text)


@style.styled
def variance_and_spread(summary: pd.DataFrame, title: str = "") -> Figure:
    """Draw VAF, band-passed VAF and random error at every amount of data.

    A row for each perturbation, a column for each metric. A bar is the mean over participants, with
    twice their standard deviation on either side, and a dot is one participant; below a method
    stand the realizations drawn for its bars.

    Parameters
    ----------
    summary
        Of an experiment: columns participant, perturbation, method, realizations, metric, value.
    """
    figure = style.blank(_width(summary, SPREAD), 1.9 * summary.perturbation.nunique() + 1.2, title)
    _draw_bars(figure, summary, SPREAD)
    return style.finish(figure, CAPTION)


@style.styled
def error_against_truth(results: xr.Dataset, summary: pd.DataFrame, title: str = "") -> Figure:
    """Draw the error of the mean stiffness over bootstraps, where the truth is known.

    Above, the error over time: a column for each method with the fewest realizations that it was
    given, a row for each perturbation, a thin line for each participant and a thick one for their
    mean. Below, bars of the bias error and of the mean bias as in :func:`variance_and_spread`.

    Parameters
    ----------
    results, summary
        Of an experiment, as of :func:`stiffness_of_participants` and :func:`variance_and_spread`.
    """
    here = of_least_data(results)
    here = here.isel(recording=np.isfinite(here.truth.values).any(axis=1))
    perturbations, methods = (unique(here[name].values) for name in ("perturbation", "method_key"))
    labels = [f"{perturbation_name(each)}\nestimate − truth\n(N·m/rad)" for each in perturbations]
    heights = [1.35 * len(labels) + 0.6, 1.8 * len(labels) + 0.5]
    width = max(1.45 * len(methods) + 0.8, _width(summary, AGAINST_TRUTH))
    figure = style.blank(width, sum(heights) + 0.6, title)
    above, below = figure.subfigures(2, 1, squeeze=False, height_ratios=heights)[:, 0]
    grid = style.grid_of(
        above,
        len(labels),
        len(methods),
        xlabel="time (s)",
        ylabels=labels,
        headings=headings(here, 18),
        sharex=True,
        sharey=True,
    )
    draws = here.estimate.transpose("bootstrap", "analysis", "recording", "time").values
    errors = mean_and_spread(draws)[0] - here.truth.values
    for row, perturbation in zip(grid, perturbations, strict=True):
        mine = errors[:, here.perturbation.values == perturbation]
        for axes, look, each in zip(row, style.lines(methods).values(), mine, strict=True):
            color = look["color"]
            axes.axhline(0, color=style.INK, linestyle="--")
            axes.plot(here.time, each.T, color=color, linewidth=0.6, alpha=0.45)
            style.curve(axes, here.time.values, mean_known(each), color=color, linewidth=2.0)
    _draw_bars(below, summary, AGAINST_TRUTH)
    return style.finish(figure, CAPTION)


def _width(summary: pd.DataFrame, metrics: Mapping[str, str]) -> float:
    """Return the width in inches of a figure with a column of bars for each metric."""
    return len(metrics) * max(0.65 + 0.72 * summary.method.nunique(), 2.1)


def _draw_bars(part: Any, summary: pd.DataFrame, metrics: Mapping[str, str]) -> None:
    """Draw bars: a row of axes for each perturbation, a column for each metric."""
    amounts = {
        str(method): sorted(rows.realizations.unique())
        for method, rows in summary.groupby("method", sort=False)
    }
    below = [
        f"{wrapped(method, 12)}\n{' | '.join(f'{amount:g}' for amount in several)}"
        for method, several in amounts.items()
    ]
    is_crowded = max(map(len, "\n".join(below).split("\n"))) > MAX_ABREAST
    perturbations = unique(summary.perturbation)
    rows, columns = len(perturbations), len(metrics)
    grid = style.grid_of(part, rows, columns, sharex=True, sharey="col")
    for (row, column), axes in np.ndenumerate(grid):
        perturbation, metric = perturbations[row], list(metrics)[column]
        is_shown = (summary.perturbation == perturbation) & (summary.metric == metric)
        _draw_participants(axes, summary[is_shown], amounts)
        axes.set_title(perturbation_name(perturbation), loc="left")
        axes.set_ylabel(metrics[metric])
        axes.set_xticks(range(len(below)), below, rotation=90 * is_crowded)
        axes.grid(visible=False, axis="x")
        if "vaf" in metric:
            axes.set_ylim(0, 102)


def _draw_participants(axes: Axes, rows: pd.DataFrame, amounts: Mapping[str, list[float]]) -> None:
    """Draw each participant, and their mean with two standard deviations."""
    axes.axhline(0, color="black", linewidth=0.8)
    for place, (method, look) in enumerate(style.lines(list(amounts)).items()):
        width, color = 0.8 / len(amounts[method]), look["color"]
        opacities = np.linspace(FULL, FAINT, len(amounts[method]))[::-1]
        for number, amount in enumerate(amounts[method]):
            values = rows[(rows.method == method) & (rows.realizations == amount)].value.dropna()
            middle = place - 0.4 + (number + 0.5) * width
            fill = {"facecolor": (color, opacities[number]), "edgecolor": color}
            spread = 2 * values.std() if len(values) > 1 else None
            axes.bar(middle, values.mean(), 0.92 * width, yerr=spread, **fill)
            # Dots beside each other, so that equal ones show, in the order of the participants.
            beside = middle + np.linspace(-0.25, 0.25, len(values) + 2)[1:-1] * width
            axes.plot(beside, values, ".", color="black", alpha=0.7)
