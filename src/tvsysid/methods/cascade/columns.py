"""Compute the regressors: lagged angles, and a rectified velocity behind delay and muscle."""

from __future__ import annotations

from functools import reduce

import numpy as np
from scipy.ndimage import correlate1d

from tvsysid.numerics import Array
from tvsysid.numerics.decimation import TAPS
from tvsysid.numerics.differentiation import derivative_weights
from tvsysid.numerics.stretch import decimated

# share of the Nyquist frequency over which so few lags give velocity and acceleration to 0.3 %
BAND = 0.6
RECORDED_HALF_WIDTH = 8  # samples to either side of derivatives at the recorded rate
FITTED_BAND = (0.5, 15.0)  # Hz, of the second-order fit to the intrinsic response
HIGHEST_DIFFERENCE = 8  # order of difference of the angle up to which the response is free


def intrinsic_filters(lags: int, rate: float) -> Array:
    """Return filters (signal, lag) that give the angle, its derivatives and its differences.

    The derivatives are velocity and acceleration; the differences begin with order 3. Only the
    first filter passes a constant angle, so that the sum of a response is the first coefficient.
    The velocity of a ramp and the acceleration of a parabola are exact.
    """
    offsets = np.arange(-lags, lags + 1)
    filters = derivative_weights(lags, BAND).copy()
    filters[1] *= -rate / (filters[1] @ offsets)
    filters[2] *= 2 * rate**2 / (filters[2] @ offsets**2)
    step = max(1, lags // 4)
    second, odd = np.zeros(2 * step + 1), np.zeros(2 * step + 1)
    second[::step], odd[::step] = (1, -2, 1), (0.5, 0, -0.5)
    rows = list(filters)
    for order in range(3, HIGHEST_DIFFERENCE + 1):
        taps = reduce(np.convolve, [second] * (order // 2), odd if order % 2 else np.ones(1))
        if len(taps) <= len(offsets):
            rows.append(np.pad(taps, (len(offsets) - len(taps)) // 2))
    return np.stack(rows)


def second_order_fit(lags: Array) -> Array:
    """Return weights (quantity, lag) that turn a response into stiffness, viscosity and inertia.

    The lags are in s. The weights are a least-squares fit to the frequency response from 0.5 to
    15 Hz.
    """
    omega = 2 * np.pi * np.linspace(*FITTED_BAND, 60)
    phase = np.outer(omega, lags)
    real = np.linalg.pinv(np.stack([np.ones_like(omega), -(omega**2)], axis=1)) @ np.cos(phase)
    return np.stack([real[0], -(omega @ np.sin(phase)) / (omega @ omega), real[1]])


def readout(lags: int, rate: float) -> Array:
    """Return weights (quantity, signal) that turn coefficients into stiffness to inertia.

    The coefficients are those of the :func:`intrinsic_filters`; see :func:`second_order_fit`.
    """
    return np.asarray(
        second_order_fit(np.arange(-lags, lags + 1) / rate) @ intrinsic_filters(lags, rate).T
    )


def deviations(values: Array) -> Array:
    """Subtract the mean over realizations from values (…, realization, time).

    A single realization loses its mean over time. NaN becomes 0.
    """
    axis = -1 if values.shape[-2] == 1 else -2
    known = np.isfinite(values)
    count = np.maximum(known.sum(axis, keepdims=True), 1)
    mean = np.sum(values, axis, where=known, keepdims=True) / count
    return np.where(known, values - mean, 0.0)


def intrinsic_signals(angle: Array, lags: int, rate: float) -> Array:
    """Return angle, derivatives and differences (signal, realization, time) of an angle.

    They are wrong where fewer than ``lags`` samples precede or follow.
    """
    filters = intrinsic_filters(lags, rate)[:, ::-1]
    return np.stack([correlate1d(angle, weights) for weights in filters])


def unresolved(recorded: Array, lags: int, rate: float) -> Array:
    """Return velocity and acceleration that the lags of the decimated angle miss.

    Their shape is (2, realization, time). They are derivatives of the angle as ``recorded``
    (realization, time, sample), decimated as the torque was. With them, the model follows the
    torque of fast movements that decimation aliases to a slower one. They are zero where a filter
    reaches beyond the samples.
    """
    ratio = recorded.shape[-1]
    out = np.zeros((2, *recorded.shape[:2]))
    reach = max(lags, -(-(RECORDED_HALF_WIDTH + TAPS // 2) // ratio))
    inside = slice(reach, max(reach, recorded.shape[1] - reach))
    if ratio > 1:
        angle = recorded.reshape(len(recorded), -1)
        slow = intrinsic_signals(decimated(angle, ratio), lags, rate)
        weights = derivative_weights(RECORDED_HALF_WIDTH, BAND)[:, ::-1]
        for order in (1, 2):
            fast = correlate1d(angle, weights[order] * (rate * ratio) ** order)
            out[order - 1, :, inside] = (decimated(fast, ratio) - slow[order])[:, inside]
    return out
