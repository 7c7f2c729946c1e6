"""What was recorded: the channels of a file, angle and torque, and what preparation excluded."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tvsysid.errors import InputError, printable
from tvsysid.figures import style
from tvsysid.figures.words import wrapped
from tvsysid.numerics import Array
from tvsysid.preprocess import Preparation
from tvsysid.recordings import Channel
from tvsysid.signals import Ensemble, Recording

MAX_SIGNALS = 12  # that are drawn of a file
MEAN: dict[str, Any] = {"color": "black", "label": "target or mean"}
STEPS = {
    "alignment": "aligned to the target",
    "task component": "component at the task's frequency",
    "residual": "residual, low-passed",
}
# By the step that excluded realizations, or none: label and colour
OUTCOMES = {
    "": ("kept", style.KEPT),
    "alignment": ("excluded: shifted too far", style.PALETTE[1]),
    "task component": ("excluded: different in the task", style.PALETTE[0]),
    "residual": ("excluded: different otherwise", style.PALETTE[3]),
}


@style.styled
def recorded_channels(channels: Mapping[str, Channel], title: str = "") -> Figure:
    """Draw the channels of a file as they are, one above the other, each over its own time.

    An axes for each of the first twelve signals, with its unit, or "unit not stated", and time in s
    where the rate is stated.

    Parameters
    ----------
    channels
        Channels by name, as of :func:`tvsysid.recordings.describe_file`. Those without numbers are
        left out.
    title
        Title of the figure.

    Raises
    ------
    InputError
        If there is no signal, or one does not fit in memory.
    """
    signals = [
        (name, channel)
        for name, channel in channels.items()
        if channel.values is not None
        and not channel.dtype.startswith("complex")
        and len(channel.shape) in (1, 2)
        and np.prod(channel.shape) > 1
    ]
    if not signals:
        raise InputError(f"{title}: no signals to draw")
    shown = signals[:MAX_SIGNALS]
    title += f" ({len(shown)} of {len(signals)} signals)"
    units = [printable(channel.unit or "unit not stated") for _, channel in shown]
    figure, grid = style.panels(title, (6.2, 1.7), units)
    for (axes,), (name, channel) in zip(grid, shown, strict=True):
        rate, values = channel.sampling_rate, channel.read(name).squeeze()
        axes.plot(np.arange(len(values)) / (rate or 1.0), values, linewidth=0.7, rasterized=True)
        axes.set_title(wrapped(name, width=100), loc="left")
        axes.set_xlabel("time (s)" if rate else "sample")
    return figure


@style.styled
def ensemble_signals(ensemble: Ensemble, title: str = "") -> Figure:
    """Draw angle, torque and channels of every realization over time, and their mean."""
    signals = {"angle (rad)": ensemble.angle, "torque (N·m)": ensemble.torque, **ensemble.channels}
    rows, xlabel = [*map(wrapped, signals)], style.REALIZATION_TIME
    figure, grid = style.panels(title, (6.2, 1.7), rows, xlabel=xlabel, sharex=True)
    for (axes,), values in zip(grid, signals.values(), strict=True):
        shown = values[:, ensemble.core]
        _draw_realizations(axes, ensemble.time, shown, f"{len(ensemble)} realizations", style.KEPT)
        axes.plot(ensemble.time, shown.mean(axis=0), color=style.TARGET, label="their mean")
    return style.finish(figure)


@style.styled
def recorded_signals(
    excerpts: Mapping[str, Recording], title: str = "", onsets: Iterable[float] = ()
) -> Figure:
    """Draw angle and torque over some seconds, with the target torque if there is one.

    A row for each excerpt: the angle on the left, the torque on the right.

    Parameters
    ----------
    excerpts
        Pieces of recordings, each without a break, by what is written above them. The channel
        ``target`` holds the torque to be followed.
    onsets
        Times in s at which realizations start, which are marked.
    """
    size, rows = (4.1, 1.75), [""] * len(excerpts)
    figure, grid = style.panels(title, size, rows, [""] * 2, "time (s)", sharey="col")
    for row, (name, excerpt) in zip(grid, excerpts.items(), strict=True):
        time = excerpt.time
        signals = {"angle (rad)": excerpt.angle, "torque (N·m)": excerpt.torque}
        for axes, (label, values) in zip(row, signals.items(), strict=True):
            axes.plot(time, values, linewidth=0.6, rasterized=True)
            axes.set_title(wrapped(name, 60), loc="left")
            axes.set_ylabel(label)
            for onset in onsets:
                if time[0] <= onset <= time[-1]:
                    axes.axvline(
                        onset, color=style.INK, linewidth=0.8, label="start of a realization"
                    )
        if "target" in excerpt.channels:
            row[1].plot(time, excerpt.channels["target"], **style.TARGET_LINE)
    return style.finish(figure)


@style.styled
def preparation_steps(preparation: Preparation, title: str = "") -> Figure:
    """Draw the torque before and after preparation, and the torque that each step compared."""
    recorded, prepared, steps = preparation.recorded, preparation.ensemble, preparation.steps
    rows = -(-(2 + len(steps)) // 3)
    labels = ["torque (N·m)"] * rows
    figure, grid = style.panels(title, (3.1, 2.5), labels, [""] * 3)
    before, after, *others = grid.flat
    for axes in grid.flat:  # the last are removed
        axes.set_xlabel(style.REALIZATION_TIME)
    excluded_by = preparation.table.excluded_by.to_numpy(dtype=str)
    _draw_outcomes(before, recorded.time, recorded.torque[:, recorded.core], excluded_by)
    before.set_title(f"recorded: {len(recorded)} realizations")
    if "alignment" in steps:
        before.plot(recorded.time, steps["alignment"].mean, **MEAN)
    kept = prepared.torque[:, prepared.core]
    _draw_realizations(after, prepared.time, kept, *OUTCOMES[""])
    after.set_title(f"prepared: {len(prepared)} realizations, mean subtracted")
    for axes, (name, step) in zip(others, steps.items(), strict=False):
        _draw_outcomes(axes, recorded.time, step.torque, np.where(step.kept, "", name))
        axes.plot(recorded.time, step.mean, **MEAN)
        if step.half_width is not None:
            limits = step.mean - step.half_width, step.mean + step.half_width
            axes.plot(recorded.time, np.transpose(limits), "--", color=style.INK, label="limits")
        axes.set_title(f"{STEPS[name]}: {np.sum(~step.kept)} excluded")
    for axes in others[len(steps) :]:
        axes.remove()
    return style.finish(figure)


def _draw_outcomes(axes: Axes, time: Array, torque: Array, excluded_by: NDArray[np.str_]) -> None:
    """Draw the torque of each realization in the colour of the step that excluded it."""
    for name, (label, color) in OUTCOMES.items():
        _draw_realizations(axes, time, torque[excluded_by == name], label, color)


def _draw_realizations(axes: Axes, time: Array, values: Array, label: str, color: str) -> None:
    """Draw all realizations as pixels: as lines, they would make a file of megabytes."""
    if len(values):
        segments = np.stack(np.broadcast_arrays(time, values), axis=-1)
        lines = LineCollection(
            [*segments], color=color, label=label, linewidth=0.7, alpha=0.6, rasterized=True
        )
        axes.add_collection(lines)
        axes.autoscale_view()
