"""What a plan says: errors against the minutes recorded, and how fast a change may be."""

from __future__ import annotations

import math
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np

from tvsysid.figures import style
from tvsysid.planning import Plan
from tvsysid.planning.setups import seconds_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH, HEIGHT, EACH = 4.6, 3.4, 3.2  # inches: the first panel, and each of the others
SAMPLES = 60  # of a curve
PER_INCH = 11  # letters of the title


@style.styled
def planned_recording(plan: Plan, title: str = "") -> Figure:
    """Draw the half width of a 95 % band, bias included, over minutes of data.

    A dot where the wish is met, and the rise times.

    A panel for each setup, and one with the time in which each method follows a step.
    """
    count = len(plan.setups)
    size = WIDTH + EACH * count
    figure, grid = style.panels(
        1, count + 1, size, HEIGHT, title or "\n".join(wrap(str(plan), round(PER_INCH * size)))
    )
    looks = style.lines(list(plan.methods))
    for axes, setup in zip(grid[0], plan.setups, strict=False):
        _against_minutes(axes, plan, setup, looks)
    _rise_times(grid[0, -1], plan, looks)
    keys = [style.line_key(label, **look.line) for label, look in looks.items()]
    style.legend_below(figure, [*keys, style.line_key("wish", color=style.INK, linestyle=":")])
    return figure


def _against_minutes(axes: Axes, plan: Plan, setup: str, looks: dict[str, style.Look]) -> None:
    from matplotlib.ticker import LogLocator  # noqa: PLC0415  # heavy

    for answer in (each for each in plan.answers if each.setup == setup):
        curve, look = plan.curves[setup, answer.method], looks[answer.method]
        if not curve.realizations.size:
            continue
        counts = np.geomspace(curve.realizations[0], curve.realizations[-1], SAMPLES)
        half = [plan.multiple * curve.at(each).total for each in counts]
        minutes = [seconds_of(plan.setups[setup], each) / 60 for each in counts]
        axes.loglog(minutes, half, **look.curve(SAMPLES, 0, 1), linewidth=1.4)
        if answer.realizations is not None:
            shown = look.line | {"markersize": 9.0, "linestyle": "none"}
            axes.loglog(answer.seconds / 60, plan.precision, **shown)
    axes.axhline(plan.precision, color=style.INK, linestyle=":")
    axes.set_xlabel("minutes recorded")
    axes.set_ylabel("stiffness: ± at 95 %, bias included (N·m/rad)")
    axes.set_title(setup)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("")


def _rise_times(axes: Axes, plan: Plan, looks: dict[str, style.Look]) -> None:
    answers, labels = plan.answers, list(plan.methods)
    for place, each in enumerate(answers):
        label = f"{each.rise_time:.2g} s" if math.isfinite(each.rise_time) else "unknown"
        axes.barh(place, np.nan_to_num(each.rise_time), color=looks[each.method].hue)
        at, clear = (
            (np.nan_to_num(each.rise_time), place),
            {"facecolor": "white", "edgecolor": "none", "pad": 1},
        )
        axes.annotate(
            label, at, (3, 0), textcoords="offset points", va="center", fontsize=7, bbox=clear
        )
    several = len(answers) > len(labels)
    axes.set_yticks(
        range(len(answers)),
        [f"{each.method}, {each.setup}" if several else each.method for each in answers],
    )
    axes.invert_yaxis()
    axes.margins(x=0.2)
    if plan.resolution is not None:
        axes.axvline(plan.resolution, color=style.INK, linestyle=":")
    axes.set_xlabel("time to follow a step, 10 to 90 % (s)")
