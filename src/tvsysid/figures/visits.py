"""Stiffness of one person at one visit or several."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tvsysid.figures import style
from tvsysid.numerics import Array
from tvsysid.numerics.bands import mean_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH, HEIGHT = 9.0, 2.9  # inches: a third of a page of A4


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
    several = len(visits) > 1
    ratios = [2.2, 1][: 1 + several]
    figure, grid = style.panels(
        1, len(ratios), WIDTH, HEIGHT + 0.3 * several, title, width_ratios=ratios
    )
    axes, beside, keys = grid[0, 0], grid[0, -1], []
    for place, visit in enumerate(visits):
        look: dict[str, Any] = {
            "color": style.PALETTE[place % len(style.PALETTE)],
            "linestyle": style.STYLES[place % len(style.STYLES)],
        }
        band = (visit.lower, visit.upper)
        style.curve_with_band(
            axes, visit.time, visit.stiffness, band, look["color"], linewidth=1.8, **look
        )
        keys.append(style.line_key(visit.label, **look))
        if several:
            ends = np.fmin.reduce(visit.stiffness), np.fmax.reduce(visit.stiffness)
            beside.plot([place, place], ends, ":", marker="_", color=style.GREY)
            half = np.nan_to_num(visit.half_band)
            beside.errorbar(place, visit.mean, half, fmt="o", color=look["color"], capsize=4)
    axes.set_xlabel(style.REALIZATION_TIME)
    axes.set_ylabel("stiffness (N·m/rad), 95 % band")
    if several:
        beside.set_xticks(range(len(visits)), [str(place + 1) for place in range(len(visits))])
        beside.margins(x=0.2)
        beside.set_xlabel("visit")
        beside.set_ylabel("mean over time; lowest and highest (N·m/rad)")
        style.legend_below(figure, keys)
    return figure
