"""One look for all figures, and how they reach a file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tvsysid.methods import METHODS, key_of
from tvsysid.recordings import whole_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's palette: told apart by people who are colour-blind.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
TRUTH = "#444444"


STYLES = ("-", "--", ":", "-.")


def lines(methods: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Colour and line style of each method shown: a method's own colour, and a style for each of its settings."""
    known = tuple(METHODS)  # what else is installed must not change their colours
    others: list[str] = []
    seen: dict[str, int] = {}
    shown = {}
    for method in methods:
        key = key_of(method)
        if key not in known and key not in others:
            others.append(key)
        index = known.index(key) if key in known else len(known) + others.index(key)
        seen[key] = seen.get(key, -1) + 1
        shown[method] = (PALETTE[index % len(PALETTE)], STYLES[seen[key] % len(STYLES)])
    return shown


def plain(axes: Axes) -> Axes:
    """Axes without the box's upper and right side, with a light grid."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25, linewidth=0.6)
    return axes


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure whole; its format is told by the ending."""
    from matplotlib import rc_context  # noqa: PLC0415  # heavy

    # Journals refuse the Type 3 fonts that are Matplotlib's default.
    with whole_file(path) as temporary, rc_context({"pdf.fonttype": 42}):
        figure.savefig(temporary, dpi=150)
