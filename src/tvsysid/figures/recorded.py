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
# Hundreds of realizations, and thousands of samples, would make a vector file of megabytes.
THIN: dict[str, Any] = {"linewidth": 0.4, "alpha": 0.6, "rasterized": True}
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
    signals = [
        (name, channel)
        for name, channel in channels.items()
        if channel.values is not None
        and not channel.dtype.startswith("complex")
        and len(channel.shape) in (1, 2)
        and max(channel.shape) > 1
        and min(channel.shape) > 0
    ]
    if not signals:
        raise InputError(f"{title}: no signals to draw")
    shown = signals[:MAX_SIGNALS]
    title += f" ({len(shown)} of {len(signals)} signals)" * (len(shown) < len(signals))
    figure, grid = style.panels(len(shown), 1, 7.0, 1.0 + 1.7 * len(shown), title)
    for axes, (name, channel) in zip(grid[:, 0], shown, strict=True):
        rate, values = channel.sampling_rate, np.asarray(channel.read(name), dtype=float)
        is_vector = min(values.shape) == 1
        for column in [values.ravel()] if is_vector else np.atleast_2d(values.T)[:MAX_COLUMNS]:
            positions, extremes = outline(column)
            axes.plot(positions / (rate or 1.0), extremes, linewidth=0.7)
        axes.set_title(wrapped(name, width=100), loc="left")
        axes.set_ylabel(printable(channel.unit or "unit not stated"))
        axes.set_xlabel("time (s)" if rate else "sample")
    return figure


def outline(values: NDArray[Any], blocks: int = 2000) -> tuple[NDArray[np.int64], NDArray[Any]]:
    """Return positions and values of the lowest and highest sample of each block, for a drawing.

    Signals of shape (time,) that are shorter than the number of blocks come out whole.
    """
    length = -(-len(values) // blocks)
    # NaN counts as the lowest, so that a gap is seen.
    known = np.pad(np.nan_to_num(values, nan=-np.inf), (0, -len(values) % length), mode="edge")
    pieces = known.reshape(-1, length)
    extremes = np.concatenate([pieces.argmin(axis=1), pieces.argmax(axis=1)])
    positions = np.unique(extremes + np.tile(length * np.arange(len(pieces)), 2))
    return positions, values[positions]


@style.styled
def ensemble_signals(ensemble: Ensemble, title: str = "") -> Figure:
    """Draw angle, torque and channels of every realization over time, and their mean."""
    signals = {"angle (rad)": ensemble.angle, "torque (N·m)": ensemble.torque, **ensemble.channels}
    figure, grid = style.panels(len(signals), 1, 7.0, 0.7 + 1.8 * len(signals), title, sharex=True)
    for axes, (name, values) in zip(grid[:, 0], signals.items(), strict=True):
        shown = values[:, ensemble.core]
        count = f"{len(ensemble)} realizations"
        axes.plot(ensemble.time, shown.T, color=style.KEPT, label=[count] * len(shown), **THIN)
        axes.plot(ensemble.time, shown.mean(axis=0), color=style.TARGET, label="their mean")
        axes.set_ylabel(wrapped(name))
    grid[-1, 0].set_xlabel(style.REALIZATION_TIME)
    return style.finish(figure)


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
    size = 9.0, 1.75 * len(excerpts) + 1.0
    figure, grid = style.panels(len(excerpts), 2, *size, title, sharex="col", sharey="col")
    for row, (name, excerpt) in zip(grid, excerpts.items(), strict=True):
        time = excerpt.time - excerpt.time[0]
        signals = {"angle (rad)": excerpt.angle, "torque (N·m)": excerpt.torque}
        for axes, (label, values) in zip(row, signals.items(), strict=True):
            axes.plot(time, values, linewidth=0.6, rasterized=True)
            axes.set_title(wrapped(name, 60), loc="left")
            axes.set_ylabel(label)
        if target in excerpt.channels:
            look: dict[str, Any] = {"color": style.TARGET, "label": "torque to be followed"}
            row[1].plot(time, excerpt.channels[target], **look)
    for axes in grid[-1]:
        axes.set_xlabel("time (s)")
    return style.finish(figure)


@style.styled
def preparation_steps(preparation: Preparation, title: str = "") -> Figure:
    """Draw the torque before and after preparation, and the torque that each step compared."""
    steps, excluded_by = preparation.steps, preparation.table.excluded_by.to_numpy(dtype=str)
    recorded, prepared = preparation.recorded, preparation.ensemble
    target = steps["alignment"].mean if "alignment" in steps else None
    kept = np.full(len(prepared), "")
    # Heading, torque, step that excluded each realization, mean or target, half width of limits
    shown: list[tuple[str, Any, Any, Any, Any]] = [
        (
            f"recorded: {len(recorded)}",
            recorded.torque[:, recorded.core],
            excluded_by,
            target,
            None,
        ),
        (f"prepared: {len(prepared)}", prepared.torque[:, prepared.core], kept, None, None),
    ]
    for number, (name, step) in enumerate(steps.items(), start=1):
        heading = f"{number}. {STEPS[name][0]}: {np.count_nonzero(~step.kept)} excluded"
        by = np.where(step.kept, "", name)
        shown.append((heading, step.torque, by, step.mean, step.half_width))
    looks = {"": ("kept", style.KEPT)}
    looks |= {name: (f"excluded: {reason}", color) for name, (_, reason, color) in STEPS.items()}
    rows = -(-len(shown) // 3)
    figure, grid = style.panels(rows, 3, 10.0, 0.4 + 2.9 * rows, title)
    for axes, (heading, torque, by, middle, half_width) in zip(grid.flat, shown, strict=False):
        for name, (label, color) in looks.items():
            mine = torque[by == name]
            axes.plot(recorded.time, mine.T, color=color, label=[label] * len(mine), **THIN)
        if middle is not None:
            axes.plot(recorded.time, middle, color="black", label="target or mean")
        if half_width is not None:
            limits = np.stack([middle - half_width, middle + half_width], axis=1)
            axes.plot(recorded.time, limits, label=["limits"] * 2, **LIMIT)
        axes.set(title=heading, xlabel=style.REALIZATION_TIME, ylabel="torque (N·m)")
    for axes in grid.flat[len(shown) :]:
        axes.remove()
    return style.finish(figure)
