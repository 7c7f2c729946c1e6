"""One look for all figures, and how they reach a file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from tvsysid.methods import names
from tvsysid.recordings import whole_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's palette: told apart by people who are colour-blind.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
TRUTH = "#444444"


def colour(method: str, place: int = 0) -> str:
    """Colour of a method: its own for one of the five, else by its place among those shown."""
    key = method.partition(":")[0]
    known = names()
    index = known.index(key) if method in known else (len(known) + place)
    return PALETTE[index % len(PALETTE)]


def plain(axes: Axes) -> Axes:
    """Axes without the box's upper and right side, with a light grid."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25, linewidth=0.6)
    return axes


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure whole; its format is told by the ending."""
    with whole_file(path) as temporary:
        figure.savefig(temporary, dpi=150)
