"""How the errors fall with more data or less noise."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tvsysid.errors import InputError
from tvsysid.figures.style import Array, legend_below, lines, panels, styled
from tvsysid.figures.words import perturbation_name, wrapped

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ERRORS = {
    "debiased_bias_error": "bias error, debiased\n(N·m/rad)",
    "random_error": "random error\n(N·m/rad)",
    "total_error": "total error\n(N·m/rad)",
}
AMOUNTS = {"duration_s": "data (s)", "snr_db": "signal-to-noise ratio (dB)"}
MARKERS = "osD^vPX<"


@styled
def error_against_amount(summary: pd.DataFrame, title: str = "") -> Figure:
    """Bias, random and total error against the amount of data, a line for each method.

    Parameters
    ----------
    summary
        Rows of a study's summary for one stiffness profile and viscosity, with several durations and one
        signal-to-noise ratio, or the other way round. Data without noise have no place on the axis of ratios and are
        left out.
    title
        Above all.

    Returns
    -------
    matplotlib.figure.Figure
        A row for each error, a column for each perturbation; value ± standard error.

    Raises
    ------
    InputError
        If durations and signal-to-noise ratios both vary.
    """
    several = [name for name in AMOUNTS if summary[name].nunique() > 1]
    if len(several) > 1:
        raise InputError(
            "error_against_amount: durations and signal-to-noise ratios both vary; give the rows of one duration or "
            "of one ratio"
        )
    amount = several[0] if several else "duration_s"
    rows = summary[np.isfinite(summary[amount])]
    perturbations, methods = list(rows.perturbation.unique()), list(rows.method.unique())
    columns = max(len(perturbations), 1)
    figure, grid = panels(len(ERRORS), columns, max(3.3 * columns + 0.6, 4.0), 6.8, title, sharex=True, sharey="row")
    for column, perturbation in zip(grid.T, perturbations, strict=False):
        there = rows[rows.perturbation == perturbation]
        column[0].set_title(perturbation_name(perturbation))
        column[-1].set_xlabel(AMOUNTS[amount])
        for axes, error in zip(column, ERRORS, strict=True):
            _lines(axes, there[there.metric == error], amount, methods)
    ticks = sorted(rows[amount].unique())
    if amount == "duration_s":
        grid[0, 0].set_xscale("log")
    grid[0, 0].set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    grid[0, 0].minorticks_off()
    for axes, (error, label) in zip(grid[:, 0], ERRORS.items(), strict=True):
        axes.set_ylabel(label)
        _scale(axes, rows[rows.metric == error].value.to_numpy(dtype=float))
    figure.align_ylabels(grid[:, 0])
    legend_below(figure, grid[0, 0].get_legend_handles_labels()[0])
    return figure


def _lines(axes: Axes, rows: pd.DataFrame, amount: str, methods: list[str]) -> None:
    for number, (method, (hue, style)) in enumerate(lines(methods).items()):
        line = rows[rows.method == method].sort_values(amount)
        axes.errorbar(
            line[amount],
            line.value,
            line.standard_error.fillna(0.0),
            color=hue,
            linestyle=style,
            linewidth=1.2,
            marker=MARKERS[number % len(MARKERS)],
            markersize=4.5,
            capsize=2,
            label=wrapped(method, 40),
        )


def _scale(axes: Axes, values: Array) -> None:
    """Logarithmic where values span most of a decade, with plain numbers at its ticks; from zero otherwise."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter  # noqa: PLC0415  # heavy

    known = values[np.isfinite(values)]
    if known.size and known.min() > 0 and known.max() > 6 * known.min():
        axes.set_yscale("log")
        axes.set_ylim(0.8 * known.min(), 1.25 * known.max())
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
    else:
        axes.set_ylim(bottom=0)
