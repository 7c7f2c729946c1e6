"""What was recorded: the channels of a file, angle and torque, and what preparation excluded."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError, printable
from tvsysid.figures import style
from tvsysid.figures.words import wrapped
from tvsysid.preprocess import Preparation
from tvsysid.recordings import Channel
from tvsysid.signals import Ensemble, Recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAX_SIGNALS = 12  # that are drawn of a file
MAX_COLUMNS = 20  # that are drawn of a matrix
REFERENCE: dict[str, Any] = {"color": "black", "linewidth": 1.6}
LIMIT: dict[str, Any] = {"color": style.INK, "linewidth": 1.2, "linestyle": "--"}
# By step of the preparation: title of its panel, reason to exclude, colour of the excluded
STEPS = {
    "alignment": ("aligned to the target", "shifted too far", style.PALETTE[1]),
    "task component": (
        "component at the task's frequency",
        "different in the task",
        style.PALETTE[0],
    ),
    "residual": ("residual, low-passed", "different otherwise", style.PALETTE[3]),
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
    signals = {
        name: channel
        for name, channel in channels.items()
        if channel.values is not None
        and not channel.dtype.startswith("complex")
        and len(channel.shape) in (1, 2)
        and max(channel.shape) > 1
        and min(channel.shape) > 0
    }
    if not signals:
        raise InputError(f"{title}: no signals to draw")
    if len(signals) > MAX_SIGNALS:
        title += f" ({MAX_SIGNALS} of {len(signals)} signals)"
        signals = dict(list(signals.items())[:MAX_SIGNALS])
    figure, grid = style.panels(len(signals), 1, 7.0, 1.0 + 1.7 * len(signals), title)
    for axes, (name, channel) in zip(grid[:, 0], signals.items(), strict=True):
        rate, values = channel.sampling_rate, channel.read(name)
        is_vector = values.ndim == 1 or min(values.shape) == 1
        columns = [values.ravel()] if is_vector else values.T[:MAX_COLUMNS]
        for number, column in enumerate(columns):
            positions, extremes = outline(np.asarray(column, dtype=float))
            hue = style.PALETTE[number % len(style.PALETTE)]
            axes.plot(positions / (rate or 1.0), extremes, color=hue, linewidth=0.7)
        axes.set_title(wrapped(name, width=100), loc="left")
        axes.set_ylabel(printable(channel.unit or "unit not stated"))
        axes.set_xlabel("sample" if rate is None else "time (s)")
        axes.margins(x=0)
    return figure


def outline(values: NDArray[Any], blocks: int = 2000) -> tuple[NDArray[np.int64], NDArray[Any]]:
    """Return positions and values of the lowest and highest sample of each block, for a drawing.

    Signals of shape (time,) that are shorter than two samples for each block come out whole.
    """
    if len(values) <= 2 * blocks:
        return np.arange(len(values)), values
    starts = np.linspace(0, len(values), blocks, endpoint=False).astype(np.int64)
    # NaN counts as the lowest, so that a gap is seen.
    known = np.nan_to_num(values, nan=-np.inf)
    extremes = [
        start + find(block)
        for find in (np.argmin, np.argmax)
        for start, block in zip(starts, np.split(known, starts[1:]), strict=True)
    ]
    positions = np.unique(extremes)
    return positions, values[positions]


@style.styled
def ensemble_signals(ensemble: Ensemble, title: str = "") -> Figure:
    """Draw angle, torque and channels of every realization over time, and their mean."""
    signals = {"angle (rad)": ensemble.angle, "torque (N·m)": ensemble.torque, **ensemble.channels}
    figure, grid = style.panels(len(signals), 1, 7.0, 0.7 + 1.8 * len(signals), title, sharex=True)
    for axes, (name, values) in zip(grid[:, 0], signals.items(), strict=True):
        shown = values[:, ensemble.core]
        style.realizations(axes, ensemble.time, shown, style.KEPT)
        axes.plot(ensemble.time, shown.mean(axis=0), color=style.TARGET, linewidth=1.2)
        axes.set_ylabel(wrapped(name))
        axes.margins(x=0)
    grid[-1, 0].set_xlabel(style.REALIZATION_TIME)
    figure.align_ylabels(grid)
    keys = {f"{len(ensemble)} realizations": style.KEPT, "their mean": style.TARGET}
    style.legend_below(figure, [style.line_key(key, color=hue) for key, hue in keys.items()])
    return figure


@style.styled
def recorded_signals(
    excerpts: Mapping[str, Recording], title: str = "", target: str = "target"
) -> Figure:
    """Draw angle and torque over some seconds, with the target torque if there is one.

    A row for each excerpt: the angle on the left, the torque on the right.

    Parameters
    ----------
    excerpts
        Pieces of recordings, each without a break, by what is written above them.
    target
        Channel that holds the torque to be followed.
    """
    figure, grid = style.panels(
        len(excerpts), 2, 9.0, 1.75 * len(excerpts) + 1.0, title, sharex="col", sharey="col"
    )
    for row, (name, excerpt) in zip(grid, excerpts.items(), strict=True):
        time = excerpt.time - excerpt.time[0]
        signals = {"angle (rad)": excerpt.angle, "torque (N·m)": excerpt.torque}
        for axes, (label, values) in zip(row, signals.items(), strict=True):
            # Thousands of samples as paths would make a vector file of megabytes.
            axes.plot(time, values, color=style.PALETTE[0], linewidth=0.6, rasterized=True)
            axes.set_title(wrapped(name, 60), loc="left")
            axes.set_ylabel(label)
            axes.margins(x=0)
        if target in excerpt.channels:
            row[1].plot(time, excerpt.channels[target], color=style.TARGET, linewidth=1.0)
    for axes in grid[-1]:
        axes.set_xlabel("time (s)")
    if any(target in excerpt.channels for excerpt in excerpts.values()):
        keys = {"torque recorded": style.PALETTE[0], "torque to be followed": style.TARGET}
        style.legend_below(figure, [style.line_key(key, color=hue) for key, hue in keys.items()])
    figure.align_ylabels(grid)
    return figure


@style.styled
def preparation_steps(preparation: Preparation, title: str = "") -> Figure:
    """Draw the torque before and after preparation, and the torque that each step compared."""
    steps, excluded_by = preparation.steps, preparation.table.excluded_by.to_numpy(dtype=str)
    recorded, prepared = preparation.recorded, preparation.ensemble
    target = steps["alignment"].mean if "alignment" in steps else None
    count = f"recorded: {len(recorded)} realizations"
    left = f"prepared: {len(prepared)} realizations, mean subtracted"
    # Heading, torque, step that excluded each realization, mean or target, half width of limits
    shown: list[tuple[str, Any, Any, Any, Any]] = [
        (count, recorded.torque[:, recorded.core], excluded_by, target, None),
        (left, prepared.torque[:, prepared.core], np.full(len(prepared), ""), None, None),
    ]
    for number, (name, step) in enumerate(steps.items(), start=1):
        heading = f"{number}. {STEPS[name][0]}: {np.count_nonzero(~step.kept)} excluded"
        by = np.where(step.kept, "", name)
        shown.append((heading, step.torque, by, step.mean, step.half_width))
    rows = -(-len(shown) // 3)
    figure, grid = style.panels(rows, 3, 10.0, 0.4 + 2.9 * rows, title)
    for axes, (heading, torque, by, middle, half_width) in zip(grid.flat, shown, strict=False):
        style.realizations(axes, recorded.time, torque[by == ""], style.KEPT, opacity=0.5)
        for name, (_, _, hue) in STEPS.items():
            style.realizations(axes, recorded.time, torque[by == name], hue, 0.9, 0.9)
        if middle is not None:
            axes.plot(recorded.time, middle, **REFERENCE)
        for limit in () if half_width is None else (middle - half_width, middle + half_width):
            axes.plot(recorded.time, limit, **LIMIT)
        axes.set_title(heading)
        axes.set_xlabel(style.REALIZATION_TIME)
        axes.set_ylabel("torque (N·m)")
        axes.margins(x=0)
    for axes in grid.flat[len(shown) :]:
        axes.remove()
    keys = [style.line_key("kept", color=style.KEPT)]
    keys += [style.line_key(f"excluded: {STEPS[name][1]}", color=STEPS[name][2]) for name in steps]
    if steps:
        keys += [style.line_key("target or mean", **REFERENCE), style.line_key("limits", **LIMIT)]
    style.legend_below(figure, keys)
    return figure
