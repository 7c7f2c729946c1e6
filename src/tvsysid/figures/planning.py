"""What a plan says: errors against the minutes recorded, and how fast a change may be."""

from __future__ import annotations

from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tvsysid.figures import style
from tvsysid.planning import Plan

SAMPLES = 60  # of a curve


@style.styled
def planned_recording(plan: Plan, title: str = "") -> Figure:
    """Draw the half width of a 95 % band, bias included, over minutes of data.

    A panel for each setup, and one with the time in which each method follows a step.
    """
    headings = [*plan.setups, ""]
    title = title or fill(str(plan).partition(";")[0], 40 * len(headings))
    figure, ((*each, last),) = style.panels(title, (3.6, 2.6), headings=headings)
    for axes, setup in zip(each, plan.setups, strict=True):
        _draw_against_minutes(axes, plan, setup)
    _draw_rise_times(last, plan)
    return style.finish(figure)


def _draw_against_minutes(axes: Axes, plan: Plan, setup: str) -> None:
    for method, look in style.lines(list(plan.methods)).items():
        curve = plan.curves[setup, method]
        if not curve.realizations.size:
            continue
        counts = np.geomspace(curve.realizations[0], curve.realizations[-1], SAMPLES)
        half = np.array([plan.multiple * curve.at(each).total for each in counts])
        minutes = np.array([plan.setups[setup].seconds(each) / 60 for each in counts])
        style.curve(axes, minutes, half, **look)
    axes.axhline(plan.precision, color=style.INK, linestyle=":", label="required")
    label = "stiffness: ± at 95 %,\nbias included (N·m/rad)"
    axes.set(xlabel="minutes recorded", ylabel=label, xscale="log", yscale="log")
    style.log_ticks(axes.xaxis)
    style.log_ticks(axes.yaxis)


def _draw_rise_times(axes: Axes, plan: Plan) -> None:
    looks = style.lines(list(plan.methods))
    for each in plan.required:
        color, label = looks[each.method]["color"], each.method
        if len(plan.setups) > 1:
            label += f", {each.setup.removeprefix('the ')}"
        bar = axes.barh(label, np.nan_to_num(each.rise_time), color=color)
        axes.bar_label(bar, [f"{each.rise_time:.2g} s"], padding=3)
    axes.set_ylim(max(len(plan.required), 3) - 0.5, -0.5)  # from above
    axes.margins(x=0.2)
    if plan.resolution is not None:
        axes.axvline(plan.resolution, color=style.INK, linestyle=":")
    axes.set_xlabel("time to follow a step, 10 to 90 % (s)")
