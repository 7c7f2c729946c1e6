"""What was identified from one recording, and how settings were chosen."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from scipy.signal import fftconvolve

from tvsysid.dataset_layout import UNITS
from tvsysid.figures import style
from tvsysid.figures.diagnosis import draw_correlations
from tvsysid.figures.words import unit_name, wrapped
from tvsysid.methods import Evidence
from tvsysid.models import IMPEDANCE, Model
from tvsysid.numerics import Array
from tvsysid.numerics.bands import mean_known
from tvsysid.signals import Ensemble

BINS = 40
HELD_OUT_S = 6.0  # of held-out realizations that are drawn
MAX_LAG_S = 0.5


@style.styled
def identified_impedance(
    models: Mapping[str, Model],
    vaf: Mapping[str, Array],
    title: str = "",
    spread: ArrayLike = np.nan,
) -> Figure:
    """Draw every quantity of the models with 95 % bands: stiffness above its VAF, others beside it.

    The first of the models is in front, with a thicker line. Dashed lines are likely switches.

    Axes for stiffness, VAF, viscosity, inertia, and each further quantity, which is drawn over its
    own axis. A quantity of the impedance says so where no method identified it. Estimates of single
    realizations are averaged.

    Parameters
    ----------
    models, vaf
        By label: the models, and their time-varying VAF in per cent, shape (time,); no axes for it
        if it is empty.
    spread
        How far methods differ from the first in N·m/rad, shape (time,): a lighter band.
    """
    estimated = [name for model in models.values() for name in model.estimates]
    _, *beside = dict.fromkeys([*IMPEDANCE, *estimated])
    left = ["stiffness", "stiffness", "VAF" if vaf else "stiffness"]
    figure = style.blank(11.0, max(6.0, 2.2 * len(beside) + 0.8), title)
    rows = range(3 * len(beside))
    mosaic: Any = [[left[row // len(beside)], beside[row // 3]] for row in rows]
    grid = figure.subplot_mosaic(mosaic, width_ratios=[1.6, 1])
    draw_quantity(grid["stiffness"], "stiffness", models, spread=spread)
    for name in beside:
        draw_quantity(grid[name], name, models)
    for label, look in _lines(models).items() if vaf else ():
        style.curve(grid["VAF"], models[label].time, vaf[label], **look)
        grid["VAF"].set(xlabel=style.REALIZATION_TIME, ylabel="time-varying VAF (%)", ylim=(0, 102))
    return style.finish(figure)


@style.styled
def identified_quantity(
    models: Mapping[str, Model], name: str, simultaneous: bool = False
) -> Figure:
    """Draw one quantity over time by the models, with 95 % bands, pointwise or ``simultaneous``."""
    figure, ((axes,),) = style.panels("", (5.6, 2.3))
    draw_quantity(axes, name, models, simultaneous)
    return style.finish(figure)


def draw_quantity(
    axes: Axes,
    name: str,
    models: Mapping[str, Model],
    simultaneous: bool = False,
    spread: ArrayLike = np.nan,
) -> None:
    """Draw a quantity over its axis, by every model that estimates it, and its likely switches.

    A lighter band shows how far methods differ from the first, the ``spread``.
    """
    words, unit, over = name.replace("_", " "), UNITS.get(name, ""), "time"
    curves: list[Array] = []
    always: list[Array] = []
    for label, look in _lines(models).items():
        model, estimate = models[label], models[label].estimates.get(name)
        if estimate is None or not np.isfinite(estimate.values).any():
            continue
        unit, over = estimate.unit, estimate.axes[-1]
        x = np.asarray(model.coordinates.get(over, model.time))
        values, band = mean_known(np.atleast_2d(estimate.values)), np.array(np.nan)
        if estimate.values.size == len(x):  # a mean over realizations has no band
            band = np.reshape(estimate.band(simultaneous=simultaneous), (2, -1))
        if not curves:
            differing = values + np.outer([-1, 1], np.asarray(spread))
            always = [band, differing]
            if np.isfinite(differing).any():
                axes.fill_between(
                    x,
                    *differing,
                    color=style.INK,
                    alpha=0.12,
                    linewidth=0,
                    zorder=1,
                    label="methods differ",
                )
        curves.append(values)
        style.curve(axes, x, values, band, **look)
        for switch in getattr(model, "switches", ()):
            if switch.quantity == name and switch.probability > 0.5:
                axes.axvspan(switch.earliest, switch.latest, color=style.INK, alpha=0.2)
                text = f"{words} {switch.size:+.3g} at {switch.time:.3f} s".replace("-", "−")
                axes.axvline(switch.time, color=style.INK, linestyle="--", lw=0.8, label=text)
    below = style.REALIZATION_TIME if over == "time" else over
    axes.set(xlabel=below, ylabel=f"{words} ({unit_name(unit)})")
    style.limit_to_usual(axes, curves, always)
    if not curves:
        style.remark(axes, "not identified")


def _lines(models: Mapping[str, Model]) -> dict[str, dict[str, Any]]:
    """Return settings of the lines; the first stands out."""
    looks = {label: look | {"linewidth": 0.9} for label, look in style.lines(list(models)).items()}
    next(iter(looks.values())).update(linewidth=2.0, zorder=4)
    return looks


@style.styled
def held_out_prediction(torques: Array, sampling_rate: float, title: str = "") -> Figure:
    """Draw measured and predicted torque of held-out realizations, and their difference.

    The autocorrelation of the difference, over lags within a realization, stands below. That of
    white noise is within the limits at 95 % of the lags.

    Parameters
    ----------
    torques
        Measured and predicted torque in N·m, shape (2, realization, time), as of
        :meth:`tvsysid.Comparison.predict_held_out`. Six seconds of them are drawn.
    """
    residual, samples = torques[0] - torques[1], torques.shape[-1]
    labels = ["torque (N·m)", "residual (N·m)", "autocorrelation\nof the residual"]
    figure, ((above,), (middle,), (below,)) = style.panels(title, (8.2, 1.6), labels)
    count = max(1, round(HELD_OUT_S * sampling_rate / samples))
    measured, predicted, rest = (each[:count].ravel() for each in (*torques, residual))
    time = np.arange(len(rest)) / sampling_rate
    above.plot(time, measured, color=style.TARGET, linewidth=0.8, label="measured")
    above.plot(time, predicted, color=style.PALETTE[1], linewidth=0.8, label="predicted")
    middle.plot(time, rest, color=style.INK, linewidth=0.8)
    middle.set_xlabel("time, realizations in a row (s)")
    lags = np.arange(1, min(samples, round(MAX_LAG_S * sampling_rate)))
    known = np.nan_to_num(residual)
    products = fftconvolve(known, known[:, ::-1], axes=1).sum(axis=0)[samples - 1 :]
    chance = 1.96 / np.sqrt(np.isfinite(residual).sum())
    draw_correlations(below, lags / sampling_rate, {"": products[lags] / products[0]}, chance)
    below.set_xlabel("lag (s)")
    return style.finish(figure)


@style.styled
def scheduled_estimates(
    models: Mapping[str, Model], ensemble: Ensemble, variable: str, title: str = ""
) -> Figure:
    """Draw each quantity over a variable, with 95 % bands, above a histogram of the variable.

    Parameters
    ----------
    models
        By label; one at least estimates something over the ``variable``.
    ensemble
        With the variable as a channel.
    """
    estimates = [item for model in models.values() for item in model.estimates.items()]
    names = dict.fromkeys(name for name, estimate in estimates if estimate.axes == (variable,))
    rows = [""] * (len(names) + 1)
    figure, (*above, (below,)) = style.panels(title, (5.4, 2.0), rows, sharex=True)
    for (axes,), name in zip(above, names, strict=True):
        draw_quantity(axes, name, models)
        axes.set_xlabel("")
    values = ensemble.signal(variable)[:, ensemble.core].ravel()
    weights = np.full(len(values), 1 / ensemble.sampling_rate)
    below.hist(values, BINS, weights=weights, color=style.INK)
    below.set(xlabel=variable, ylabel="time spent there (s)")
    return style.finish(figure)


@style.styled
def tuning_curves(evidence: Mapping[str, Evidence], title: str = "") -> Figure:
    """Draw by how much all settings tried are worse than the best, in axes for each method."""
    labels = ["worse than the best by (nat)"] * len(evidence)
    figure, grid = style.panels(title, (4.7, 3.0), labels)
    for (axes,), (label, tried) in zip(grid, evidence.items(), strict=True):
        worse, names = np.nanmax(tried.values) - tried.values, np.array(tried.lines)
        order = np.argsort(tried.positions)
        for name in dict.fromkeys(tried.lines):
            mine = order[names[order] == name]
            axes.plot(tried.positions[mine], worse[mine], "o-", label=name or "tried")
        for text, place, fill in (("as given", 0, "none"), ("chosen", tried.chosen, "full")):
            axes.plot(
                tried.positions[place],
                worse[place],
                "o",
                color=style.INK,
                markersize=10,
                fillstyle=fill,
                label=text,
            )
        axes.margins(x=0.05)
        axes.set_yscale("symlog", linthresh=1.0)
        axes.yaxis.set_major_formatter("{x:g}")
        axes.set(xlabel=tried.axis, title=wrapped(label, 44))
        axes.legend()
    return figure
