"""What a plan says: errors against the minutes recorded, and how fast a change may be."""

from __future__ import annotations

import math
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np

from tvsysid.figures import style
from tvsysid.planning import Plan
from tvsysid.planning.setups import seconds_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SAMPLES = 60  # of a curve


@style.styled
def planned_recording(plan: Plan, title: str = "") -> Figure:
    """Draw the half width of a 95 % band, bias included, over minutes of data.

    A dot where the wish is met, and the rise times.

    A panel for each setup, and one with the time in which each method follows a step.
    """
    width = 4.6 + 3.2 * len(plan.setups)
    figure, grid = style.panels(
        1, len(plan.setups) + 1, width, 3.4, title or fill(str(plan), round(11 * width))
    )
    methods = list(plan.methods)
    for axes, setup in zip(grid[0], plan.setups, strict=False):
        _against_minutes(axes, plan, setup)
    _rise_times(grid[0, -1], plan)
    wish = style.line_key("wish", color=style.INK, linestyle=":")
    style.legend_below(figure, [*style.method_keys(methods), wish])
    return figure


def _against_minutes(axes: Axes, plan: Plan, setup: str) -> None:
    looks = style.lines(list(plan.methods))
    for answer in plan.answers:
        curve, look = plan.curves[setup, answer.method], looks[answer.method]
        if answer.setup != setup or not curve.realizations.size:
            continue
        counts = np.geomspace(curve.realizations[0], curve.realizations[-1], SAMPLES)
        half = [plan.multiple * curve.at(each).total for each in counts]
        minutes = [seconds_of(plan.setups[setup], each) / 60 for each in counts]
        axes.loglog(minutes, half, **look.curve(SAMPLES, 0, 1), linewidth=1.4)
        if answer.realizations is not None:
            dot = look.line | {"markersize": 9.0, "linestyle": "none"}
            axes.loglog(answer.seconds / 60, plan.precision, **dot)
    axes.axhline(plan.precision, color=style.INK, linestyle=":")
    axes.set_xlabel("minutes recorded")
    axes.set_ylabel("stiffness: ± at 95 %, bias included (N·m/rad)")
    axes.set_title(setup)
    style.log_ticks(axes.xaxis)
    style.log_ticks(axes.yaxis)


def _rise_times(axes: Axes, plan: Plan) -> None:
    hues, several = style.hues(list(plan.methods)), len(plan.setups) > 1
    labels = [f"{each.method}, {each.setup}" if several else each.method for each in plan.answers]
    bars = axes.barh(
        labels,
        [np.nan_to_num(each.rise_time) for each in plan.answers],
        color=[hues[each.method] for each in plan.answers],
    )
    times = [each.rise_time for each in plan.answers]
    texts = [f"{time:.2g} s" if math.isfinite(time) else "unknown" for time in times]
    axes.bar_label(bars, texts, padding=3, fontsize=7)
    axes.invert_yaxis()
    axes.margins(x=0.2)
    if plan.resolution is not None:
        axes.axvline(plan.resolution, color=style.INK, linestyle=":")
    axes.set_xlabel("time to follow a step, 10 to 90 % (s)")
