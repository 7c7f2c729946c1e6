"""What a file holds, before anything is done with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from tvsysid.figures.style import PALETTE, panels, styled
from tvsysid.figures.words import wrapped
from tvsysid.recordings import Channel

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@styled
def recorded_channels(
    channels: Mapping[str, tuple[Channel, Sequence[tuple[NDArray[Any], NDArray[Any]]]]], title: str = ""
) -> Figure:
    """Channels of a file, one above the other, each over its own time.

    Parameters
    ----------
    channels
        By name: what the file states of it, and for each column the positions (in samples) and the values to draw, as
        of :func:`tvsysid.recordings.outline`.
    title
        Above all.

    Returns
    -------
    matplotlib.figure.Figure
        An axes for each channel, with its unit, or "unit not stated", and time in s where the rate is stated.
    """
    figure, grid = panels(len(channels), 1, 7.0, 1.0 + 1.7 * len(channels), title)
    for axes, (name, (channel, columns)) in zip(grid[:, 0], channels.items(), strict=True):
        rate = channel.sampling_rate
        for number, (positions, values) in enumerate(columns):
            axes.plot(positions / (rate or 1.0), values, color=PALETTE[number % len(PALETTE)], linewidth=0.7)
        axes.set_title(wrapped(name, width=100), loc="left")
        axes.set_ylabel(channel.unit.replace("$", r"\$") or "unit not stated")
        axes.set_xlabel("sample" if rate is None else "time (s)")
        axes.margins(x=0)
    return figure
