"""Figures of a simulation study: errors over the amount of data, coverage, impulse responses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid.errors import InputError
from tvsysid.figures.results import covered, truth, unique
from tvsysid.figures.style import (
    INK,
    REALIZATION_TIME,
    TRUE_LINE,
    TRUTH,
    legend_below,
    line_key,
    lines,
    panels,
    styled,
)
from tvsysid.figures.words import perturbation_name, wrapped
from tvsysid.numerics import Array

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

ERRORS = {
    "debiased_bias_error": "bias error, debiased\n(N·m/rad)",
    "random_error": "random error\n(N·m/rad)",
    "total_error": "total error\n(N·m/rad)",
}
AMOUNTS = {"duration_s": "data (s)", "snr_db": "signal-to-noise ratio (dB)"}
NOMINAL = 95.0
# seconds over which the share of trials is averaged: of a hundred trials it is a coarse number
SMOOTHED = 0.05


@styled
def error_against_amount(summary: pd.DataFrame, title: str = "") -> Figure:
    """Draw bias, random and total error over the amount of data, by method: value ± standard error.

    A row for each error, a column for each perturbation.

    Parameters
    ----------
    summary
        Rows of a study's summary for one stiffness profile and viscosity, with several durations
        and one signal-to-noise ratio, or the other way round: ``InputError`` if both vary. Data
        without noise have no place on the axis of ratios and are left out.
    """
    several = [name for name in AMOUNTS if summary[name].nunique() > 1]
    if len(several) > 1:
        raise InputError(
            "error_against_amount: durations and signal-to-noise ratios both vary; give the rows "
            "of one duration or of one ratio"
        )
    amount = several[0] if several else "duration_s"
    rows = summary[np.isfinite(summary[amount])]
    perturbations, looks = list(rows.perturbation.unique()), lines(list(rows.method.unique()))
    columns = max(len(perturbations), 1)
    figure, grid = panels(
        len(ERRORS), columns, max(3.3 * columns + 0.6, 4.0), 6.8, title, sharex=True, sharey="row"
    )
    for column, perturbation in zip(grid.T, perturbations, strict=False):
        there = rows[rows.perturbation == perturbation]
        column[0].set_title(perturbation_name(perturbation))
        column[-1].set_xlabel(AMOUNTS[amount])
        for axes, error in zip(column, ERRORS, strict=True):
            for method, look in looks.items():
                line = there[(there.metric == error) & (there.method == method)].sort_values(amount)
                bars: dict[str, Any] = look.line | {
                    "yerr": line.standard_error.fillna(0.0),
                    "capsize": 2,
                }
                axes.errorbar(
                    line[amount], line.value, linewidth=1.2, label=wrapped(method, 40), **bars
                )
    ticks = sorted(rows[amount].unique())
    if amount == "duration_s":
        grid[0, 0].set_xscale("log")
    grid[0, 0].set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    grid[0, 0].minorticks_off()
    for axes, (error, label) in zip(grid[:, 0], ERRORS.items(), strict=True):
        axes.set_ylabel(label)
        _scale(axes, rows[rows.metric == error].value.to_numpy(dtype=float))
    figure.align_ylabels(grid[:, 0])
    legend_below(figure, grid[0, 0].get_legend_handles_labels()[0])
    return figure


@styled
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
    looks = lines(unique(rows.method))
    figure, grid = panels(1, 1, 4.6, 3.8, title)
    axes = grid[0, 0]
    axes.axhline(0, color=INK, linestyle="--", linewidth=1.0)
    for method, look in looks.items():
        line = rows[rows.method == method].sort_values("size")
        bars: dict[str, Any] = look.line | {"yerr": line.standard_error.fillna(0.0), "capsize": 2}
        axes.errorbar(line["size"], line.value, linewidth=1.2, label=wrapped(method, 40), **bars)
    sizes = sorted(rows["size"].unique())
    if sizes[0] > 0 and sizes[-1] > 20 * sizes[0]:
        axes.set_xscale("log")
        axes.minorticks_off()
    axes.set_xticks(sizes, [f"{size:g}" for size in sizes])
    axes.set_xlabel(what)
    axes.set_ylabel(error)
    legend_below(figure, axes.get_legend_handles_labels()[0])
    return figure


def _scale(axes: Axes, values: Array) -> None:
    """Use a logarithmic scale with plain numbers if values span most of a decade.

    From zero otherwise.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter  # noqa: PLC0415  # heavy

    known = values[np.isfinite(values)]
    if known.size and known.min() > 0 and known.max() > 6 * known.min():
        axes.set_yscale("log")
        axes.set_ylim(0.8 * known.min(), 1.25 * known.max())
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
    else:
        axes.set_ylim(bottom=0)


