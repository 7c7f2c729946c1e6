"""How often the bands hold the truth, over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tvsysid.figures.style import TRUTH, legend_below, lines, plain
from tvsysid.figures.words import told

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

NOMINAL = 95.0
SMOOTHED = 0.05
"""Seconds over which the share of trials is averaged: of a hundred trials it is a coarse number."""


def coverage_over_time(results: xr.Dataset, scenarios: Sequence[str], title: str = "") -> Figure:
    """Share of trials in which the 95 % band holds the true stiffness, over a realization, a line for each method.

    Parameters
    ----------
    results
        As of :func:`tvsysid.study.run`.
    scenarios
        Labels of those shown, an axes each, with the true stiffness below.
    title
        Above all.

    Returns
    -------
    matplotlib.figure.Figure
        Averaged over 0.05 s, of the trials that have a band at each time; no line where none has, as in
        :func:`tvsysid.metrics.coverage`.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415  # heavy
    from matplotlib.lines import Line2D  # noqa: PLC0415  # heavy

    columns = len(scenarios)
    figure = Figure(figsize=(3.6 * columns + 0.8, 4.4), layout="constrained")
    grid = figure.subplots(2, columns, sharex=True, squeeze=False, height_ratios=(3, 1))
    methods = [str(method) for method in results.method_key.values]
    looks, time = lines(methods), results.time.values
    drawn: dict[str, Line2D] = {}
    for column, scenario in enumerate(scenarios):
        cell = results.sel(scenario=scenario)
        above, below = grid[:, column]
        for method in methods:
            covered = cell.covered.sel(method_key=method).values
            share = _averaged(covered, time)
            if np.isfinite(share).any():
                colour, style = looks[method]
                (drawn[method],) = above.plot(time, share, color=colour, linestyle=style, linewidth=1.4, label=method)
        above.axhline(NOMINAL, color=TRUTH, linestyle=":", linewidth=1.2)
        above.set_ylim(-2, 102)
        above.set_title(told(str(cell.perturbation.item())), fontsize=9)
        below.plot(time, cell.true_stiffness.values, color=TRUTH, linewidth=1.4)
        below.set_xlabel("time within a realization (s)", fontsize=8)
        below.set_xlim(time[0], time[-1] + time[1] - time[0])
    for axes in grid.ravel():
        plain(axes)
        axes.tick_params(labelsize=8)
    grid[0, 0].set_ylabel("trials whose 95 % band\nholds the truth (%)", fontsize=8)
    grid[1, 0].set_ylabel("true stiffness\n(N·m/rad)", fontsize=8)
    handles = [drawn[method] for method in methods if method in drawn]
    legend_below(figure, [*handles, Line2D([], [], color=TRUTH, linestyle=":", label="nominal")])
    figure.suptitle(title, fontsize=11)
    return figure


def _averaged(covered: Array, time: Array) -> Array:
    """Per cent of the bands over a moving window that hold the truth, shape (time,); NaN where no trial has one."""
    known = np.isfinite(covered)
    kernel = np.ones(max(1, round(SMOOTHED / (time[1] - time[0]))))
    held, told = (np.convolve(values.sum(axis=0), kernel, mode="same") for values in (np.nan_to_num(covered), known))
    return np.where(known.any(axis=0), 100 * held / np.maximum(told, 1), np.nan)
