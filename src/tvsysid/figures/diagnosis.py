"""Figures of a diagnosis: input and response over frequency, time, realizations and lags."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid.figures.saving import Illustration
from tvsysid.figures.style import INK, PALETTE, REALIZATION_TIME, panels, styled
from tvsysid.numerics import Array
from tvsysid.quality import Curves, Diagnosis

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LOWEST = 2.0  # Hz below which stiffness shows by itself
SHOWN = 40.0  # highest frequency in Hz that is drawn
DYNAMIC_RANGE = (
    1e-7  # power below the highest by more than this is not drawn: that of filters' stop bands
)
FARTHEST = 3.0  # multiple of what is usual at which a realization is drawn at the edge


@styled
def diagnosis_panels(diagnosis: Diagnosis, title: str = "") -> Figure:
    """Draw the six pictures of a diagnosis of an ensemble.

    Power of the angle with the band that is needed, power of the torque and of what the joint's
    model leaves, coherence over time and frequency, stiffness in both halves of the experiment,
    stiffness and noise of each realization, and correlation of the torque left over with angle
    and speed over lags.
    """
    figure, grid = panels(2, 3, 10.0, 6.2, title)
    curves = diagnosis.curves
    _angle(grid[0, 0], curves, diagnosis.measures["natural frequency"][0])
    _torque(grid[0, 1], curves)
    _coherence(figure, grid[0, 2], curves)
    _halves(grid[1, 0], curves)
    _realizations(grid[1, 1], curves)
    _lags(grid[1, 2], curves)
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
    inside = curves.coherence[
        :, (curves.coherence_frequency > 0) & (curves.coherence_frequency <= SHOWN)
    ]
    sentences = [
        "Power of the angle over frequency, 95 % of it below "
        f"{measures['bandwidth of the angle']}, and the band from {LOWEST:g} Hz to the joint's "
        f"natural frequency of {measures['natural frequency']}.",
        "Power of the torque, and of what stiffness, viscosity and inertia leave of it: they "
        f"explain {measures['explained torque']}.",
        "Coherence of torque and angle over time and frequency, median "
        f"{float(np.median(inside)):.2f} up to {SHOWN:g} Hz.",
        f"Stiffness over time in the first half of the experiment and in the second ({drift}).",
        f"Stiffness of each realization over what is usual, from {curves.stiffness.min():.2f} to "
        f"{curves.stiffness.max():.2f}, and its noise, from {curves.noise.min():.2f} to "
        f"{curves.noise.max():.2f}.",
        f"Correlation of the torque left over with the angle, largest {farthest[0]}, and with the "
        f"speed, largest {farthest[1]}; by chance 95 % of them lie below "
        f"{float(curves.chance):.2f}, the grey band. What is beyond it at positive lags is a "
        "reflex, a slow answer or a delay, at negative ones feedback.",
    ]
    return Illustration(
        partial(diagnosis_panels, diagnosis, name), f"What was seen in {name}", " ".join(sentences)
    )


def _angle(axes: Axes, curves: Curves, natural: float) -> None:
    if np.isfinite(natural) and natural > LOWEST:
        axes.axvspan(LOWEST, natural, color=PALETTE[2], alpha=0.2, linewidth=0, label="band needed")
    _spectrum(axes, curves.frequency, curves.angle_power, PALETTE[0], "angle")
    _name(axes, "input: power of the angle", "frequency (Hz)", "rad²/Hz", loc="lower left")


def _torque(axes: Axes, curves: Curves) -> None:
    _spectrum(axes, curves.frequency, curves.torque_power, PALETTE[0], "torque")
    _spectrum(axes, curves.frequency, curves.residual_power, PALETTE[1], "left by the model")
    _name(axes, "output: power of the torque", "frequency (Hz)", "(N·m)²/Hz", loc="lower left")


def _name(axes: Axes, title: str, below: str, beside: str = "", **legend: Any) -> None:
    axes.set_title(title)
    axes.set_xlabel(below)
    axes.set_ylabel(beside)
    if legend:
        axes.legend(fontsize=7, **legend)


def _spectrum(axes: Axes, frequency: Array, power: Array, colour: str, label: str) -> None:
    """Draw power where it is positive, over a logarithmic axis."""
    shown = (frequency > 0) & (frequency <= SHOWN)
    shown &= power > DYNAMIC_RANGE * power.max()
    axes.loglog(frequency[shown], power[shown], color=colour, linewidth=1.2, label=label)
    axes.set_xlim(frequency[1], SHOWN)
    ticks = [tick for tick in (0.5, 1, 2, 5, 10, 20, 40) if frequency[1] <= tick <= SHOWN]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.tick_params(axis="x", which="minor", bottom=False, labelbottom=False)
    axes.tick_params(which="minor", labelsize=7)


def _coherence(figure: Figure, axes: Axes, curves: Curves) -> None:
    axes.grid(visible=False)
    _name(axes, "coherence of torque and angle", REALIZATION_TIME, "frequency (Hz)")
    shown = (curves.coherence_frequency > 0) & (curves.coherence_frequency <= SHOWN)
    if not len(curves.coherence) or not shown.any():
        axes.text(
            0.5, 0.5, "realizations too short", transform=axes.transAxes, ha="center", va="center"
        )
        return
    mesh = axes.pcolormesh(
        curves.coherence_time,
        curves.coherence_frequency[shown],
        curves.coherence[:, shown].T,
        vmin=0,
        vmax=1,
        cmap="cividis",
        shading="nearest",
        rasterized=True,
    )
    bar = figure.colorbar(mesh, ax=axes, pad=0.02)
    bar.ax.tick_params(labelsize=7)
    bar.set_label("coherence")
    bar.outline.set_visible(False)


def _halves(axes: Axes, curves: Curves) -> None:
    for values, colour, style, label in zip(
        curves.stiffness_halves, PALETTE, ("-", "--"), ("first half", "second half"), strict=False
    ):
        axes.plot(curves.time, values, color=colour, linestyle=style, linewidth=1.3, label=label)
    low, high = float(curves.stiffness_halves.min()), float(curves.stiffness_halves.max())
    room = 0.25 * max(high - low, 0.2 * max(abs(low), abs(high))) or 1.0
    axes.set_ylim(min(0.0, low - room), max(0.0, high + 2 * room))
    axes.margins(x=0)
    title = "stiffness in both halves of the experiment"
    _name(axes, title, REALIZATION_TIME, "N·m/rad", loc="upper right", ncols=2)


def _realizations(axes: Axes, curves: Curves) -> None:
    numbers = np.arange(len(curves.stiffness))
    axes.axhline(1.0, color=INK, linewidth=0.8)
    for values, colour, marker, label in (
        (curves.stiffness, PALETTE[0], "o", "stiffness"),
        (curves.noise, PALETTE[1], "^", "noise"),
    ):
        shown = np.clip(values, 1 - FARTHEST, FARTHEST)
        axes.plot(
            numbers, shown, marker, color=colour, markersize=2.5, linestyle="none", label=label
        )
    low = min(0.0, float(np.clip(curves.stiffness.min(), 1 - FARTHEST, 0)) - 0.1)
    axes.set_ylim(
        low, max(2.0, min(FARTHEST, float(max(curves.stiffness.max(), curves.noise.max()))) + 0.6)
    )
    about = "each realization over what is usual", "realization, as recorded", "ratio"
    _name(axes, *about, loc="upper right", ncols=2, handletextpad=0.1, columnspacing=1)


def _lags(axes: Axes, curves: Curves) -> None:
    """Draw two combs side by side.

    A joint of second order that is moved from outside leaves both within the limits.
    """
    step = 1000 * float(curves.lag[1] - curves.lag[0])
    limit = float(curves.chance)
    axes.axhspan(-limit, limit, color=INK, alpha=0.15, linewidth=0, label="chance")
    axes.axvline(0, color=INK, linewidth=0.6)
    for values, colour, side, label in zip(
        curves.correlation, PALETTE, (-0.15, 0.25), ("with angle", "with speed"), strict=False
    ):
        axes.vlines(
            1000 * curves.lag + side * step, 0, values, color=colour, linewidth=1.2, label=label
        )
    highest = max(float(np.abs(curves.correlation).max()), 3 * limit)
    axes.set_ylim(-1.1 * highest, 1.5 * highest)
    about = "correlation of the torque left over", "lag of the torque (ms)", "correlation"
    _name(axes, *about, loc="upper right", ncols=3, columnspacing=1, handlelength=1.2)
    axes.margins(x=0.01)
