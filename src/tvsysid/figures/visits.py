"""Stiffness of one person at one visit or several."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tvsysid.figures import style
from tvsysid.numerics import Array
from tvsysid.numerics.bands import mean_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
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

    Beside it means and extremes over the visits.
    """
    if len(visits) == 1:
        figure, grid = style.panels(1, 1, WIDTH, HEIGHT, title)
    else:
        figure, grid = style.panels(1, 2, WIDTH, HEIGHT + 0.3, title, width_ratios=[2.2, 1])
        _over_visits(grid[0, 1], visits)
    axes, keys = grid[0, 0], []
    for place, each in enumerate(visits):
        hue, dash = (
            style.PALETTE[place % len(style.PALETTE)],
            style.STYLES[place % len(style.STYLES)],
        )
        band = (each.lower, each.upper)
        style.curve_with_band(
            axes, each.time, each.stiffness, band, hue, linestyle=dash, linewidth=1.8
        )
        keys.append(style.line_key(each.label, color=hue, linestyle=dash))
    axes.set_xlabel(style.REALIZATION_TIME)
    axes.set_ylabel("stiffness (N·m/rad), 95 % band")
    if len(visits) > 1:
        style.legend_below(figure, keys)
    return figure


def _over_visits(axes: Axes, visits: Sequence[Visit]) -> None:
    """Draw the mean over time with the mean half width of its band, and both extremes."""
    places = np.arange(len(visits))
    ends = [(np.fmin.reduce(each.stiffness), np.fmax.reduce(each.stiffness)) for each in visits]
    axes.vlines(places, *np.transpose(ends), color=style.GREY, linewidth=1.0, linestyle=":")
    for row, marker in zip(np.transpose(ends), ("v", "^"), strict=True):
        axes.plot(places, row, marker, color=style.GREY, markersize=4, linestyle="none")
    for place, each in enumerate(visits):
        hue, band = style.PALETTE[place % len(style.PALETTE)], np.nan_to_num(each.half_band)
        axes.errorbar(
            place, each.mean, band, fmt="o", color=hue, markersize=5, capsize=4, elinewidth=1.4
        )
    axes.set_xticks(places, [str(place + 1) for place in places])
    axes.set_xlim(-0.5, len(visits) - 0.5)
    axes.set_xlabel("visit")
    axes.set_ylabel("mean over time; lowest and highest (N·m/rad)")
