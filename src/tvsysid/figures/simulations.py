"""Figures of a simulation study: errors over the amount of data, coverage, impulse responses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid.errors import InputError
from tvsysid.figures import style
from tvsysid.figures.results import of_quantity, unique
from tvsysid.figures.words import perturbation_name, wrapped
from tvsysid.numerics import Array

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ERRORS = {
    "debiased_bias_error": "bias error, debiased\n(N·m/rad)",
    "random_error": "random error\n(N·m/rad)",
    "total_error": "total error\n(N·m/rad)",
}
AMOUNTS = {"duration_s": "data (s)", "snr_db": "signal-to-noise ratio (dB)"}
NOMINAL = 95.0
# seconds over which the share of trials is averaged: of a hundred trials it is a coarse number
SMOOTHED = 0.05


@style.styled
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
    perturbations, methods = unique(rows.perturbation), unique(rows.method)
    columns = len(perturbations)
    figure, grid = style.panels(
        len(ERRORS), columns, max(3.3 * columns + 0.6, 4.0), 6.8, title, sharex=True, sharey="row"
    )
    for row, (error, label) in zip(grid, ERRORS.items(), strict=True):
        row[0].set_ylabel(label)
        here = rows[rows.metric == error]
        for axes, perturbation in zip(row, perturbations, strict=True):
            _errors(axes, here[here.perturbation == perturbation], amount, methods)
        values = here.value[np.isfinite(here.value)]
        if len(values) and values.min() > 0 and values.max() > 6 * values.min():
            row[0].set_yscale("log")
            style.log_ticks(row[0].yaxis)
        else:
            row[0].set_ylim(bottom=0)
    for axes, perturbation in zip(grid[0], perturbations, strict=True):
        axes.set_title(perturbation_name(perturbation))
    for axes in grid[-1]:
        axes.set_xlabel(AMOUNTS[amount])
    figure.align_ylabels(grid[:, 0])
    style.legend_below(figure, style.method_keys(methods))
    return figure


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
    methods = unique(rows.method)
    figure, ((axes,),) = style.panels(1, 1, 4.6, 3.8, title)
    axes.axhline(0, color=style.INK, linestyle="--")
    _errors(axes, rows, "size", methods)
    axes.set_xlabel(what)
    axes.set_ylabel(error)
    style.legend_below(figure, style.method_keys(methods))
    return figure


def _errors(axes: Axes, rows: pd.DataFrame, amount: str, methods: Sequence[str]) -> None:
    """Draw a value with its standard error over an amount, a line for each method."""
    for method, look in style.lines(methods).items():
        line = rows[rows.method == method].sort_values(amount)
        bars: dict[str, Any] = look.line | {"yerr": line.standard_error.fillna(0.0)}
        axes.errorbar(line[amount], line.value, linewidth=1.2, label=wrapped(method, 40), **bars)
    ticks = sorted(rows[amount].unique())
    if ticks and ticks[0] > 0 and ticks[-1] > 10 * ticks[0]:
        axes.set_xscale("log")
        axes.minorticks_off()
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])


@style.styled
def coverage_over_time(results: xr.Dataset, scenarios: Sequence[str], title: str = "") -> Figure:
    """Draw the coverage of the 95 % band over a realization, a line for each method.

    It is the mean over 0.05 s and over trials that have a band at each time, as in
    :func:`tvsysid.metrics.coverage`; no line where none has. The scenarios, given by their labels,
    have an axes each, with the true stiffness below.
    """
    methods, time = unique(results.method_key.values), results.time.values
    figure, grid = style.panels(
        2,
        len(scenarios),
        3.6 * len(scenarios) + 0.8,
        4.4,
        title,
        sharex=True,
        sharey="row",
        height_ratios=(3, 1),
    )
    looks, shown = style.lines(methods), set()
    for (above, below), scenario in zip(grid.T, scenarios, strict=True):
        cell = of_quantity(results).sel(scenario=scenario)
        for place, (method, look) in enumerate(looks.items()):
            share = _averaged(cell.covered.sel(method_key=method).values, time)
            if np.isfinite(share).any():
                curve = look.curve(len(time), place, len(looks))
                above.plot(time, share, linewidth=1.4, label=method, **curve)
                shown.add(method)
        above.axhline(NOMINAL, color=style.INK, linestyle=":", linewidth=1.2)
        above.set_ylim(-2, 102)
        above.set_title(perturbation_name(cell.perturbation.item()))
        below.plot(time, cell.truth.values, color=style.TRUTH, linewidth=1.4)
        below.set_xlabel(style.REALIZATION_TIME)
        below.margins(x=0)
    grid[0, 0].set_ylabel("trials whose 95 % band\nholds the truth (%)")
    grid[1, 0].set_ylabel("true stiffness\n(N·m/rad)")
    keys = [style.line_key(name, **looks[name].line) for name in methods if name in shown]
    nominal = style.line_key("nominal", color=style.INK, linestyle=":")
    style.legend_below(figure, [*keys, nominal])
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
    count, methods = responses.sizes["instant"], unique(responses.method_key.values)
    figure, grid = style.panels(
        1, count, max(3.2 * count + 0.6, 4.0), 3.6, title, sharex=True, sharey=True
    )
    for axes, instant in zip(grid[0], responses.instant.values, strict=True):
        here = responses.sel(instant=instant)
        axes.plot(here.lag, here.true_impulse_response, **style.TRUE_LINE | {"linewidth": 5})
        for number, (method, look) in enumerate(style.lines(methods).items()):
            # Dashes begin at different places, so that lines on top of each other all show.
            curve = look.curve(here.sizes["lag"], number, len(methods))
            curve |= {"linestyle": (3.0 * number, (5.0, 2.5)), "linewidth": 1.5}
            response = here.impulse_response.sel(method_key=method)
            axes.plot(here.lag, response, label=wrapped(method, 40), **curve)
        axes.set_title(f"k = {float(here.stiffness):.0f} N·m/rad, at {float(instant):g} s")
        axes.set_xlabel("lag (s)")
        axes.margins(x=0)
    grid[0, 0].set_ylabel("impulse response (N·m/(rad·s))")
    style.legend_below(figure, grid[0, 0].lines)
    return figure
