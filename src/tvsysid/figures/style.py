"""One look for all figures, and how they reach a file."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tvsysid.methods import METHODS, key_of
from tvsysid.recordings import whole_file

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's palette and two of Tol's: told apart by people who are colour-blind.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#882255", "#999933")
TRUTH = "#444444"
TARGET = "#111111"
"""Colour of the torque to be followed."""

Style = Literal["-", "--", ":", "-."]
STYLES: tuple[Style, ...] = ("-", "--", ":", "-.")


def lines(methods: Sequence[str]) -> dict[str, tuple[str, Style]]:
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
    """Axes without the box's upper and right side, with a light grid behind what is drawn."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25, linewidth=0.6)
    axes.set_axisbelow(True)
    return axes


def legend_below(figure: Figure, handles: Sequence[Artist]) -> None:
    """Legend under all axes of a figure, in as few rows as its width allows."""
    lengths = [0.5 + 0.07 * len(str(handle.get_label())) for handle in handles]
    columns = len(handles)
    while columns > 1:
        rows = -(-len(handles) // columns)
        if sum(max(lengths[first : first + rows]) for first in range(0, len(handles), rows)) <= figure.get_figwidth():
            break
        columns -= 1
    columns = -(-len(handles) // -(-len(handles) // columns))  # rows of the same length
    figure.legend(
        handles=list(handles), frameon=False, fontsize=8, loc="outside lower center", ncols=columns, columnspacing=1.4
    )


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure whole; its format is told by the ending: svg, pdf or png."""
    with whole_file(path) as temporary:
        temporary.write_bytes(drawn(figure, temporary.suffix.removeprefix(".")))


def drawn(figure: Figure, format: str) -> bytes:
    """Figure as the content of a file; the same figure gives the same bytes.

    Parameters
    ----------
    figure
        To draw.
    format
        ``"svg"`` (its text stays text), ``"pdf"`` or ``"png"``.
    """
    from matplotlib import rc_context  # noqa: PLC0415  # heavy

    if figure.get_layout_engine() is not None:
        # Lay it out once for all formats, which takes longer than drawing.
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
    # Journals refuse the Type 3 fonts that are Matplotlib's default; a file's time of birth would make each one new.
    undated = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
    content = BytesIO()
    with rc_context({"pdf.fonttype": 42, "svg.fonttype": "none", "svg.hashsalt": "tvsysid"}):
        figure.savefig(content, format=format, dpi=150, metadata=undated.get(format))
    return content.getvalue()
