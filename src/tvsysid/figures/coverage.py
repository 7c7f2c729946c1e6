"""How often the bands hold the truth, over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid.figures.results import covered, truth, unique
from tvsysid.figures.style import REALIZATION_TIME, TRUTH, Array, legend_below, line_key, lines, panels, styled
from tvsysid.figures.words import perturbation_name

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

NOMINAL = 95.0
SMOOTHED = 0.05
"""Seconds over which the share of trials is averaged: of a hundred trials it is a coarse number."""


@styled
def coverage_over_time(results: xr.Dataset, scenarios: Sequence[str], title: str = "") -> Figure:
    """Share of trials in which the 95 % band holds the true stiffness, over a realization, a line for each method.

    Parameters
    ----------
    results
        Of a simulation study.
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
    figure, grid = panels(
        2, len(scenarios), 3.6 * len(scenarios) + 0.8, 4.4, title, sharex=True, sharey="row", height_ratios=(3, 1)
    )
    looks, time = lines(unique(results.method_key.values)), results.time.values
    drawn: dict[str, Any] = {}
    for (above, below), scenario in zip(grid.T, scenarios, strict=True):
        cell = results.sel(scenario=scenario)
        for method, (colour, style) in looks.items():
            share = _averaged(covered(cell).sel(method_key=method).values, time)
            if np.isfinite(share).any():
                (drawn[method],) = above.plot(time, share, color=colour, linestyle=style, linewidth=1.4, label=method)
        above.axhline(NOMINAL, color=TRUTH, linestyle=":", linewidth=1.2)
        above.set_ylim(-2, 102)
        above.set_title(perturbation_name(cell.perturbation.item()))
        below.plot(time, truth(cell).values, color=TRUTH, linewidth=1.4)
        below.set_xlabel(REALIZATION_TIME)
        below.set_xlim(time[0], time[-1] + time[1] - time[0])
    grid[0, 0].set_ylabel("trials whose 95 % band\nholds the truth (%)")
    grid[1, 0].set_ylabel("true stiffness\n(N·m/rad)")
    handles = [drawn[method] for method in looks if method in drawn]
    legend_below(figure, [*handles, line_key("nominal", color=TRUTH, linestyle=":")])
    return figure


def _averaged(held: Array, time: Array) -> Array:
    """Per cent of the bands over a moving window that hold the truth, shape (time,); NaN where no trial has one."""
    known = np.isfinite(held)
    kernel = np.ones(max(1, round(SMOOTHED / (time[1] - time[0]))))
    hits, bands = (np.convolve(values.sum(axis=0), kernel, mode="same") for values in (np.nan_to_num(held), known))
    return np.where(known.any(axis=0), 100 * hits / np.maximum(bands, 1), np.nan)
