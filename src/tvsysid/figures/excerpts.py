"""Seconds of what was recorded."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from tvsysid.figures.style import PALETTE, TARGET, legend_below, line_key, panels, styled
from tvsysid.figures.words import wrapped
from tvsysid.signals import Recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@styled
def recorded_signals(excerpts: Mapping[str, Recording], title: str = "", target: str = "target") -> Figure:
    """Angle and torque over some seconds, with the torque to be followed where there is one.

    Parameters
    ----------
    excerpts
        Pieces of recordings, each without a break, by what is written above them.
    title
        Above all.
    target
        Channel that holds the torque to be followed.

    Returns
    -------
    matplotlib.figure.Figure
        A row for each excerpt: the angle on the left, the torque on the right.
    """
    figure, grid = panels(len(excerpts), 2, 9.0, 1.75 * len(excerpts) + 1.0, title, sharex="col", sharey="col")
    for (angle, torque), (name, excerpt) in zip(grid, excerpts.items(), strict=True):
        time = excerpt.time - excerpt.time[0]
        # Thousands of samples as paths would make a vector file of megabytes.
        angle.plot(time, excerpt.angle, color=PALETTE[0], linewidth=0.6, rasterized=True)
        torque.plot(time, excerpt.torque, color=PALETTE[0], linewidth=0.6, rasterized=True)
        if target in excerpt.channels:
            torque.plot(time, excerpt.channels[target], color=TARGET, linewidth=1.0)
        for axes, label in ((angle, "angle (rad)"), (torque, "torque (N·m)")):
            axes.set_title(wrapped(name, 60), loc="left")
            axes.set_ylabel(label)
            axes.margins(x=0)
    for axes in grid[-1]:
        axes.set_xlabel("time (s)")
    if any(target in excerpt.channels for excerpt in excerpts.values()):
        recorded = line_key("torque recorded", color=PALETTE[0], linewidth=0.6)
        legend_below(figure, [recorded, line_key("torque to be followed", color=TARGET, linewidth=1.0)])
    figure.align_ylabels(grid)
    return figure
