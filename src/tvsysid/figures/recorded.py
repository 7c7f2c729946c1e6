"""What was recorded: the channels of a file, and seconds of angle and torque."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.figures.style import (
    KEPT,
    PALETTE,
    REALIZATION_TIME,
    TARGET,
    legend_below,
    line_key,
    panels,
    realizations,
    styled,
)
from tvsysid.figures.words import wrapped
from tvsysid.recordings import Channel
from tvsysid.signals import Ensemble, Recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAX_SIGNALS = 12  # that are drawn of a file
MAX_COLUMNS = 20  # that are drawn of a matrix


@styled
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
    figure, grid = panels(len(signals), 1, 7.0, 1.0 + 1.7 * len(signals), title)
    for axes, (name, channel) in zip(grid[:, 0], signals.items(), strict=True):
        rate, values = channel.sampling_rate, channel.read(name)
        is_vector = values.ndim == 1 or min(values.shape) == 1
        columns = [values.ravel()] if is_vector else values.T[:MAX_COLUMNS]
        for number, column in enumerate(columns):
            positions, extremes = outline(np.asarray(column, dtype=float))
            axes.plot(
                positions / (rate or 1.0),
                extremes,
                color=PALETTE[number % len(PALETTE)],
                linewidth=0.7,
            )
        axes.set_title(wrapped(name, width=100), loc="left")
        axes.set_ylabel(channel.unit or "unit not stated")
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


@styled
def ensemble_signals(ensemble: Ensemble, title: str = "") -> Figure:
    """Draw angle, torque and channels of every realization over time, and their mean."""
    signals = {"angle (rad)": ensemble.angle, "torque (N·m)": ensemble.torque, **ensemble.channels}
    figure, grid = panels(len(signals), 1, 7.0, 0.7 + 1.8 * len(signals), title, sharex=True)
    for axes, (name, values) in zip(grid[:, 0], signals.items(), strict=True):
        shown = values[:, ensemble.core]
        realizations(axes, ensemble.time, shown, KEPT)
        axes.plot(ensemble.time, shown.mean(axis=0), color=TARGET, linewidth=1.2)
        axes.set_ylabel(wrapped(name))
        axes.margins(x=0)
    grid[-1, 0].set_xlabel(REALIZATION_TIME)
    figure.align_ylabels(grid)
    legend_below(
        figure,
        [
            line_key(f"{len(ensemble)} realizations", color=KEPT),
            line_key("their mean", color=TARGET),
        ],
    )
    return figure


@styled
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
    figure, grid = panels(
        len(excerpts), 2, 9.0, 1.75 * len(excerpts) + 1.0, title, sharex="col", sharey="col"
    )
    for (angle, torque), (name, excerpt) in zip(grid, excerpts.items(), strict=True):
        time = excerpt.time - excerpt.time[0]
        for axes, values, label in (
            (angle, excerpt.angle, "angle (rad)"),
            (torque, excerpt.torque, "torque (N·m)"),
        ):
            # Thousands of samples as paths would make a vector file of megabytes.
            axes.plot(time, values, color=PALETTE[0], linewidth=0.6, rasterized=True)
            axes.set_title(wrapped(name, 60), loc="left")
            axes.set_ylabel(label)
            axes.margins(x=0)
        if target in excerpt.channels:
            torque.plot(time, excerpt.channels[target], color=TARGET, linewidth=1.0)
    for axes in grid[-1]:
        axes.set_xlabel("time (s)")
    if any(target in excerpt.channels for excerpt in excerpts.values()):
        recorded = line_key("torque recorded", color=PALETTE[0], linewidth=0.6)
        legend_below(
            figure, [recorded, line_key("torque to be followed", color=TARGET, linewidth=1.0)]
        )
    figure.align_ylabels(grid)
    return figure
