"""Who stands where on a leaderboard, and by which scenarios."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tvsysid.figures.style import INK, blank, styled
from tvsysid.figures.words import wrapped
from tvsysid.numerics import Array

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEAST = 1.0  # %: where colours and axes begin
PAD = 0.2  # inches beside the axes, for browsers whose letters are wider
DARK = 0.45  # share of the colours on which print is white


@styled
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
    figure = blank(3.6 + 0.42 * len(names), 1.3 + 0.28 * len(table), title)
    figure.set_layout_engine("constrained", w_pad=PAD)
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(2.4, 0.42 * len(names)))
    places = np.arange(len(table))
    spread = 2 * table.score_error.fillna(0.0).to_numpy()
    _dots(left, table.score.to_numpy(), spread, places)
    texts = [
        f"{rank}  {wrapped(entry, 30, 2)}"
        for rank, entry in zip(table["rank"], table.entry, strict=True)
    ]
    left.set_yticks(places, texts)
    left.set_ylim(len(table) - 0.5, -0.5)
    _heat(right, table[names].to_numpy(), groups)
    return figure


def _dots(axes: Axes, scores: Array, spread: Array, places: NDArray[np.int64]) -> None:
    from matplotlib.ticker import FuncFormatter, NullFormatter  # noqa: PLC0415  # heavy

    lower = np.minimum(spread, 0.99 * scores)  # none of a score may be below 0
    axes.errorbar(
        scores,
        places,
        xerr=(lower, spread),
        fmt="o",
        color=INK,
        markersize=4,
        capsize=2,
        linewidth=1.2,
    )
    axes.set_xscale("log")
    axes.set_xlim(min(LEAST, 0.8 * float(scores.min())), 100.0)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("score (%), ± 2 standard errors")


def _heat(axes: Axes, errors: Array, groups: Mapping[str, Sequence[str]]) -> None:
    from matplotlib import colormaps  # noqa: PLC0415  # heavy
    from matplotlib.colors import LogNorm  # noqa: PLC0415

    scale = LogNorm(LEAST, 100.0, clip=True)
    axes.imshow(errors, cmap=colormaps["cividis"], norm=scale, aspect="auto")
    for (row, column), value in np.ndenumerate(errors):
        text = f"{value:.1f}" if value < 9.95 else f"{value:.0f}"
        axes.text(
            column,
            row,
            text,
            ha="center",
            va="center",
            color="white" if scale(value) < DARK else "black",
        )
    count, start = errors.shape[1], 0
    axes.set_xticks(range(count), [str(number + 1) for number in range(count)])
    for name, members in groups.items():
        middle = start + (len(members) - 1) / 2
        axes.text(middle, -0.7, wrapped(name, 6 * len(members), 2), ha="center", va="bottom")
        start += len(members)
        axes.axvline(start - 0.5, color="white", linewidth=3)
    axes.grid(visible=False)
    axes.tick_params(left=False, labelleft=False)
    axes.set_xlabel("error in each scenario (%)")
