"""Compute the regressors: lagged angles, and a rectified velocity behind delay and muscle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import reduce

import attrs
import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.ndimage import correlate1d

from tvsysid.numerics import Array
from tvsysid.numerics.decimation import TAPS
from tvsysid.numerics.differentiation import derivative_weights
from tvsysid.numerics.stretch import decimated

# share of the Nyquist frequency over which so few lags give velocity and acceleration to 0.3 %
BAND = 0.6
RECORDED_HALF_WIDTH = 8  # samples to either side of derivatives at the recorded rate
FITTED_BAND = (0.5, 15.0)  # Hz, of the second-order fit to the intrinsic response
NEGLIGIBLE = 40.0  # time constants after which a response is over
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
    joint = np.stack([np.ones_like(omega), 1j * omega, -(omega**2)], axis=1)
    response = np.exp(-1j * np.outer(omega, lags))
    joint, response = (np.concatenate([each.real, each.imag]) for each in (joint, response))
    return np.asarray(np.linalg.pinv(joint) @ response)


def readout(lags: int, rate: float) -> Array:
    """Return weights (quantity, signal) that turn coefficients into stiffness to inertia.

    The coefficients are those of the :func:`intrinsic_filters`; see :func:`second_order_fit`.
    """
    fit = second_order_fit(np.arange(-lags, lags + 1) / rate)
    return np.asarray(fit @ intrinsic_filters(lags, rate).T)


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
    if ratio > 1:
        angle = recorded.reshape(len(recorded), -1)
        slow = intrinsic_signals(decimated(angle, ratio), lags, rate)[1:3]
        weights = derivative_weights(RECORDED_HALF_WIDTH, BAND)[1:, ::-1]
        weights = weights * (rate * ratio) ** np.array([[1], [2]])
        fast = np.stack([decimated(correlate1d(angle, each), ratio) for each in weights])
        reach = max(lags, -(-(RECORDED_HALF_WIDTH + TAPS // 2) // ratio))
        out[..., reach:-reach] = (fast - slow)[..., reach:-reach]
    return out


def muscle(shape: Array, samples: int, rate: float) -> Array:
    r"""Return the impulse response of delay and muscle at lags from 0 on. Its samples sum to 1.

    It ends after so many ``samples``, or where it is over.

    The muscle is :math:`\omega^2 / (s^2 + 2\zeta\omega s + \omega^2)`. A reflex's ``shape`` holds
    log frequency (rad/s), log damping, threshold (rad/s) and delay (s).
    """
    (frequency, damping), delay = np.exp(shape[:2]), float(shape[3]) * rate
    # Poles of critical damping would be the same. They are taken apart.
    root = max(np.emath.sqrt(damping**2 - 1), 1e-4, key=abs)
    poles = frequency / rate * (np.array([[root], [-root]]) - damping)
    first = math.floor(delay + 1e-9)
    last = first + int(NEGLIGIBLE / -poles.real.max())
    rest, lags = max(0.0, delay - first), np.arange(min(samples, last)) - first
    waves = np.where(lags > 0, np.exp(poles * np.maximum(lags - rest, 0.0)), 0.0)
    sums = np.exp(poles * (1 - rest)) / (1 - np.exp(poles))
    return np.asarray(((waves[0] - waves[1]) / (sums[0] - sums[1])).real)


def convolved(values: Array, response: Array) -> Array:
    """Convolve values (…, time) with a response (time,) from lag 0 on."""
    times = values.shape[-1]
    size = next_fast_len(times + len(response), real=True)
    return np.asarray(irfft(rfft(values, size) * rfft(response, size), size)[..., :times])


Windows = Sequence[tuple[slice, Array]]  # stretches of time, and the weights of their samples


@attrs.frozen(eq=False)
class Modulated:
    """Columns that are a signal times functions of time, perhaps behind a muscle.

    The ``signal`` has shape (realization, history + time), the ``functions`` (history + time,
    column). The ``muscle`` is the matrix (time, history + time) of its impulse response. Many
    realizations are summed first: one matrix (time, time) serves all functions.
    """

    signal: Array
    functions: Array
    muscle: Array | None = None

    def __len__(self) -> int:
        return int(self.functions.shape[1])

    def of(self, rows: slice, window: slice = slice(None)) -> Modulated:
        """Return the columns of some realizations in a window of time."""
        muscle, times = self.muscle, window
        if muscle is not None and window.stop is not None:
            samples = window.stop - window.start
            later = samples + muscle.shape[1] - muscle.shape[0]
            muscle, times = muscle[:samples, :later], slice(window.start, window.start + later)
        return Modulated(self.signal[rows, times], self.functions[times], muscle)

    def times(self, weighted: Array, windows: Windows) -> Array:
        """Return products of weighted columns (column, realization, time) with these."""
        out = np.zeros((len(weighted), len(self)))
        for window, _ in windows:
            inside, part = self.of(slice(None), window), weighted[..., window]
            part = part if inside.muscle is None else part @ inside.muscle
            out += np.einsum("krt,rt->kt", part, inside.signal) @ inside.functions
        return out

    def summed(self, other: Modulated, windows: Windows) -> Array:
        """Return weighted products with others."""
        out = np.zeros((len(self), len(other)))
        for window, weights in windows:
            left, right = (each.of(slice(None), window) for each in (self, other))
            weighted = weights if left.muscle is None else left.muscle.T @ weights
            weighted = weighted if right.muscle is None else weighted @ right.muscle
            sums = left.signal.T @ right.signal * weighted
            out += left.functions.T @ sums @ right.functions
        return out


# Columns of the regression: their values (column, realization, time), or a signal times functions
Columns = Array | Modulated


def products(
    parts: Sequence[Columns], windows: Windows, known: Array, rows: slice = slice(None)
) -> Array:
    """Return weighted products of all columns, of which those of the first ones are ``known``."""
    parts = [each.of(rows) if isinstance(each, Modulated) else each[:, rows] for each in parts]
    ends = np.cumsum([0, *map(len, parts)])
    out = np.zeros((ends[-1], ends[-1]))
    out[: len(known), : len(known)] = known
    weighted: dict[int, Array] = {}  # by the number of the part

    def product(place: int, other: int) -> Array:
        left, right = parts[place], parts[other]
        if isinstance(left, Modulated):
            if isinstance(right, Modulated):
                return left.summed(right, windows)
            return product(other, place).T
        if place not in weighted:
            flat = left.reshape(-1, left.shape[-1])
            stretches = [flat[:, window] @ weights for window, weights in windows]
            weighted[place] = np.concatenate(stretches, axis=1).reshape(left.shape)
        if isinstance(right, Modulated):
            return right.times(weighted[place], windows)
        return weighted[place].reshape(len(left), -1) @ right.reshape(len(right), -1).T

    for place in range(int(np.searchsorted(ends, len(known))), len(parts)):
        row = np.concatenate([product(place, other) for other in range(place + 1)], axis=1)
        out[ends[place] : ends[place + 1], : row.shape[1]] = row
    return np.tril(out) + np.tril(out, -1).T
