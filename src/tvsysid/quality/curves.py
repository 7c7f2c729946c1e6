"""Compute what the figures of a diagnosis show; arrays only."""

from __future__ import annotations

import math

import attrs
import numpy as np
from scipy.fft import rfft, rfftfreq

from tvsysid.numerics.spectra import hann, short_time_spectra
from tvsysid.quality.fit import FittedEnsemble
from tvsysid.quality.statistics import TINY, lagged
from tvsysid.signals import Array

COHERENCE_S, SPECTRUM_S = 0.64, 2.0  # lengths of segments
MAX_LAG_S = 0.3


@attrs.frozen(eq=False)
class Curves:
    """Spectra, coherence, stiffness and correlations of an ensemble.

    Parameters
    ----------
    frequency
        In Hz, shape (frequency,).
    angle_power, torque_power, residual_power
        Power densities of the deviations from the mean over realizations, in rad²/Hz and (N·m)²/Hz,
        shape (frequency,).
    coherence
        Of torque and angle, shape (coherence time, coherence frequency). By chance it is one over
        the number of realizations.
    coherence_time, coherence_frequency
        In s and Hz.
    time
        Within a realization in s, shape (time,).
    stiffness_halves
        Of the first and the second half of the experiment in N·m/rad, shape (2, time).
    stiffness, noise
        Of each realization over the median, in the order of recording, shape (realization,).
    lag
        In s, positive where the torque is later, shape (lag,).
    correlation
        Of the residual torque with angle and with speed, all whitened, shape (2, lag).
    chance
        Size below which 95 % of the correlations of unrelated signals are.
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
    chance: float


def curves(data: FittedEnsemble) -> Curves:
    """Return what the figures show."""
    fit, rate, ensemble = data.fit, data.rate, data.ensemble
    length = min(fit.torque.shape[1], round(SPECTRUM_S * rate))
    signals = np.stack([fit.motion[0], fit.torque, fit.residual])[..., :length]
    squares = np.mean(np.abs(rfft(signals * hann(length))) ** 2, axis=1)
    angle, torque, residual = 2 * squares / (rate * np.sum(hann(length) ** 2))
    half = min(round(COHERENCE_S * rate), data.angle.shape[1]) // 2
    spectra = short_time_spectra(data.angle, data.torque, 2 * half)
    coherence = np.abs(spectra.yu) ** 2 / np.maximum(spectra.uu * spectra.yy, TINY)
    time = (np.arange(len(coherence)) + half - ensemble.context) / rate
    inside = (time >= 0) & (time < ensemble.duration)
    return Curves(
        rfftfreq(length, 1 / rate),
        angle,
        torque,
        residual,
        coherence[inside],
        time[inside],
        rfftfreq(2 * half, 1 / rate),
        (np.arange(data.region.start, data.region.stop) - ensemble.context) / rate,
        np.stack([fit.of(each).impedance[0] for each in data.halves]),
        fit.relative_stiffness[data.order],
        fit.relative_noise[data.order],
        *_correlation(data),
    )


def _correlation(data: FittedEnsemble) -> tuple[Array, Array, float]:
    """Return lags, correlations of the residual with angle and speed, and the chance level.

    All lags use the same samples.
    """
    residual = data.fit.white_residual
    speed = np.abs(np.gradient(data.angle, axis=1))
    causes = np.stack([data.unpredicted(each) for each in (data.angle, speed - speed.mean(axis=0))])
    reach = min(round(MAX_LAG_S * data.rate), residual.shape[1] // 3)
    lags = np.arange(-reach, reach + 1)
    used = causes[..., reach:-reach]
    moved = lagged(residual, -lags, reach, residual.shape[1] - reach)
    products = np.einsum("crt,lrt->lc", used, moved) / used[0].size
    scale = np.sqrt(np.mean(causes**2, axis=(1, 2)) * np.mean(residual**2))
    correlation = products / np.maximum(scale, TINY)
    return lags / data.rate, correlation.T, 1.96 / math.sqrt(used[0].size)
