"""Compute the regressors: filtered angles, and a drive behind delay and muscle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.linalg import toeplitz
from scipy.ndimage import correlate1d

from tvsysid.numerics import Array
from tvsysid.numerics.decimation import TAPS
from tvsysid.numerics.differentiation import derivative_weights
from tvsysid.numerics.stretch import decimated

# Share of the Nyquist frequency over which so few lags give velocity and acceleration to 0.3 %
BAND = 0.6
RECORDED_HALF_WIDTH = 8  # samples to either side of derivatives at the recorded rate
FITTED_BAND = (0.5, 15.0)  # Hz, of the second-order fit to the intrinsic response
NEGLIGIBLE = 40.0  # time constants after which a muscle's response is over
HIGHEST_DIFFERENCE = 8  # order of difference of the angle up to which the response is free
MAX_WINDOW = 256  # samples of a realization whose noise counts as correlated
MAX_FEW = 2  # realizations up to which products of columns are not sums over these first


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
    first, second = np.zeros((2, 2 * step + 1))
    first[::step], second[::step] = (0.5, 0, -0.5), (1, -2, 1)
    impulse = np.eye(1, 2 * lags + 1, lags)[0]
    differences = [np.convolve(impulse, each, "same") for each in (first, second)]
    while len(differences) < min(HIGHEST_DIFFERENCE, 2 * lags):
        differences.append(np.convolve(differences[-2], second, "same"))
    return np.stack([*filters, *differences[2:]])


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
    r"""Return the impulse response of delay and muscle at lags from 0 on, at most ``samples``.

    The muscle is :math:`\omega^2 / (s^2 + 2\zeta\omega s + \omega^2)`. The samples of the whole
    response sum to 1. A reflex's ``shape`` holds log frequency (rad/s), log damping, threshold
    (rad/s) and delay (s).
    """
    (frequency, damping), delay = np.exp(shape[:2]), float(shape[3])
    # Poles of critical damping would be the same. They are taken apart.
    root = max(np.emath.sqrt(damping**2 - 1), 1e-4, key=abs)
    poles = frequency * (np.array([[root], [-root]]) - damping)
    last = int((delay - NEGLIGIBLE / poles.real.max()) * rate)
    late = np.maximum(np.arange(last) / rate - delay, 0.0)
    response = (np.subtract(*np.exp(poles * late)) / root).real
    return np.asarray((response / response.sum())[:samples])


def convolved(values: Array, response: Array) -> Array:
    """Convolve values (…, time) with a response (time,) from lag 0 on."""
    times = values.shape[-1]
    size = next_fast_len(times + len(response), real=True)
    return np.asarray(irfft(rfft(values, size) * rfft(response, size), size)[..., :times])


class Columns(NamedTuple):
    """Columns of a regression: signals times functions of time, perhaps behind a muscle.

    The ``signals`` have shape (signal, realization, history + time), the ``functions`` (history +
    time, function). The ``muscle`` is the matrix (time, history + time) of its impulse response.
    There are several signals, or several functions.
    """

    signals: Array
    functions: Array
    muscle: Array | None = None

    @classmethod
    def explicit(cls, values: Array) -> Columns:
        """Return columns from their values (column, realization, time)."""
        return cls(values, np.ones((values.shape[-1], 1)))

    @classmethod
    def behind(cls, response: Array, signal: Array, functions: Array, times: int) -> Columns:
        """Return a signal (realization, history + time) times functions, behind a response.

        The values of few columns, or of few realizations, are computed.
        """
        if functions.shape[1] == 1 or len(signal) <= MAX_FEW:
            values = convolved(signal * functions.T[:, None], response)
            return cls.explicit(values[..., -times:])
        history, longest = len(functions) - times, min(times, MAX_WINDOW)
        response = np.pad(response, (0, history + longest))
        later = response[history : history + longest]
        matrix = toeplitz(later, np.pad(response[history::-1], (0, longest - 1)))
        return cls(signal[None], functions, matrix)

    def within(self, rows: slice, window: slice) -> Columns:
        """Return the columns of some realizations in a window of time."""
        signals, functions, muscle = self
        if muscle is not None:
            size = window.stop - window.start
            late = muscle.shape[1] - muscle.shape[0]
            muscle, window = muscle[:size, : size + late], slice(window.start, window.stop + late)
        return Columns(signals[:, rows, window], functions[window], muscle)

    @property
    def are_explicit(self) -> bool:
        """Return whether the columns are the signals."""
        return len(self.functions.T) == 1

    def times(self, weighted: Array) -> Array:
        """Return products of these with weighted columns (column, realization, time)."""
        if self.are_explicit:
            return np.asarray(np.tensordot(self.signals, weighted, ((1, 2), (1, 2))))
        weighted = weighted if self.muscle is None else weighted @ self.muscle
        return np.asarray(self.functions.T @ np.einsum("rt,krt->tk", self.signals[0], weighted))

    def summed(self, other: Columns, weights: Array) -> Array:
        """Return weighted products with others. Many realizations are summed first."""
        weights = weights if self.muscle is None else self.muscle.T @ weights
        weights = weights if other.muscle is None else weights @ other.muscle
        sums = self.signals[0].T @ other.signals[0] * weights
        return np.asarray(self.functions.T @ sums @ other.functions)


Windows = Sequence[tuple[slice, Array]]  # stretches of time, and the weights of their samples


def extended(
    known: Array,
    columns: Sequence[Columns],
    further: Columns,
    windows: Windows,
    rows: slice = slice(None),
) -> Array:
    """Return weighted products of columns and further ones. Those of the first are ``known``."""
    sums = np.zeros(())
    for window, weights in windows:
        every = [each.within(rows, window) for each in (*columns, further)]
        last = every[-1]
        if last.are_explicit:
            weighted = last.signals @ weights
            parts = [each.times(weighted) for each in every]
        else:
            parts = [
                last.times(each.signals @ weights).T
                if each.are_explicit
                else each.summed(last, weights)
                for each in every
            ]
        sums = sums + np.concatenate(parts)
    return np.block([[known, sums[: len(known)]], [sums.T]])


def products(columns: Sequence[Columns], windows: Windows, rows: slice = slice(None)) -> Array:
    """Return weighted products of all columns."""
    out = np.zeros((0, 0))
    for place, further in enumerate(columns):
        out = extended(out, columns[:place], further, windows, rows)
    return out
