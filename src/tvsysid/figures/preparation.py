"""Alignment and exclusion step by step."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tvsysid.figures.style import (
    INK,
    KEPT,
    PALETTE,
    REALIZATION_TIME,
    blank,
    legend_below,
    line_key,
    realizations,
    styled,
)
from tvsysid.numerics import Array
from tvsysid.preprocess import Preparation, Step

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

REFERENCE: dict[str, Any] = {"color": "black", "linewidth": 1.6}
MEAN: dict[str, Any] = {"color": INK, "linewidth": 1.2}
LIMIT: dict[str, Any] = MEAN | {"linestyle": "--"}
TITLES = {
    "alignment": "aligned to the target",
    "task component": "component at the task's frequency",
    "residual": "residual, low-passed",
}
COLOURS = {"alignment": PALETTE[1], "task component": PALETTE[0], "residual": PALETTE[3]}
"""Colour of the realizations that each step excluded."""
FEW = 0.05  # share of the realizations that hides nothing when it is drawn over the others
REASONS = {
    "alignment": "shifted too far",
    "task component": "unlike in the task",
    "residual": "unlike otherwise",
}


@styled
def preparation_steps(preparation: Preparation, title: str = "") -> Figure:
    """Draw the torque before and after preparation, and the torque that each step compared."""
    steps, excluded_by = preparation.steps, preparation.table.excluded_by.to_numpy(dtype=str)
    figure = blank(10.0, 6.4 if steps else 3.6, title)
    grid = figure.add_gridspec(2 if steps else 1, 6)
    before, after = figure.add_subplot(grid[0, :3]), figure.add_subplot(grid[0, 3:])
    time = preparation.recorded.time
    recorded, prepared = preparation.recorded, preparation.ensemble

    _realizations(before, time, recorded.torque[:, recorded.core], excluded_by)
    if "alignment" in steps:
        before.plot(time, steps["alignment"].mean, **REFERENCE)
    before.set_title(f"recorded: {len(recorded)} realizations")
    _realizations(after, time, prepared.torque[:, prepared.core], np.full(len(prepared), ""))
    after.set_title(f"prepared: {len(prepared)} realizations, mean subtracted")

    wide = 6 // max(len(steps), 1)
    for number, (name, step) in enumerate(steps.items()):
        axes = figure.add_subplot(grid[1, wide * number : wide * (number + 1)])
        _realizations(axes, time, step.torque, np.where(step.kept, "", name))
        _limits(axes, time, step)
        axes.set_title(f"{number + 1}. {TITLES[name]}: {np.count_nonzero(~step.kept)} excluded")
    for axes in figure.axes:
        axes.set_xlabel(REALIZATION_TIME)
        axes.set_xlim(0, recorded.duration)
        axes.locator_params(axis="x", nbins=5)
        axes.set_ylabel("torque (N·m)")
    legend_below(figure, _legend(list(steps)))
    return figure


def _realizations(axes: Axes, time: Array, torque: Array, steps: NDArray[np.str_]) -> None:
    """Draw every realization in the colour of the step that excluded it; many go to the back."""
    order = sorted(COLOURS, key=lambda step: -int(np.count_nonzero(steps == step)))
    front = [step for step in order if np.count_nonzero(steps == step) <= FEW * len(steps)]
    for step in [*(step for step in order if step not in front), "", *front]:
        width, opacity = (0.9, 0.9) if step else (0.4, 0.5)
        realizations(axes, time, torque[steps == step], COLOURS.get(step, KEPT), width, opacity)


def _limits(axes: Axes, time: Array, step: Step) -> None:
    """Draw the target torque, or the mean and its limits."""
    if step.half_width is None:
        axes.plot(time, step.mean, **REFERENCE)
        return
    axes.plot(time, step.mean, **MEAN)
    for limit in (step.mean - step.half_width, step.mean + step.half_width):
        axes.plot(time, limit, **LIMIT)


def _legend(steps: list[str]) -> list[Artist]:
    handles = [line_key("kept", color=KEPT)]
    handles += [line_key(f"excluded: {REASONS[step]}", color=COLOURS[step]) for step in steps]
    if "alignment" in steps:
        handles.append(line_key("target", **REFERENCE))
    if {"task component", "residual"} & set(steps):
        handles += [line_key("mean", **MEAN), line_key("limits", **LIMIT)]
    return handles
