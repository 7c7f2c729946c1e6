"""Scores of a leaderboard, and the error in each of its scenarios."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from tvsysid.figures import style
from tvsysid.figures.words import wrapped

if TYPE_CHECKING:
    import pandas as pd

MIN_ERROR = 1.0  # %, at which the scale of colours begins


@style.styled
def leaderboard(
    table: pd.DataFrame, groups: Mapping[str, Sequence[str]], title: str = ""
) -> Figure:
    """Draw scores with two standard errors, beside the error in each scenario, both logarithmic.

    Parameters
    ----------
    table
        Columns rank, entry, score, score_error, and one for each scenario, with its error in %; in
        order of score.
    groups
        Names of scenarios by what they have in common; they are numbered from 1, as the columns of
        the picture.
    """
    names = [name for group in groups.values() for name in group]
    width, places = 0.42 * len(names), np.arange(len(table))
    figure = style.blank(3.6 + width, 1.3 + 0.28 * len(table), title)
    scores, errors = figure.subplots(1, 2, sharey=True, width_ratios=(2.4, width))
    spread = 2 * table.score_error.fillna(0.0)
    scores.errorbar(table.score, places, xerr=spread, fmt="o", color=style.INK)
    scores.set_xscale("log")
    scores.margins(x=0.05)
    style.log_ticks(scores.xaxis)
    scores.set_xlabel("score (%), ± 2 standard errors")
    ranks = zip(table["rank"], table.entry, strict=True)
    scores.set_yticks(places, [f"{rank}  {wrapped(entry, 30, 2)}" for rank, entry in ranks])
    shade = LogNorm(MIN_ERROR, 100.0, clip=True)
    errors.imshow(table[names], cmap="cividis", norm=shade, aspect="auto", alpha=0.6)
    for (row, column), value in np.ndenumerate(table[names].to_numpy()):
        text = f"{value:.1f}" if value < 9.95 else f"{value:.0f}"
        errors.text(column, row, text, ha="center", va="center")
    start = 0
    for name, members in groups.items():
        errors.text(start - 0.4, -0.7, wrapped(name, 6 * len(members), 2), va="bottom")
        start += len(members)
        errors.axvline(start - 0.5, color="white", linewidth=3)
    errors.set_xticks(range(len(names)), [*map(str, range(1, len(names) + 1))])
    errors.grid(visible=False)
    errors.tick_params(left=False)
    errors.set_xlabel("error in each scenario (%)")
    return figure
