"""One look for all figures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import wraps
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, ParamSpec

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import printable
from tvsysid.methods import METHODS, key_of
from tvsysid.numerics import Array

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

P = ParamSpec("P")

# Each has a contrast of 3:1 or more on white. The first six differ by 19 or more (CIEDE2000) to all
# eyes, also without
# a kind of cone (Machado et al. 2009), the next three by 11, the last by 8; markers tell methods
# apart as well.
PALETTE: tuple[str, ...] = (
    "#385997",
    "#AB0D07",
    "#0FA38C",
    "#C36AF4",
    "#8E990C",
    "#471D3C",
    "#F83976",
    "#975154",
)
PALETTE += ("#951AFE", "#371C99", "#730C25", "#7785B3", "#907646", "#19806F", "#72376E")
TRUTH = "#5E5E5E"  # wide and behind: as far from every method as they are from each other
INK = "#444444"  # lines that are no data: limits, means, zero
TARGET = "#111111"  # the torque to be followed
KEPT = "#B8B8B8"  # realizations that were kept
GREY = "#777777"  # what a legend says of all methods
TRUE_LINE: dict[str, Any] = {"color": TRUTH, "linewidth": 2.6, "label": "truth"}
REALIZATION_TIME = "time within a realization (s)"

Style = Literal["-", "--", ":", "-."]
STYLES: tuple[Style, ...] = ("-", "--", ":", "-.")
MARKERS = "osD^vPX<>hp*8dH"
MARKED = 8  # markers on a curve
LONG = (
    2000  # samples beyond which a curve is pixels in vector files, which would be of many megabytes
)
EDGES = 0.0  # opacity of a band of which the edges alone are drawn


class Look(NamedTuple):
    """Look of a method: colour and marker are its own, dashes and a hollow marker a setting's.

    One that is shown alone has no marker.
    """

    hue: str
    dash: Style
    marker: str
    hollow: bool

    @property
    def line(self) -> dict[str, Any]:
        """Settings of Matplotlib."""
        filled = "white" if self.hollow else self.hue
        shown = {
            "color": self.hue,
            "linestyle": self.dash,
            "marker": self.marker,
            "markersize": 4.0,
        }
        return shown | {"markerfacecolor": filled, "markeredgewidth": 0.9}

    def curve(self, samples: int, place: int, several: int) -> dict[str, Any]:
        """Return settings for one of several curves, with its markers at places of their own."""
        every = max(1, samples // MARKED)
        return self.line | {"markevery": (place * every // several, every)}


LOOK: dict[Any, Any] = {
    "font.size": 7.5,
    "figure.titlesize": 10,
    "axes.titlesize": 9,
    "axes.labelsize": 7.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.alpha": 0.25,
    "grid.linewidth": 0.6,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "legend.frameon": False,
    "legend.fontsize": 8,
}
"""Matplotlib settings of every figure: small print, no box, a light grid behind what is drawn."""


def styled(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    """Let a function draw its figure in the common look."""

    @wraps(draw)
    def in_style(*args: P.args, **kwargs: P.kwargs) -> Figure:
        from matplotlib import rc_context  # noqa: PLC0415  # heavy

        with rc_context(LOOK):
            return _as_written(draw(*args, **kwargs))

    return in_style


def _as_written(figure: Figure) -> Figure:
    """Return a figure whose texts are literal: names of channels and files are no mathematics."""
    from matplotlib.legend import Legend  # noqa: PLC0415  # heavy
    from matplotlib.text import Text  # noqa: PLC0415
    from matplotlib.ticker import FixedFormatter  # noqa: PLC0415

    parts = [child for parent in (figure, *figure.axes) for child in parent.get_children()]
    texts = [part for part in parts if isinstance(part, Text)]
    texts += [
        text
        for part in parts
        if isinstance(part, Legend)
        for text in (part.get_title(), *part.get_texts())
    ]
    # Other ticks have numbers: of these powers of ten are mathematics, and to make them all takes
    # long.
    for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
        texts.append(axis.label)
        if isinstance(named := axis.get_major_formatter(), FixedFormatter):
            named.seq = [printable(text) for text in named.seq]
            texts += [
                label for tick in axis.get_major_ticks() for label in (tick.label1, tick.label2)
            ]
    for text in texts:
        text.set(text=printable(text.get_text()), parse_math=False)
    return figure


def blank(width: float, height: float, title: str = "") -> Figure:
    """Return a figure of a size in inches without axes."""
    from tvsysid.figures.canvas import OwnFigure  # noqa: PLC0415  # heavy

    figure = OwnFigure(figsize=(width, height), layout="constrained")
    figure.look = LOOK
    figure.suptitle(title)
    return figure


def panels(
    rows: int, columns: int, width: float, height: float, title: str = "", **words: Any
) -> tuple[Figure, NDArray[Any]]:
    """Return a figure of a size in inches, and its axes of shape (rows, columns).

    Further words as of ``Figure.subplots``.
    """
    figure = blank(width, height, title)
    return figure, figure.subplots(rows, columns, squeeze=False, **words)


def lines(methods: Sequence[str]) -> dict[str, Look]:
    """Return a look for each method: colour and marker of its own, a line style for each setting.

    There are more methods than colours: where two that are shown have the same one, the later
    gets a free one.
    """
    known = tuple(METHODS)  # what else is installed must not change their colours
    # The label of a method object is its repr
    classes = {method.__name__: key for key, method in METHODS.items()}
    own_keys = {method: classes.get(method.partition("(")[0], key_of(method)) for method in methods}
    keys = list(dict.fromkeys(own_keys.values()))
    hues: dict[str, str] = {}
    for key in sorted(keys, key=lambda key: known.index(key) if key in known else len(known)):
        own = PALETTE[
            (known.index(key) if key in known else len(known) + keys.index(key)) % len(PALETTE)
        ]
        free = [hue for hue in PALETTE if hue not in hues.values()]
        hues[key] = own if own in free or not free else free[0]
    seen: dict[str, int] = {}
    shown = {}
    for method, key in own_keys.items():
        seen[key] = seen.get(key, -1) + 1
        marker = MARKERS[PALETTE.index(hues[key])] if len(own_keys) > 1 else ""
        shown[method] = Look(hues[key], STYLES[seen[key] % len(STYLES)], marker, seen[key] > 0)
    return shown


def hues(methods: Sequence[str]) -> dict[str, str]:
    """Return the colour of each method."""
    return {method: look.hue for method, look in lines(methods).items()}


def curve_with_band(
    axes: Axes,
    time: Array,
    values: Array,
    band: Sequence[Array] | None,
    hue: str,
    opacity: float = 0.25,
    **look: Any,
) -> None:
    """Draw a curve over time above its band of a lighter shade.

    A word where there is no value.

    Of a band with the opacity ``EDGES``, which would cover what others found, the edges alone
    are drawn.
    """
    if not np.isfinite(values).any():
        remark(axes, "no estimate")
        return
    look = {"rasterized": len(time) > LONG} | look
    if band is not None:
        lower, upper = band
        if opacity == EDGES:
            ends, many = np.stack([lower, upper], axis=1), len(time) > LONG
            axes.plot(time, ends, color=hue, alpha=0.5, linewidth=0.5, zorder=1.1, rasterized=many)
        else:
            axes.fill_between(
                time,
                lower,
                upper,
                color=hue,
                alpha=opacity,
                linewidth=0,
                rasterized=len(time) > LONG,
            )
    usual: dict[str, Any] = {"color": hue, "linewidth": 1.4}
    axes.plot(time, values, **(usual | look))


def realizations(
    axes: Axes, time: Array, values: Array, colour: str, width: float = 0.4, opacity: float = 0.6
) -> None:
    """Draw a line for each realization, from values of shape (realization, time)."""
    from matplotlib.collections import LineCollection  # noqa: PLC0415  # heavy

    lines = [np.column_stack([time, each]) for each in values]
    # Hundreds of lines as paths would make a vector file of many megabytes.
    axes.add_collection(
        LineCollection(lines, colors=colour, linewidths=width, alpha=opacity, rasterized=True)
    )
    axes.autoscale_view()


def remark(axes: Axes, text: str) -> None:
    """Say in the axes why nothing is drawn."""
    axes.text(0.5, 0.96, text, transform=axes.transAxes, ha="center", va="top")


def line_key(label: str, **look: Any) -> Artist:
    """Return a line for a legend."""
    from matplotlib.lines import Line2D  # noqa: PLC0415  # heavy

    return Line2D([], [], label=label, **look)


def patch_key(label: str, **look: Any) -> Artist:
    """Return a patch of colour for a legend."""
    from matplotlib.patches import Patch  # noqa: PLC0415  # heavy

    return Patch(label=label, linewidth=0, **look)


def band_keys(draws: int, what: str) -> list[Artist]:
    """Return the legend entry of a mean with a band over so many trials or bootstraps."""
    if draws == 1:
        return [line_key(f"the only {what}", color=GREY)]
    return [
        line_key(f"mean over {what}s", color=GREY),
        patch_key("± 2 standard deviations", color=GREY, alpha=0.35),
    ]


def legend_below(figure: Figure, handles: Sequence[Artist]) -> None:
    """Draw a legend under all axes of a figure, in as few rows as fit."""
    lengths = [0.5 + 0.07 * len(str(handle.get_label())) for handle in handles]
    columns = len(handles)
    while columns > 1:
        rows = -(-len(handles) // columns)
        if (
            sum(max(lengths[first : first + rows]) for first in range(0, len(handles), rows))
            <= figure.get_figwidth()
        ):
            break
        columns -= 1
    columns = -(-len(handles) // -(-len(handles) // max(columns, 1)))  # rows of the same length
    rows = -(-len(handles) // columns)
    # Make room for the legend without shrinking the axes
    figure.set_figheight(figure.get_figheight() + 0.17 * max(rows - 2, 0))
    figure.legend(
        handles=list(handles),
        fontsize=8,
        frameon=False,
        loc="outside lower center",
        ncols=columns,
        columnspacing=1.4,
    )
