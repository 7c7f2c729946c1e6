"""Metrics of all participants, and errors against the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tvsysid.figures import style
from tvsysid.figures.results import headings, label_time, of_least_data, unique
from tvsysid.figures.words import perturbation_name, wrapped
from tvsysid.numerics.bands import mean_and_spread

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SPREAD = {
    "vaf": "VAF (%)",
    "bandpassed_vaf": "VAF, 1–10 Hz (%)",
    "random_error": "random error (N·m/rad)",
}
AGAINST_TRUTH = {"bias_error": "bias error (N·m/rad)", "mean_bias": "mean bias (N·m/rad)"}
FAINT, FULL = 0.35, 0.85  # opacity of the bars for the least and the most data


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
    rows, width = summary.perturbation.nunique(), _width(summary, len(SPREAD))
    figure, grid = style.panels(
        rows, len(SPREAD), width, 1.9 * rows + 1.2, title, sharex=True, sharey="col"
    )
    _rows_of_bars(grid, summary, SPREAD)
    style.legend_below(figure, _keys(summary))
    return figure


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
    rows = max(len(perturbations), 1)
    heights = [1.35 * rows + 0.6, 1.8 * rows + 0.5]
    width = max(1.45 * len(methods) + 0.8, _width(summary, len(AGAINST_TRUTH)))
    figure = style.blank(width, sum(heights) + 0.6, title)
    above, below = figure.subfigures(2, 1, height_ratios=heights, squeeze=False)[:, 0]
    grid = above.subplots(rows, len(methods), sharex=True, sharey=True, squeeze=False)
    draws = here.estimate.transpose("bootstrap", "analysis", "recording", "time").values
    off = mean_and_spread(draws)[0] - here.truth.values
    for row, perturbation in zip(grid, perturbations, strict=False):
        which = f"{_words(perturbation)}\n" if len(perturbations) > 1 else ""
        row[0].set_ylabel(f"{which}estimate − truth\n(N·m/rad)")
        errors = off[:, here.perturbation.values == perturbation]
        for axes, hue, each in zip(row, style.hues(methods).values(), errors, strict=True):
            axes.axhline(0, color=style.INK, linestyle="--")
            axes.plot(here.time, each.T, color=hue, linewidth=0.6, alpha=0.45)
            mean, _ = mean_and_spread(each)
            style.curve_with_band(axes, here.time.values, mean, None, hue, linewidth=2.0)
    grid[0, 0].set_ylim(style.usual_limits(off, np.zeros(1)))
    for axes, heading in zip(grid[0], headings(here, 18), strict=True):
        axes.set_title(heading, fontsize=8.5)
    label_time(grid[-1], here)
    lower = below.subplots(rows, len(AGAINST_TRUTH), sharex=True, sharey="col", squeeze=False)
    _rows_of_bars(lower, summary, AGAINST_TRUTH)
    style.legend_below(figure, _keys(summary))
    return figure


def _rows_of_bars(grid: NDArray[Any], summary: pd.DataFrame, metrics: Mapping[str, str]) -> None:
    """Draw bars: a row of axes for each perturbation, a column for each metric."""
    perturbations, methods = unique(summary.perturbation), unique(summary.method)
    for row, perturbation in zip(grid, perturbations, strict=False):
        for axes, (metric, label) in zip(row, metrics.items(), strict=True):
            rows = summary[(summary.perturbation == perturbation) & (summary.metric == metric)]
            _bars(axes, rows, methods)
            axes.set_title(_words(perturbation) if len(grid) > 1 else "", fontsize=8.5, loc="left")
            axes.set_ylabel(label)
            if "vaf" in metric:
                axes.set_ylim(0, 102)
    for axes in grid[-1]:
        axes.set_xlabel("method, realizations drawn")


def _bars(axes: Axes, rows: pd.DataFrame, methods: Sequence[str]) -> None:
    """Draw each participant, and their mean with two standard deviations."""
    axes.axhline(0, color="black", linewidth=0.8)
    for place, (method, hue) in enumerate(style.hues(methods).items()):
        amounts = list(rows[rows.method == method].groupby("realizations").value)
        width = 0.8 / max(len(amounts), 1)
        opacities = np.linspace(FAINT, FULL, len(amounts)) if len(amounts) > 1 else [FULL]
        for number, ((_, values), opacity) in enumerate(zip(amounts, opacities, strict=False)):
            known, middle = values.dropna(), place + (number - (len(amounts) - 1) / 2) * width
            if not len(known):
                axes.text(middle, 0, "–", ha="center", va="bottom", fontsize=10)
                continue
            look: dict[str, Any] = {
                "facecolor": (hue, float(opacity)),
                "edgecolor": hue,
                "linewidth": 0.8,
            }
            reach = 2 * float(known.std()) if len(known) > 1 else None
            axes.bar(middle, known.mean(), 0.92 * width, yerr=reach, **look)
            # Dots beside each other, so that equal ones show, in the order of the participants.
            beside = np.linspace(-0.25, 0.25, len(known) + 2)[1:-1] * width
            axes.plot(middle + beside, known, ".", color="black", markersize=3.6, alpha=0.7)
    axes.set_xticks(range(len(methods)), [_below(rows, method) for method in methods])
    axes.tick_params(axis="x", length=0)
    axes.grid(visible=False, axis="x")


def _width(summary: pd.DataFrame, columns: int) -> float:
    """Return the width in inches of a figure with so many columns of bars and their labels."""
    methods = unique(summary.method)
    below = [line for method in methods for line in _below(summary, method).split("\n")]
    longest = max(map(len, below), default=0)
    return columns * max(0.65 + max(0.58, 0.075 * longest) * len(methods), 2.1)


def _below(rows: pd.DataFrame, method: str) -> str:
    """Return the text below the bars of a method: its label and the number of realizations."""
    amounts = sorted(rows.realizations[rows.method == method].unique())
    return "\n".join((wrapped(method, 12), " | ".join(f"{amount:g}" for amount in amounts))).strip()


def _words(perturbation: str) -> str:
    return wrapped(perturbation_name(perturbation), 40)


def _keys(summary: pd.DataFrame) -> list[Any]:
    keys = []
    if summary.groupby("method").realizations.nunique().max() > 1:
        shades = {"least data": FAINT, "most data": FULL}
        keys = [
            style.patch_key(label, color="#555555", alpha=opacity)
            for label, opacity in shades.items()
        ]
    if summary.participant.nunique() > 1:
        keys.append(style.line_key("± 2 SD over participants", color="black", marker="|"))
    return [*keys, style.line_key("one participant", color="black", marker=".", linestyle="")]
