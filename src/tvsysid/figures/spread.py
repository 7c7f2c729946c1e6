"""Metrics of all participants, and errors against the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tvsysid.figures.results import (
    headings,
    label_time,
    least_data,
    mean_stiffness,
    truth,
    unique,
    usual_range,
)
from tvsysid.figures.style import (
    INK,
    blank,
    hues,
    legend_below,
    line_key,
    panels,
    patch_key,
    remark,
    styled,
)
from tvsysid.figures.words import perturbation_name, wrapped
from tvsysid.numerics.bands import mean_and_spread

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

SPREAD = {
    "vaf": "VAF (%)",
    "bandpassed_vaf": "VAF, 1–10 Hz (%)",
    "random_error": "random error (N·m/rad)",
}
POSSIBLE = {"vaf": (0.0, 100.0), "bandpassed_vaf": (0.0, 100.0), "mean_bias": (-np.inf, np.inf)}
"""Lowest and highest value that a metric can have; from 0 upwards where nothing is said."""
AGAINST_TRUTH = {"bias_error": "bias error (N·m/rad)", "mean_bias": "mean bias (N·m/rad)"}
# an axis ends at this multiple of the upper quartile, so that one participant does not hide the
# others
OUTLYING = 5.0
FAINT, FULL = 0.35, 0.85  # opacity of the bars for the least and the most data


@styled
def variance_and_spread(summary: pd.DataFrame, title: str = "") -> Figure:
    """Draw VAF, band-passed VAF and random error at every amount of data.

    A row for each perturbation, a column for each metric. A bar is the mean over participants, with
    twice their standard deviation on either side (within what is possible), and a dot is one
    participant; below a method stand the realizations drawn for its bars.

    Parameters
    ----------
    summary
        Of an experiment: columns participant, perturbation, method, realizations, metric, value.
    """
    perturbations, methods = unique(summary.perturbation), unique(summary.method)
    rows, width = len(perturbations), _width(summary, len(SPREAD))
    figure, grid = panels(
        rows, len(SPREAD), width, 1.9 * rows + 1.2, title, sharex=True, sharey="col"
    )
    _rows_of_bars(grid, summary, perturbations, methods, SPREAD)
    for column, metric in zip(grid.T, SPREAD, strict=True):
        column[0].set_ylim(
            0, 102 if "vaf" in metric else _top(column, summary[summary.metric == metric])
        )
        _tell_cut_off(column)
    legend_below(figure, _keys(summary))
    return figure


@styled
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
    here = results.isel(recording=np.isfinite(truth(results).values).any(axis=1))
    perturbations, methods = unique(here.perturbation.values), list(least_data(here))
    rows = max(len(perturbations), 1)
    upper, lower = 1.35 * rows + 0.6, 1.8 * rows + 0.5
    width = max(1.45 * len(methods) + 0.8, _width(summary, len(AGAINST_TRUTH)))
    figure = blank(width, upper + lower + 0.6, title)
    above, below = figure.subfigures(2, 1, height_ratios=[upper, lower], squeeze=False)[:, 0]
    _over_time(above, here, perturbations)
    grid = below.subplots(rows, len(AGAINST_TRUTH), sharex=True, sharey="col", squeeze=False)
    _rows_of_bars(grid, summary, perturbations, methods, AGAINST_TRUTH)
    for axes in grid.flat:
        axes.axhline(0, color="black", linewidth=0.8)
    grid[0, 0].set_ylim(0, _top(grid[:, 0], summary[summary.metric == "bias_error"]))
    _tell_cut_off(grid[:, 0])
    legend_below(figure, _keys(summary))
    return figure


def _over_time(figure: SubFigure, results: xr.Dataset, perturbations: Sequence[str]) -> None:
    """Draw mean estimate minus truth: a column for each method, a row for each perturbation."""
    least, titles = least_data(results), headings(results, 18)
    grid = figure.subplots(
        max(len(perturbations), 1), len(least), sharex=True, sharey=True, squeeze=False
    )
    off = mean_stiffness(results).values - truth(results).values[:, None]
    for row, perturbation in zip(grid, perturbations, strict=False):
        there = results.perturbation.values == perturbation
        for column, (axes, hue) in enumerate(zip(row, hues(list(least)).values(), strict=True)):
            axes.axhline(0, color=INK, linewidth=1.0, linestyle="--")
            errors = off[there, column]
            errors = errors[np.isfinite(errors).any(axis=1)]
            for each in errors if len(errors) > 1 else ():
                axes.plot(results.time.values, each, color=hue, linewidth=0.6, alpha=0.45)
            if len(errors):
                axes.plot(results.time.values, mean_and_spread(errors)[0], color=hue, linewidth=2.0)
            else:
                remark(axes, "no estimate")
        which = f"{_words(perturbation)}\n" if len(perturbations) > 1 else ""
        row[0].set_ylabel(f"{which}estimate − truth\n(N·m/rad)")
    low, high = usual_range(np.moveaxis(off, 1, 0), np.zeros(1))
    grid[0, 0].set_ylim(low - 0.05 * (high - low), high)
    for axes, label in zip(grid[0], least.values(), strict=True):
        axes.set_title(titles[label], fontsize=8.5)
    label_time(grid[-1], results)


def _rows_of_bars(
    grid: NDArray[Any],
    summary: pd.DataFrame,
    perturbations: Sequence[str],
    methods: Sequence[str],
    metrics: Mapping[str, str],
) -> None:
    """Draw bars: a row of axes for each perturbation, a column for each metric."""
    for row, perturbation in zip(grid, perturbations, strict=False):
        for axes, (metric, label) in zip(row, metrics.items(), strict=True):
            rows = summary[(summary.perturbation == perturbation) & (summary.metric == metric)]
            _bars(axes, rows, methods, POSSIBLE.get(metric, (0.0, np.inf)))
            axes.set_title(_words(perturbation) if len(grid) > 1 else "", fontsize=8.5, loc="left")
            axes.set_ylabel(label)


def _width(summary: pd.DataFrame, columns: int) -> float:
    """Return the width in inches of a figure with so many columns of bars and their labels."""
    methods = unique(summary.method)
    label_length = max(
        (len(line) for method in methods for line in _below(summary, method).split("\n")), default=0
    )
    return columns * max(0.65 + max(0.58, 0.075 * label_length) * len(methods), 2.1)


def _below(rows: pd.DataFrame, method: str) -> str:
    """Return the text below the bars of a method: its label and the number of realizations."""
    amounts = sorted(rows.realizations[rows.method == method].unique())
    return "\n".join((wrapped(method, 12), " | ".join(f"{amount:g}" for amount in amounts))).strip()


def _bars(
    axes: Axes, rows: pd.DataFrame, methods: Sequence[str], possible: tuple[float, float]
) -> None:
    """Draw each participant, and their mean with two standard deviations."""
    axes.grid(visible=False, axis="x")
    for place, (method, hue) in enumerate(hues(methods).items()):
        mine = rows[rows.method == method]
        amounts = sorted(mine.realizations.unique())
        width = 0.8 / max(len(amounts), 1)
        opacities = [FULL] if len(amounts) == 1 else np.linspace(FAINT, FULL, len(amounts)).tolist()
        for number, (amount, opacity) in enumerate(zip(amounts, opacities, strict=True)):
            values = mine.value[mine.realizations == amount].to_numpy(dtype=float)
            values = values[np.isfinite(values)]
            middle = place + (number - (len(amounts) - 1) / 2) * width
            if not len(values):
                axes.text(middle, 0, "–", ha="center", va="bottom", fontsize=10)
                continue
            mean = float(values.mean())
            axes.bar(
                middle, mean, 0.92 * width, facecolor=(hue, opacity), edgecolor=hue, linewidth=0.8
            )
            if len(values) > 1:
                reach = 2 * float(values.std(ddof=1))
                ends = [[min(reach, mean - possible[0])], [min(reach, possible[1] - mean)]]
                axes.errorbar(middle, mean, ends, color="black", linewidth=0.9, capsize=2.0)
            # Dots beside each other, so that equal ones show, in the order of the participants.
            beside = (
                np.linspace(-0.25, 0.25, len(values)) * width if len(values) > 1 else np.zeros(1)
            )
            axes.plot(
                middle + beside,
                values,
                ".",
                color="black",
                markersize=3.6,
                alpha=0.7,
                markeredgewidth=0,
            )
    axes.set_xticks(range(len(methods)), [_below(rows, method) for method in methods])
    if axes.get_subplotspec().is_last_row():  # type: ignore[union-attr]
        axes.set_xlabel("method, realizations drawn")
    axes.set_xlim(-0.6, len(methods) - 0.4)
    axes.tick_params(axis="x", length=0)


def _top(column: Sequence[Axes], rows: pd.DataFrame) -> float:
    """Return the upper limit that holds all that some axes show, unless it is an outlier."""
    values = rows.value.to_numpy(dtype=float)
    values = values[np.isfinite(values)]
    if not values.size:
        return 1.0
    drawn = max(float(axes.dataLim.ymax) for axes in column if np.isfinite(axes.dataLim.ymax))
    return 1.05 * min(drawn, OUTLYING * float(np.percentile(values, 75))) or 1.0


def _tell_cut_off(column: Sequence[Axes]) -> None:
    """Write the height of each bar that ends above its axes."""
    from matplotlib.patches import Rectangle  # noqa: PLC0415  # heavy

    for axes in column:
        top = axes.get_ylim()[1]
        for bar in axes.patches:
            if isinstance(bar, Rectangle) and bar.get_height() > top:
                middle = bar.get_x() + bar.get_width() / 2
                axes.annotate(f"↑ {bar.get_height():.3g}", (middle, top), ha="center", va="bottom")


def _words(perturbation: str) -> str:
    return wrapped(perturbation_name(perturbation), 40)


def _keys(summary: pd.DataFrame) -> list[Artist]:
    keys = [line_key("one participant", color="black", marker=".", linestyle="")]
    if summary.participant.nunique() > 1:
        keys.insert(
            0, line_key("± 2 SD over participants", color="black", marker="|", linewidth=0.9)
        )
    if summary.groupby("method").realizations.nunique().max() > 1:
        keys = [
            patch_key("least data", color="#555555", alpha=FAINT),
            patch_key("most data", color="#555555", alpha=FULL),
            *keys,
        ]
    return keys
