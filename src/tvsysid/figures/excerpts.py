"""Seconds of what was recorded, like figure 6 of van de Ruit et al. 2021."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from tvsysid.figures.style import PALETTE, TARGET, plain
from tvsysid.figures.words import wrapped
from tvsysid.signals import Recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def recorded_signals(excerpts: Mapping[str, Recording], title: str = "") -> Figure:
    """Angle and torque over some seconds, with the torque to be followed where there is one.

    Parameters
    ----------
    excerpts
        Pieces of recordings, each without a break, by what is written above them; the torque to be followed is their
        channel ``target``.
    title
        Above all.

    Returns
    -------
    matplotlib.figure.Figure
        A row for each excerpt: the angle on the left, the torque on the right.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415  # heavy

    figure = Figure(figsize=(9.0, 1.75 * len(excerpts) + 1.0), layout="constrained")
    grid = figure.subplots(len(excerpts), 2, sharex="col", sharey="col", squeeze=False)
    for (angle, torque), (name, excerpt) in zip(grid, excerpts.items(), strict=True):
        time = excerpt.time - excerpt.time[0]
        # Thousands of samples as paths would make a vector file of megabytes.
        plain(angle).plot(time, excerpt.angle, color=PALETTE[0], linewidth=0.6, rasterized=True)
        plain(torque).plot(
            time, excerpt.torque, color=PALETTE[0], linewidth=0.6, rasterized=True, label="torque recorded"
        )
        if "target" in excerpt.channels:
            torque.plot(time, excerpt.channels["target"], color=TARGET, linewidth=1.0, label="torque to be followed")
        for axes, label in ((angle, "angle (rad)"), (torque, "torque (N·m)")):
            axes.set_title(wrapped(name, 60), fontsize=9, loc="left")
            axes.set_ylabel(label, fontsize=8)
            axes.tick_params(labelsize=8)
            axes.margins(x=0)
    for axes in grid[-1]:
        axes.set_xlabel("time (s)", fontsize=8)
    shown = {label: line for axes in grid[:, 1] for line, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    if len(shown) > 1:
        figure.legend(
            list(shown.values()), list(shown), frameon=False, fontsize=8, loc="outside lower center", ncols=len(shown)
        )
    figure.align_ylabels(grid)
    figure.suptitle(title, fontsize=10)
    return figure
