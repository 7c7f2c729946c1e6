"""One look for all figures."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, ParamSpec

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import printable
from tvsysid.methods import METHODS, key_of
from tvsysid.numerics import Array

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

P = ParamSpec("P")
Style = Literal["-", "--", ":", "-."]

LOOK = Path(__file__).with_name("tvsysid.mplstyle")
# Each colour has a contrast of 3:1 or more on white. The first six differ by 19 or more (CIEDE2000)
# to all eyes, also without one kind of cone (Machado et al. 2009), the next three by 11, the last
# by 8. Markers tell methods apart as well.
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
GREY = "#777777"  # legend entries that hold for all methods
TRUE_LINE: dict[str, Any] = {"color": TRUTH, "linewidth": 2.6, "label": "truth"}
REALIZATION_TIME = "time within a realization (s)"
STYLES: tuple[Style, ...] = ("-", "--", ":", "-.")
MARKERS = "osD^vPX<>hp*8dH"
MARKERS_PER_CURVE = 8
MAX_PATH = 2000  # samples; longer curves become pixels in vector files
MAX_REACH = 0.75  # of the median range of the curves, by which axes extend beyond it


class Look(NamedTuple):
    """Look of a method: colour and marker are its own, dashes and a hollow marker a setting's."""

    hue: str
    dash: Style
    marker: str
    hollow: bool

    @property
    def line(self) -> dict[str, Any]:
        """Settings of Matplotlib."""
        return {
            "color": self.hue,
            "linestyle": self.dash,
            "marker": self.marker,
            "markersize": 4.0,
            "markerfacecolor": "white" if self.hollow else self.hue,
            "markeredgewidth": 0.9,
        }

    def curve(self, samples: int, place: int, several: int) -> dict[str, Any]:
        """Return settings for one of several curves, with its markers at places of their own."""
        every = max(1, samples // MARKERS_PER_CURVE)
        return self.line | {"markevery": (place * every // several, every)}


def lines(methods: Sequence[str]) -> dict[str, Look]:
    """Return a look for each method: colour and marker of its own, a line style for each setting.

    A method of one's own has the colour of a method of the package that is not shown. A method
    that is shown alone has no marker.
    """
    known = list(METHODS)
    # The label of a method object is its repr
    classes = {method.__name__: key for key, method in METHODS.items()}
    keys = {label: classes.get(label.partition("(")[0], key_of(label)) for label in methods}
    free = [place for place, key in enumerate(known) if key not in keys.values()] or [0]
    own = [key for key in dict.fromkeys(keys.values()) if key not in known]
    places = {key: place for place, key in enumerate(known)}
    places |= {key: free[number % len(free)] for number, key in enumerate(own)}
    shown: dict[str, Look] = {}
    for number, (label, key) in enumerate(keys.items()):
        place = places[key] % len(PALETTE)
        earlier = list(keys.values())[:number].count(key)
        marker = MARKERS[place] if len(keys) > 1 else ""
        shown[label] = Look(PALETTE[place], STYLES[earlier % len(STYLES)], marker, earlier > 0)
    return shown


def hues(methods: Sequence[str]) -> dict[str, str]:
    """Return the colour of each method."""
    return {method: look.hue for method, look in lines(methods).items()}


def styled(draw: Callable[P, Figure]) -> Callable[P, Figure]:
    """Let a function draw its figure in the common look."""

    @wraps(draw)
    def in_style(*args: P.args, **kwargs: P.kwargs) -> Figure:
        from matplotlib.style import context  # noqa: PLC0415  # heavy

        with context(LOOK):
            return draw(*args, **kwargs)

    return in_style


def blank(width: float, height: float, title: str = "") -> Figure:
    """Return a figure of a size in inches without axes."""
    from tvsysid.figures.canvas import OwnFigure  # noqa: PLC0415  # heavy

    figure = OwnFigure(figsize=(width, height), layout="constrained")
    figure.look = LOOK
    figure.suptitle(printable(title))
    return figure


def panels(
    rows: int, columns: int, width: float, height: float, title: str = "", **words: Any
) -> tuple[Figure, NDArray[Any]]:
    """Return a figure of a size in inches, and its axes of shape (rows, columns).

    Further words as of ``Figure.subplots``.
    """
    figure = blank(width, height, title)
    return figure, figure.subplots(rows, columns, squeeze=False, **words)


def curve_with_band(
    axes: Axes,
    time: Array,
    values: Array,
    band: Array | Sequence[Array] | None,
    hue: str,
    opacity: float = 0.25,
    **look: Any,
) -> None:
    """Draw a curve over time above its band of a lighter shade, or say that there is none."""
    if not np.isfinite(values).any():
        remark(axes, "no estimate")
        return
    many = len(time) > MAX_PATH
    if band is not None:
        lower, upper = band
        axes.fill_between(
            time, lower, upper, color=hue, alpha=opacity, linewidth=0, rasterized=many
        )
    usual: dict[str, Any] = {"color": hue, "linewidth": 1.4, "rasterized": many}
    axes.plot(time, values, **(usual | look))


def realizations(
    axes: Axes, time: Array, values: Array, colour: str, width: float = 0.4, opacity: float = 0.6
) -> None:
    """Draw a line for each realization, from values of shape (realization, time)."""
    from matplotlib.collections import LineCollection  # noqa: PLC0415  # heavy

    paths = [np.column_stack([time, each]) for each in values]
    # Hundreds of lines as paths would make a vector file of many megabytes.
    many = LineCollection(paths, colors=colour, linewidths=width, alpha=opacity, rasterized=True)
    axes.add_collection(many)
    axes.autoscale_view()


def remark(axes: Axes, text: str) -> None:
    """Say in the axes why nothing is drawn."""
    axes.text(0.5, 0.96, text, transform=axes.transAxes, ha="center", va="top")


def usual_limits(curves: Iterable[Array], always: Array) -> tuple[float, float]:
    """Return axis limits that show ``always`` whole, and what is usual of the curves.

    A method that does not suit the data has spikes, or is far off. It shall not hide the others.
    The lower limit is 0 if that is near.
    """
    known = [values[np.isfinite(values)] for values in curves]
    extents = [np.percentile(values, [1, 99]) for values in known if values.size]
    ends = always[np.isfinite(always)]
    if extents:
        low, high = np.median(extents, axis=0)
        reach = MAX_REACH * (high - low)
        ends = np.r_[ends, np.clip(np.ravel(extents), low - reach, high + reach)]
    if not ends.size:
        return 0.0, 1.0
    least, most = float(ends.min()), float(ends.max())
    room = 0.08 * max(most - least, 0.2 * abs(most), 1e-9)
    return (0.0 if 0 <= least < 0.6 * most else least - room), most + room


def log_ticks(axis: Axis) -> None:
    """Put plain numbers at 1, 2 and 5 times the powers of ten of a logarithmic axis."""
    from matplotlib.ticker import LogLocator  # noqa: PLC0415  # heavy

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter("")


def line_key(label: str, **look: Any) -> Artist:
    """Return a line for a legend."""
    from matplotlib.lines import Line2D  # noqa: PLC0415  # heavy

    return Line2D([], [], label=label, **look)


def patch_key(label: str, **look: Any) -> Artist:
    """Return a patch of colour for a legend."""
    from matplotlib.patches import Patch  # noqa: PLC0415  # heavy

    return Patch(label=label, linewidth=0, **look)


def method_keys(methods: Sequence[str]) -> list[Artist]:
    """Return the legend entry of each method."""
    return [line_key(label, **look.line) for label, look in lines(methods).items()]


def band_keys(draws: int, what: str) -> list[Artist]:
    """Return the legend entries of a mean with a band over so many trials or bootstraps."""
    if draws == 1:
        return [line_key(f"the only {what}", color=GREY)]
    return [
        line_key(f"mean over {what}s", color=GREY),
        patch_key("± 2 standard deviations", color=GREY, alpha=0.35),
    ]


def legend_below(figure: Figure, handles: Sequence[Artist]) -> None:
    """Draw a legend under all axes of a figure, in columns of equal width."""
    longest = max(len(str(handle.get_label())) for handle in handles)
    columns = max(1, int(figure.get_figwidth() / (0.6 + 0.07 * longest)))
    figure.legend(handles=list(handles), loc="outside lower center", ncols=columns)
