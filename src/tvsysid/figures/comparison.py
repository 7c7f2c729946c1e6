"""Methods side by side, like figures 3 and 4 of van de Ruit et al. 2021."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid.figures.style import TRUTH, lines, plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def method_comparison(cell: Any, title: str = "") -> Figure:
    """Stiffness and time-varying VAF, mean ± 2 standard deviations over trials, a column for each method.

    Parameters
    ----------
    cell
        Results of one scenario: an xarray.Dataset with ``stiffness`` and ``time_varying_vaf`` over (method_key,
        trial, time) and ``true_stiffness`` over (time,).
    title
        Above all.

    Returns
    -------
    matplotlib.figure.Figure
        Two rows of axes.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415  # heavy

    methods = [str(name) for name in cell.method_key.values]
    figure = Figure(figsize=(max(2.3 * len(methods), 4.0) + 0.6, 4.6), layout="constrained")
    grid = figure.subplots(2, len(methods), sharex=True, sharey="row", squeeze=False)
    time, hues = cell.time.values, lines(methods)
    for column, method in enumerate(methods):
        upper, lower = plain(grid[0, column]), plain(grid[1, column])
        shown = cell.sel(method_key=method)
        upper.plot(time, cell.true_stiffness.values, color=TRUTH, linewidth=1.0, linestyle="--", label="truth")
        hue = hues[method][0]
        _band(upper, time, shown.stiffness.values, hue)
        _band(lower, time, shown.time_varying_vaf.values, hue)
        upper.set_title(method if len(method) <= 24 else f"{method[:22]}…", fontsize=10)
        lower.set_xlabel("time (s)")
    grid[0, 0].set_ylabel("stiffness (N·m/rad)")
    grid[1, 0].set_ylabel("time-varying VAF (%)")
    truth = cell.true_stiffness.values
    span = max(float(np.ptp(truth)), 0.5 * float(np.abs(truth).max()))
    grid[0, 0].set_ylim(min(0.0, float(truth.min()) - 0.5 * span), float(truth.max()) + 0.6 * span)
    grid[1, 0].set_ylim(max(0.0, min(60.0, float(cell.time_varying_vaf.quantile(0.01)) - 5)), 102)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, frameon=False, fontsize=9, loc="outside lower center", ncols=3)
    figure.suptitle(title, fontsize=11)
    return figure


def _band(axes: Axes, time: Any, values: Any, hue: str) -> None:
    """Mean and twice the standard deviation of values (trial, time)."""
    mean, spread = values.mean(axis=0), 2 * values.std(axis=0)
    axes.fill_between(time, mean - spread, mean + spread, color=hue, alpha=0.25, linewidth=0, label="± 2 SD")
    axes.plot(time, mean, color=hue, linewidth=1.5, label="mean")