@styled
def coverage_over_time(results: xr.Dataset, scenarios: Sequence[str], title: str = "") -> Figure:
    """Draw the coverage of the 95 % band over a realization, a line for each method.

    It is the mean over 0.05 s and over trials that have a band at each time, as in
    :func:`tvsysid.metrics.coverage`; no line where none has. The scenarios, given by their labels,
    have an axes each, with the true stiffness below.
    """
    figure, grid = panels(
        2,
        len(scenarios),
        3.6 * len(scenarios) + 0.8,
        4.4,
        title,
        sharex=True,
        sharey="row",
        height_ratios=(3, 1),
    )
    looks, time = lines(unique(results.method_key.values)), results.time.values
    drawn: dict[str, Line2D] = {}
    for (above, below), scenario in zip(grid.T, scenarios, strict=True):
        cell = results.sel(scenario=scenario)
        for place, (method, look) in enumerate(looks.items()):
            share = _averaged(covered(cell).sel(method_key=method).values, time)
            if np.isfinite(share).any():
                curve = look.curve(len(time), place, len(looks))
                (drawn[method],) = above.plot(time, share, linewidth=1.4, label=method, **curve)
        above.axhline(NOMINAL, color=INK, linestyle=":", linewidth=1.2)
        above.set_ylim(-2, 102)
        above.set_title(perturbation_name(cell.perturbation.item()))
        below.plot(time, truth(cell).values, color=TRUTH, linewidth=1.4)
        below.set_xlabel(REALIZATION_TIME)
        below.set_xlim(time[0], time[-1] + time[1] - time[0])
        # Few ticks keep the labels of neighbouring axes apart
        below.locator_params(axis="x", nbins=5)
    grid[0, 0].set_ylabel("trials whose 95 % band\nholds the truth (%)")
    grid[1, 0].set_ylabel("true stiffness\n(N·m/rad)")
    handles = [drawn[method] for method in looks if method in drawn]
    legend_below(figure, [*handles, line_key("nominal", color=INK, linestyle=":")])
    return figure


def _averaged(held: Array, time: Array) -> Array:
    """Return the coverage of the bands in per cent over a moving window, shape (time,).

    NaN where no trial has one.
    """
    known = np.isfinite(held)
    kernel = np.ones(max(1, round(SMOOTHED / (time[1] - time[0]))))
    hits, bands = (
        np.convolve(values.sum(axis=0), kernel, mode="same")
        for values in (np.nan_to_num(held), known)
    )
    return np.where(known.any(axis=0), 100 * hits / np.maximum(bands, 1), np.nan)


@styled
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
    figure, grid = panels(
        1, count, max(3.2 * count + 0.6, 4.0), 3.6, title, sharex=True, sharey=True
    )
    methods = [str(name) for name in responses.method_key.values]
    for axes, instant in zip(grid[0], responses.instant.values, strict=True):
        here = responses.sel(instant=instant)
        axes.plot(here.lag, here.true_impulse_response, **TRUE_LINE | {"linewidth": 5})
        for number, (method, look) in enumerate(lines(methods).items()):
            # Dashes begin at different places, so that lines on top of each other all show.
            curve = look.curve(here.sizes["lag"], number, len(methods)) | {
                "linestyle": (3.0 * number, (5.0, 2.5))
            }
            response = here.impulse_response.sel(method_key=method)
            axes.plot(here.lag, response, linewidth=1.5, label=wrapped(method, 40), **curve)
        axes.set_title(f"k = {float(here.stiffness):.0f} N·m/rad, at {float(instant):g} s")
        axes.set_xlabel("lag (s)")
        axes.margins(x=0)
    grid[0, 0].set_ylabel("impulse response (N·m/(rad·s))")
    legend_below(figure, grid[0, 0].lines)
    return figure
