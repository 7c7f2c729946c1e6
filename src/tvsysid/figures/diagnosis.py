"""Figures of a diagnosis: input and response over frequency, time, realizations and lags."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tvsysid.figures import style
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
    figure, grid = style.panels(title, (3.1, 2.6), [""] * 2, [""] * 3)
    angle, torque, coherence, halves, realizations, lags = grid.flat
    curves = diagnosis.curves
    natural = diagnosis.measures["natural frequency"][0]
    if natural > LOWEST:
        angle.axvspan(LOWEST, natural, color=GREEN, alpha=0.2, linewidth=0, label="band needed")
    _draw_spectra(angle, curves.frequency, {"angle": curves.angle_power})
    powers = {"torque": curves.torque_power, "left by the model": curves.residual_power}
    _draw_spectra(torque, curves.frequency, powers)
    _draw_coherence(coherence, curves)
    first, second = curves.stiffness_halves
    halves.plot(curves.time, first, label="first half")
    halves.plot(curves.time, second, "--", label="second half")
    halves.axhline(0.0, color=style.INK, linewidth=0.8)
    realizations.axhline(1.0, color=style.INK, linewidth=0.8)
    realizations.plot(curves.stiffness, "o", color=BLUE, markersize=2.5, label="stiffness")
    realizations.plot(curves.noise, "^", color=RED, markersize=2.5, label="noise")
    realizations.set_ylim(bottom=0.0)
    correlations = dict(zip(("with angle", "with speed"), curves.correlation, strict=True))
    draw_correlations(lags, 1000 * curves.lag, correlations, float(curves.chance))
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
            axes.legend()
    return figure


def draw_correlations(
    axes: Axes, lag: Array, correlations: Mapping[str, Array], chance: float
) -> None:
    """Draw correlations over lags, and the limits within which 95 % are by chance."""
    axes.axhspan(-chance, chance, color=style.INK, alpha=0.15, linewidth=0, label="95 % by chance")
    axes.axhline(0, color=style.INK, linewidth=0.6)
    for number, (label, values) in enumerate(correlations.items()):
        beside = lag + 0.4 * number * (lag[1] - lag[0])
        axes.vlines(beside, 0, values, color=style.PALETTE[number], linewidth=1.2, label=label)
    axes.margins(0.02, 0.3)


def _draw_spectra(axes: Axes, frequency: Array, powers: Mapping[str, Array]) -> None:
    """Draw powers where they are positive, over logarithmic axes."""
    for label, power in powers.items():
        shown = (frequency > 0) & (frequency <= HIGHEST) & (power > DYNAMIC_RANGE * power.max())
        axes.loglog(frequency[shown], power[shown], linewidth=1.2, label=label)
    axes.set_xlim(frequency[1], HIGHEST)
    style.log_ticks(axes.xaxis)
    style.log_ticks(axes.yaxis)


def _draw_coherence(axes: Axes, curves: Curves) -> None:
    if not curves.coherence.size:
        style.remark(axes, "realizations too short")
        return
    mesh = axes.pcolormesh(
        curves.coherence_time,
        curves.coherence_frequency,
        curves.coherence.T,
        vmin=0,
        vmax=1,
        cmap="cividis",
        rasterized=True,
    )
    axes.set_ylim(0, HIGHEST)
    axes.figure.colorbar(mesh, ax=axes, label="coherence")
