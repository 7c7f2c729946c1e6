"""How settings were chosen."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from tvsysid.figures.style import PALETTE, STYLES, TRUTH, panels, styled
from tvsysid.methods.tuning.evidence import Evidence

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@styled
def tuning_curves(evidence: Mapping[str, Evidence], title: str = "") -> Figure:
    """By how much all settings that were tried are worse than the best, for each method.

    Parameters
    ----------
    evidence
        By the method's label.
    title
        Above all.

    Returns
    -------
    matplotlib.figure.Figure
        Axes for each method, three of them side by side.
    """
    columns = min(len(evidence), 3)
    rows = -(-len(evidence) // columns)
    figure, grid = panels(rows, columns, 0.6 + 3.6 * columns, 0.4 + 3.6 * rows, title)
    for axes, (label, item) in zip(grid.flat, evidence.items(), strict=False):
        _draw(axes, item)
        axes.set_title(label)
    for axes in grid.flat[len(evidence) :]:
        axes.remove()
    return figure


def _draw(axes: Axes, evidence: Evidence) -> None:
    values = evidence.values
    worse = np.nanmax(values) - values if evidence.better == "higher" else values - np.nanmin(values)
    for number, name in enumerate(dict.fromkeys(evidence.lines[1:])):
        on_line = np.array([place for place, line in enumerate(evidence.lines) if line == name])
        on_line = on_line[np.argsort(evidence.positions[on_line], kind="stable")]
        axes.plot(
            evidence.positions[on_line],
            worse[on_line],
            color=PALETTE[number % len(PALETTE)],
            linestyle=STYLES[number // 4 % len(STYLES)],
            linewidth=1.2,
            marker=".",
            label=name or "tried",
        )
    kept = "kept: nothing is clearly better" if evidence.chosen == 0 else "chosen"
    for name, place, marker, size in (("as given", 0, "o", 9), (kept, evidence.chosen, "*", 11)):
        axes.plot(
            evidence.positions[place],
            worse[place],
            color=TRUTH,
            marker=marker,
            markersize=size,
            markerfacecolor="none" if marker == "o" else TRUTH,
            linestyle="none",
            label=name,
        )
    if evidence.positions.min() > 0 and evidence.positions.max() > 20 * evidence.positions.min():
        axes.set_xscale("log")
    axes.set_yscale("symlog", linthresh=1.0)
    axes.set_ylim(-0.3, 3 * max(float(np.nanmax(worse)), 1.0))
    axes.set_xlabel(evidence.axis)
    axes.set_ylabel(f"worse than the best by ({evidence.unit})")
    axes.legend(fontsize=7)
