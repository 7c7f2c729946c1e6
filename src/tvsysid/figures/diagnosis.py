"""Figures of a diagnosis: input and response over frequency, time, realizations and lags."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid.figures import style
from tvsysid.figures.saving import Illustration
from tvsysid.numerics import Array
from tvsysid.quality import Curves, Diagnosis

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
    figure, ((angle, torque, coherence), (halves, realizations, lags)) = style.panels(
        2, 3, 10.0, 6.2, title
    )
    curves = diagnosis.curves
    natural = diagnosis.measures["natural frequency"][0]
    if np.isfinite(natural) and natural > LOWEST:
        angle.axvspan(LOWEST, natural, color=GREEN, alpha=0.2, linewidth=0, label="band needed")
    _spectra(angle, curves.frequency, {"angle": curves.angle_power})
    powers = {"torque": curves.torque_power, "left by the model": curves.residual_power}
    _spectra(torque, curves.frequency, powers)
    _coherence(coherence, curves)
    first, second = curves.stiffness_halves
    halves.plot(curves.time, first, color=BLUE, label="first half")
    halves.plot(curves.time, second, "--", color=RED, label="second half")
    halves.set_ylim(style.usual_limits((), np.append(curves.stiffness_halves, 0.0)))
    halves.margins(x=0)
    realizations.axhline(1.0, color=style.INK, linewidth=0.8)
    numbers = np.arange(len(curves.noise))
    realizations.plot(numbers, curves.stiffness, "o", color=BLUE, markersize=2.5, label="stiffness")
    realizations.plot(numbers, curves.noise, "^", color=RED, markersize=2.5, label="noise")
    ratios = np.stack([curves.stiffness, curves.noise])
    realizations.set_ylim(style.usual_limits(ratios, np.array([0.0, 2.0])))
    _lags(lags, curves)
    labels = {
        angle: ("input: power of the angle", "frequency (Hz)", "rad²/Hz"),
        torque: ("output: power of the torque", "frequency (Hz)", "(N·m)²/Hz"),
        coherence: ("coherence of torque and angle", style.REALIZATION_TIME, "frequency (Hz)"),
        halves: ("stiffness in both halves of the experiment", style.REALIZATION_TIME, "N·m/rad"),
        realizations: ("each realization over the median", "realization, as recorded", "ratio"),
        lags: ("correlation of the torque left over", "lag of the torque (ms)", "correlation"),
    }
    for axes, (heading, below, beside) in labels.items():
        axes.set_title(heading)
        axes.set_xlabel(below)
        axes.set_ylabel(beside)
        if axes is not coherence:
            axes.legend(fontsize=7)
    return figure


def diagnosis_illustration(diagnosis: Diagnosis, name: str) -> Illustration:
    """Return the six pictures of a diagnosis with a title and a description."""
    curves = diagnosis.curves
    measures = {
        key: f"{value:.3g} {unit}".removesuffix(" 1")
        for key, (value, unit) in diagnosis.measures.items()
    }
    drift = next(check.what for check in diagnosis.checks if check.name == "drift")
    farthest = [
        f"{np.abs(values).max():.2f} at {1000 * curves.lag[np.argmax(np.abs(values))]:.0f} ms"
        for values in curves.correlation
    ]
    coherence = float(np.median(curves.coherence[:, _shown(curves.coherence_frequency)]))
    sentences = [
        "Power of the angle over frequency, 95 % of it below "
        f"{measures['bandwidth of the angle']}, and the band from {LOWEST:g} Hz to the joint's "
        f"natural frequency of {measures['natural frequency']}.",
        "Power of the torque, and of what stiffness, viscosity and inertia leave of it: they "
        f"explain {measures['explained torque']}.",
        f"Coherence of torque and angle over time and frequency, median {coherence:.2f} up to "
        f"{HIGHEST:g} Hz.",
        f"Stiffness over time in the first half of the experiment and in the second ({drift}).",
        f"Stiffness of each realization over the median, from {curves.stiffness.min():.2f} to "
        f"{curves.stiffness.max():.2f}, and its noise, from {curves.noise.min():.2f} to "
        f"{curves.noise.max():.2f}.",
        f"Correlation of the torque left over with the angle, largest {farthest[0]}, and with the "
        f"speed, largest {farthest[1]}; by chance 95 % of them lie below "
        f"{float(curves.chance):.2f}, the grey band. What is beyond it at positive lags is a "
        "reflex, a slow answer or a delay, at negative ones feedback.",
    ]
    return Illustration(
        partial(diagnosis_panels, diagnosis, name), f"Diagnosis of {name}", " ".join(sentences)
    )


def _shown(frequency: Array) -> Any:
    return (frequency > 0) & (frequency <= HIGHEST)


def _spectra(axes: Axes, frequency: Array, powers: dict[str, Array]) -> None:
    """Draw powers where they are positive, over logarithmic axes."""
    for (label, power), hue in zip(powers.items(), (BLUE, RED), strict=False):
        shown = _shown(frequency) & (power > DYNAMIC_RANGE * power.max())
        axes.loglog(frequency[shown], power[shown], color=hue, linewidth=1.2, label=label)
    axes.set_xlim(frequency[1], HIGHEST)
    style.log_ticks(axes.xaxis)
    axes.yaxis.set_major_formatter("{x:.0e}")
    axes.yaxis.set_minor_formatter("")


def _coherence(axes: Axes, curves: Curves) -> None:
    axes.grid(visible=False)
    shown = _shown(curves.coherence_frequency)
    if not len(curves.coherence) or not shown.any():
        style.remark(axes, "realizations too short")
        return
    time, frequency = curves.coherence_time, curves.coherence_frequency[shown]
    look: dict[str, Any] = {"vmin": 0, "vmax": 1, "cmap": "cividis", "rasterized": True}
    mesh = axes.pcolormesh(time, frequency, curves.coherence[:, shown].T, **look)
    axes.figure.colorbar(mesh, ax=axes, label="coherence")


def _lags(axes: Axes, curves: Curves) -> None:
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
    axes.margins(x=0.01)
