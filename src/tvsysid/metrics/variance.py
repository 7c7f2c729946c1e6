"""Variance accounted for: how much of the torque a model predicts."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from tvsysid.errors import InputError
from tvsysid.numerics import Array


def _pair(torque: ArrayLike, predicted: ArrayLike) -> tuple[Array, Array]:
    measured, model = np.asarray(torque, dtype=np.float64), np.asarray(predicted, dtype=np.float64)
    if measured.ndim != 2 or measured.shape != model.shape or measured.size == 0:
        raise InputError(
            "torque and predicted: expected two arrays of axes (realization, time) of the same "
            "shape, "
            f"got {measured.shape} and {model.shape}"
        )
    return measured, model


def _accounted(torque: Array, predicted: Array, axis: int) -> Array:
    known = np.isfinite(torque) & np.isfinite(predicted)
    power = np.sum(np.square(torque, where=known, out=np.zeros_like(torque)), axis=axis)
    error = np.zeros_like(torque)
    np.subtract(torque, predicted, out=error, where=known)
    residual = np.sum(error * error, axis=axis)
    share = np.full(power.shape, np.nan)
    np.divide(residual, power, out=share, where=power > 0)
    return np.asarray(np.maximum(100.0 * (1.0 - share), 0.0))


def vaf(torque: ArrayLike, predicted: ArrayLike) -> Array:
    r"""Variance accounted for in each realization.

    .. math:: \max\left(0, 1 - \frac{\sum_i (y_r(i) - \hat y_r(i))^2}{\sum_i y_r(i)^2}\right) \cdot 100\,\%

    Equation 25 of van de Ruit et al. 2021. The sums are not centred: subtract the mean over
    realizations before.

    Measured (or noiseless simulated) and predicted torque have the shape (realization, time);
    samples where the latter is NaN are left out. In per cent, shape (realization,); NaN where no
    sample is left, or the torque is zero.

    Examples
    --------
    >>> vaf([[1.0, 2.0, 2.0]], [[1.0, 2.0, 1.0]])
    array([88.88888889])
    """
    return _accounted(*_pair(torque, predicted), axis=1)


def time_varying_vaf(torque: ArrayLike, predicted: ArrayLike) -> Array:
    r"""Variance accounted for at each time, across realizations.

    .. math:: \max\left(0, 1 - \frac{\sum_r (y_r(i) - \hat y_r(i))^2}{\sum_r y_r(i)^2}\right) \cdot 100\,\%

    Equation 26 of van de Ruit et al. 2021; in per cent (time,), NaN where there is no prediction.
    Torques are those of
    :func:`vaf`.
    """
    return _accounted(*_pair(torque, predicted), axis=0)


def bandpassed_vaf(
    torque: ArrayLike,
    predicted: ArrayLike,
    sampling_rate: float,
    band: tuple[float, float] = (1.0, 10.0),
) -> Array:
    """Variance accounted for in each realization, after a band-pass that takes away most of the inertia's part.

    A third-order Butterworth filter is run over both torques forwards and backwards, so that
    nothing is shifted. Ends are continued by even reflection for a cycle of the band's lower edge,
    which comes closest to filtering the whole record: within 0.5 percentage points for a
    realization of 2 s, where odd reflection is off by 4.

    Torques are those of :func:`vaf`, rate and band in Hz; times at which any realization has no
    prediction are left out. In per cent, shape (realization,); NaN where no more than 18 samples
    are left to filter.
    """
    measured, model = _pair(torque, predicted)
    if not 0 < band[0] < band[1] < sampling_rate / 2:
        raise InputError(
            f"bandpassed_vaf: expected a band that rises within 0 to {sampling_rate / 2:g} Hz, "
            f"got {band!r}"
        )
    known = np.asarray(np.isfinite(measured).all(axis=0) & np.isfinite(model).all(axis=0))
    count = int(np.count_nonzero(known))
    if count <= SHORTEST_FILTERED:
        return np.full(len(measured), np.nan)
    signals = (measured, model) if count == len(known) else (measured[:, known], model[:, known])
    if count <= LONGEST_MATRIX:
        matrix = _bandpass_matrix(count, sampling_rate, tuple(band))
        return vaf(*(torques @ matrix for torques in signals))
    return vaf(*(_run_both_ways(torques, sampling_rate, band) for torques in signals))


SHORTEST_FILTERED = 18  # samples that are too few to filter
LONGEST_MATRIX = (
    512  # samples up to which the filter is applied as a matrix product, several times faster
)


@lru_cache(maxsize=16)
def _bandpass_matrix(count: int, sampling_rate: float, band: tuple[float, float]) -> Array:
    """The filter, which is linear, of every unit impulse."""
    return _run_both_ways(np.eye(count), sampling_rate, band)


def _run_both_ways(signals: Array, sampling_rate: float, band: tuple[float, float]) -> Array:
    from scipy.signal import butter, sosfiltfilt  # noqa: PLC0415  # heavy

    sections = butter(3, band, btype="bandpass", fs=sampling_rate, output="sos")
    reflected = min(signals.shape[1] - 1, round(sampling_rate / band[0]))
    return np.asarray(sosfiltfilt(sections, signals, axis=1, padtype="even", padlen=reflected))
