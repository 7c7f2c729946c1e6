"""Stiffness of one person at one visit or several."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from tvsysid.figures import style
from tvsysid.numerics import Array
from tvsysid.numerics.bands import mean_of


class Visit(NamedTuple):
    """Stiffness of one visit over time, with the limits of its 95 % band.

    NaN where there is none.
    """

    label: str
    time: Array
    stiffness: Array
    lower: Array
    upper: Array

    @property
    def mean(self) -> float:
        """Mean over time."""
        return mean_of(self.stiffness)

    @property
    def half_band(self) -> float:
        """Half width of the band, its mean over time; NaN without one."""
        return mean_of(self.upper - self.lower) / 2


@style.styled
def stiffness_of_visits(visits: Sequence[Visit], title: str = "") -> Figure:
    """Draw stiffness over time with its 95 % band, a line for each visit.

    Beside it means with their bands, and extremes over the visits.
    """
    # A third of a page of A4
    figure, grid = style.panels(1, 2, 9.0, 3.2, title, width_ratios=[2.2, 1], sharey=True)
    axes, beside = grid[0]
    for place, visit in enumerate(visits):
        look: dict[str, Any] = {
            "color": style.PALETTE[place],
            "linestyle": style.STYLES[place % len(style.STYLES)],
            "label": visit.label,
        }
        style.curve(axes, visit.time, visit.stiffness, (visit.lower, visit.upper), **look)
        if np.isfinite(visit.stiffness).any():
            ends = np.nanmin(visit.stiffness), np.nanmax(visit.stiffness)
            beside.plot([place, place], ends, ":_", color=style.INK)
            half = np.nan_to_num(visit.half_band)
            beside.errorbar(place, visit.mean, half, fmt="o", color=look["color"], capsize=4)
    axes.set(xlabel=style.REALIZATION_TIME, ylabel="stiffness (N·m/rad), 95 % band")
    beside.set_xticks(range(len(visits)), [str(place + 1) for place in range(len(visits))])
    beside.margins(x=0.2)
    beside.set(xlabel="visit", title="mean over time; lowest and highest")
    return style.finish(figure)
