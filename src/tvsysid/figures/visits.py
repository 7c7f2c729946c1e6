"""Stiffness of one person at one visit or several."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
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


@style.styled
def stiffness_of_visits(visits: Sequence[Visit], title: str = "") -> Figure:
    """Draw stiffness over time with its 95 % band, a line for each visit.

    Beside it, if there are several, means with their bands, and extremes over the visits.
    """
    figure = style.blank(9.0, 3.2, title)  # a third of a page of A4
    ratios = [2.2, 1][: len(visits)]
    grid = figure.subplots(1, len(ratios), squeeze=False, width_ratios=ratios, sharey=True)
    axes, *beside = grid[0]
    for place, visit in enumerate(visits):
        look = {"color": style.PALETTE[place], "linestyle": style.STYLES[place % 4]}
        band = visit.lower, visit.upper
        style.curve(
            axes,
            visit.time,
            visit.stiffness,
            band,
            label=visit.label if len(visits) > 1 else None,
            **look,
        )
    axes.set(xlabel=style.REALIZATION_TIME, ylabel="stiffness (N·m/rad), 95 % band")
    for each in beside:
        _draw_means(each, visits)
    return style.finish(figure)


def _draw_means(axes: Axes, visits: Sequence[Visit]) -> None:
    for place, visit in enumerate(visits):
        if np.isfinite(visit.stiffness).any():
            ends = np.nanmin(visit.stiffness), np.nanmax(visit.stiffness)
            axes.plot([place, place], ends, ":_", color=style.INK)
            mean, half = mean_of(visit.stiffness), mean_of(visit.upper - visit.lower) / 2
            color = style.PALETTE[place]
            axes.errorbar(place, mean, np.nan_to_num(half), fmt="o", color=color, capsize=4)
    axes.set_xticks(range(len(visits)), [*map(str, range(1, len(visits) + 1))])
    axes.margins(x=0.2)
    axes.set(xlabel="visit", title="mean over time; lowest and highest")
