"""What the pictures of a diagnosis show; arrays only."""

from __future__ import annotations

import attrs
import numpy as np

from tvsysid.numerics.spectra import hann, short_time_spectra
from tvsysid.quality.fitted import FittedEnsemble
from tvsysid.signals import Array

SEGMENT, WELCH = (
    0.64,
    2.0,
)  # length in s of the segments whose coherence is shown, and of those whose spectrum is
FARTHEST = 0.3  # lags in s that are shown, to either side


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
        Of torque and angle, shape (coherence time, coherence frequency); chance leaves one over the
        realizations.
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
        Of the torque that the model leaves with angle and with speed, each whitened, shape (2,
        lag).
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

    def __attrs_post_init__(self) -> None:
        for field in attrs.fields(type(self)):
            getattr(self, field.name).flags.writeable = False


def curves(data: FittedEnsemble) -> Curves:
    """All that the pictures show."""
    rate, fit = data.rate, data.fit
    length = min(fit.torque.shape[1], round(WELCH * rate))
    angle, torque, residual = (
        _power(values, length, rate) for values in (fit.motion[0], fit.torque, fit.residual)
    )
    return Curves(
        np.asarray(np.fft.rfftfreq(length, 1 / rate), dtype=np.float64),
        angle,
        torque,
        residual,
        *_coherence(data),
        (fit.first - data.ensemble.context + np.arange(fit.torque.shape[1])) / rate,
        np.stack([fit.of(half).impedance[0] for half in data.half_orders]),
        data.relative_stiffness[data.order],
        data.relative_noise[data.order],
        *_correlation(data),
    )


def _power(values: Array, length: int, rate: float) -> Array:
    """One-sided power density of the first samples of each realization, averaged."""
    window = hann(length)
    power = np.mean(np.abs(np.fft.rfft(values[:, :length] * window, axis=1)) ** 2, axis=0)
    return np.asarray(2 * power / (rate * np.sum(window**2)))


def _coherence(data: FittedEnsemble) -> tuple[Array, Array, Array]:
    """Coherence, with its times and frequencies."""
    length = min(2 * (round(SEGMENT * data.rate) // 2), data.angle.shape[1] // 2 * 2)
    spectra = short_time_spectra(data.angle, data.torque, length)
    power = spectra.uu * spectra.yy
    coherence = np.abs(spectra.yu) ** 2 / np.where(power > 0, power, np.inf)
    centres = np.arange(len(coherence)) + length // 2 - data.ensemble.context
    inside = (centres >= 0) & (centres < data.ensemble.samples)
    frequency = np.asarray(np.fft.rfftfreq(length, 1 / data.rate), dtype=np.float64)
    return coherence[inside], centres[inside] / data.rate, frequency


def _correlation(data: FittedEnsemble) -> tuple[Array, Array, Array]:
    """Return lags, correlations of the residual with angle and speed, and the chance level.

    All signals are whitened. Each lag uses the same samples.
    """
    residual, speed = data.white_residual, np.abs(np.gradient(data.angle, axis=1))
    reach = min(round(FARTHEST * data.rate), residual.shape[1] // 3)
    lags = np.arange(-reach, reach + 1)
    inner = slice(reach, residual.shape[1] - reach)
    correlation = np.zeros((2, len(lags)))
    for row, signal in zip(correlation, (data.angle, speed - speed.mean(axis=0)), strict=True):
        cause = data.unpredicted(signal)
        scale = np.sqrt(np.mean(cause**2) * np.mean(residual**2))
        if scale > 0:
            row[:] = [
                np.mean(cause[:, inner] * residual[:, reach + lag : inner.stop + lag]) / scale
                for lag in lags
            ]
    return lags / data.rate, correlation, np.asarray(1.96 / np.sqrt(residual[:, inner].size))
