"""Figures of a diagnosis: input and response over frequency, time, realizations and lags."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tvsysid.figures import style
from tvsysid.figures.saving import Illustration
from tvsysid.numerics import Array
from tvsysid.quality import Curves, Diagnosis

LOWEST = 2.0  # Hz below which stiffness shows by itself
HIGHEST = 40.0  # Hz that are drawn
DYNAMIC_RANGE = 1e-7  # share of the highest power that is drawn: less is that of filters
BLUE, RED, GREEN = style.PALETTE[:3]


@style.styled
def diagnosis_panels(diagnosis: Diagnosis, title: str = "") -> Figure:
    """Draw the six pictures of a diagnosis of an ensemble.

    Power of the angle with the band that is needed, power of the torque and of what the joint's
    model leaves, coherence over time and frequency, stiffness in both halves of the experiment,
    stiffness and noise of each realization, and correlation of the torque left over with angle
    and speed over lags.
    """
    figure, grid = style.panels(2, 3, 10.0, 6.2, title)
    angle, torque, coherence, halves, realizations, lags = grid.flat
    curves = diagnosis.curves
    natural = diagnosis.measures["natural frequency"][0]
    if natural > LOWEST:
        angle.axvspan(LOWEST, natural, color=GREEN, alpha=0.2, linewidth=0, label="band needed")
    _draw_spectra(angle, curves.frequency, {"angle": curves.angle_power})
    powers = {"torque": curves.torque_power, "left by the model": curves.residual_power}
    _draw_spectra(torque, curves.frequency, powers)
    _draw_coherence(coherence, curves)
    for values, label, line in zip(
        curves.stiffness_halves, ("first half", "second half"), ("-", "--"), strict=True
    ):
        halves.plot(curves.time, values, line, label=label)
    halves.axhline(0.0, color=style.INK, linewidth=0.8)
    realizations.axhline(1.0, color=style.INK, linewidth=0.8)
    realizations.plot(curves.stiffness, "o", color=BLUE, markersize=2.5, label="stiffness")
    realizations.plot(curves.noise, "^", color=RED, markersize=2.5, label="noise")
    realizations.set_ylim(bottom=0.0)
    _draw_correlations(lags, curves)
    labels = [
        ("input: power of the angle", "frequency (Hz)", "rad²/Hz"),
        ("output: power of the torque", "frequency (Hz)", "(N·m)²/Hz"),
        ("coherence of torque and angle", style.REALIZATION_TIME, "frequency (Hz)"),
        ("stiffness in both halves of the experiment", style.REALIZATION_TIME, "N·m/rad"),
        ("each realization over the median", "realization, as recorded", "ratio"),
        ("correlation of the torque left over", "lag of the torque (ms)", "correlation"),
    ]
    for axes, (heading, below, beside) in zip(grid.flat, labels, strict=True):
        axes.set(title=heading, xlabel=below, ylabel=beside)
        if axes is not coherence:
            axes.legend(fontsize=7)
    return figure


def diagnosis_illustration(diagnosis: Diagnosis, name: str) -> Illustration:
    """Return the six pictures of a diagnosis with a title and a description."""
    value, unit = diagnosis.measures["natural frequency"]
    text = (
        "Power of the angle over frequency, and the band from "
        f"{LOWEST:g} Hz to the joint's natural frequency of {value:.3g} {unit}. Power of the "
        "torque, and of what stiffness, viscosity and inertia leave of it. Coherence of torque and "
        "angle over time and frequency. Stiffness over time in the first and the second half of "
        "the experiment. Stiffness and noise of each realization over their median. Correlation of "
        "the torque left over with the angle and with the speed; by chance 95 % of them lie in "
        "the grey band. What is beyond it at positive lags is a reflex, a slow answer or a delay, "
        "at negative ones feedback. The tables have the numbers."
    )
    draw = partial(diagnosis_panels, diagnosis, name)
    return Illustration(draw, f"Diagnosis of {name}", text)


def _draw_spectra(axes: Axes, frequency: Array, powers: dict[str, Array]) -> None:
    """Draw powers where they are positive, over logarithmic axes."""
    for label, power in powers.items():
        shown = (frequency > 0) & (frequency <= HIGHEST) & (power > DYNAMIC_RANGE * power.max())
        axes.loglog(frequency[shown], power[shown], linewidth=1.2, label=label)
    axes.set_xlim(frequency[1], HIGHEST)
    style.log_ticks(axes.xaxis)
    axes.yaxis.set_major_formatter("{x:.0e}")
    axes.yaxis.set_minor_formatter("")


def _draw_coherence(axes: Axes, curves: Curves) -> None:
    axes.grid(visible=False)
    shown = (curves.coherence_frequency > 0) & (curves.coherence_frequency <= HIGHEST)
    if not len(curves.coherence) or not shown.any():
        style.remark(axes, "realizations too short")
        return
    time, frequency = curves.coherence_time, curves.coherence_frequency[shown]
    look: dict[str, Any] = {"vmin": 0, "vmax": 1, "cmap": "cividis", "rasterized": True}
    mesh = axes.pcolormesh(time, frequency, curves.coherence[:, shown].T, **look)
    axes.figure.colorbar(mesh, ax=axes, label="coherence")


def _draw_correlations(axes: Axes, curves: Curves) -> None:
    """Draw two combs side by side.

    A joint of second order that is moved from outside leaves both within the limits.
    """
    lag, limit = 1000 * curves.lag, float(curves.chance)
    axes.axhspan(-limit, limit, color=style.INK, alpha=0.15, linewidth=0, label="chance")
    axes.axvline(0, color=style.INK, linewidth=0.6)
    step, (angle, speed) = lag[1] - lag[0], curves.correlation
    axes.vlines(lag - 0.15 * step, 0, angle, color=BLUE, linewidth=1.2, label="with angle")
    axes.vlines(lag + 0.25 * step, 0, speed, color=RED, linewidth=1.2, label="with speed")
    highest = max(float(np.abs(curves.correlation).max()), 3 * limit)
    axes.set_ylim(-1.1 * highest, 1.5 * highest)
