"""What the pictures of a diagnosis show; arrays only."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from tvsysid.numerics.spectra import hann, short_time_spectra
from tvsysid.quality.evidence import Evidence, innovations
from tvsysid.quality.fit import fit_motion
from tvsysid.quality.repetition import relative_noise, relative_stiffness

Array = NDArray[np.float64]

SEGMENT = 0.64
"""Length in s of the segments whose coherence is shown."""
WELCH = 2.0
"""Length in s of the segments whose spectrum is shown."""
FARTHEST = 0.3
"""Lags in s that are shown, to either side."""
WHITENING = 0.12
"""Seconds of a signal's past that make it white before it is correlated."""


@dataclass(frozen=True, eq=False)
class Curves:
    """Spectra, coherence, stiffness and correlations of an ensemble.

    Parameters
    ----------
    frequency
        In Hz, shape (frequency,).
    angle_power, torque_power, residual_power
        Power densities of the deviations from the mean over realizations, in rad²/Hz and (N·m)²/Hz, shape (frequency,).
    coherence
        Of torque and angle, shape (coherence time, coherence frequency); chance leaves one over the realizations.
    coherence_time, coherence_frequency
        In s and Hz.
    time
        Within a realization in s, shape (time,).
    stiffness_halves
        Of the first and the second half of the experiment in N·m/rad, shape (2, time).
    stiffness, noise
        Of each realization over what is usual, in the order of recording, shape (realization,).
    lag
        In s, positive where the torque is later, shape (lag,).
    correlation
        Of the torque that the model leaves with angle and with speed, each whitened, shape (2, lag).
    chance
        Distance from zero that 95 % of the correlations of unrelated signals keep.
    """

    frequency: Array
    angle_power: Array
    torque_power: Array
    residual_power: Array
    coherence: Array
    coherence_time: Array
    coherence_frequency: Array
    time: Array
    stiffness_halves: Array
    stiffness: Array
    noise: Array
    lag: Array
    correlation: Array
    chance: Array

    def __post_init__(self) -> None:
        for field in fields(self):
            getattr(self, field.name).flags.writeable = False


def curves(evidence: Evidence) -> Curves:
    """All that the pictures show."""
    rate, fit = evidence.rate, evidence.fit
    length = min(fit.torque.shape[1], round(WELCH * rate))
    angle, torque, residual = (
        _power(values, length, rate) for values in (fit.motion[0], fit.torque, evidence.residual)
    )
    coherence, coherence_time, coherence_frequency = _coherence(evidence)
    lag, correlation, chance = _correlation(evidence)
    order = evidence.order
    halves = []
    for half in (order[: len(order) // 2], order[len(order) // 2 :]):
        own = fit_motion(fit.motion[:, half], fit.torque[half], rate, fit.first)
        halves.append(own.stiffness[own.bins])
    return Curves(
        np.asarray(np.fft.rfftfreq(length, 1 / rate), dtype=np.float64),
        angle,
        torque,
        residual,
        coherence,
        coherence_time,
        coherence_frequency,
        (fit.first - evidence.ensemble.context + np.arange(fit.torque.shape[1])) / rate,
        np.stack(halves),
        relative_stiffness(evidence)[order],
        relative_noise(evidence)[order],
        lag,
        correlation,
        np.asarray(chance),
    )


def _power(values: Array, length: int, rate: float) -> Array:
    """One-sided power density of the first samples of each realization, averaged."""
    window = hann(length)
    power = np.mean(np.abs(np.fft.rfft(values[:, :length] * window, axis=1)) ** 2, axis=0)
    return np.asarray(2 * power / (rate * np.sum(window**2)))


def _coherence(evidence: Evidence) -> tuple[Array, Array, Array]:
    length = min(2 * (round(SEGMENT * evidence.rate) // 2), evidence.angle.shape[1] // 2 * 2)
    spectra = short_time_spectra(evidence.angle, evidence.torque, length)
    power = spectra.uu * spectra.yy
    coherence = np.abs(spectra.yu) ** 2 / np.where(power > 0, power, np.inf)
    centres = np.arange(len(coherence)) + length // 2 - evidence.ensemble.context
    inside = (centres >= 0) & (centres < evidence.ensemble.samples)
    frequency = np.asarray(np.fft.rfftfreq(length, 1 / evidence.rate), dtype=np.float64)
    return coherence[inside], centres[inside] / evidence.rate, frequency


def _correlation(evidence: Evidence) -> tuple[Array, Array, float]:
    """Correlation of what is left of the torque with angle and speed, all whitened, each lag over the same samples."""
    residual, first = evidence.white_residual, evidence.fit.first + evidence.whitening
    speed = np.abs(np.gradient(evidence.angle, axis=1))
    causes = []
    for signal in (evidence.angle, speed - speed.mean(axis=0)):
        order = min(max(2, round(WHITENING * evidence.rate)), first)
        values = innovations(signal, order)[:, first - order :]
        causes.append(values[:, : residual.shape[1]])
    reach = min(round(FARTHEST * evidence.rate), residual.shape[1] // 3)
    lags = np.arange(-reach, reach + 1)
    inner = slice(reach, residual.shape[1] - reach)
    correlation = np.zeros((2, len(lags)))
    for row, cause in zip(correlation, causes, strict=True):
        scale = np.sqrt(np.mean(cause**2) * np.mean(residual**2))
        if scale > 0:
            row[:] = [np.mean(cause[:, inner] * residual[:, reach + lag : inner.stop + lag]) / scale for lag in lags]
    return lags / evidence.rate, correlation, 1.96 / np.sqrt(residual[:, inner].size)
