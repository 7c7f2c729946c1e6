"""Compute the regressors: lagged angles, and a rectified velocity behind delay and muscle."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache
from itertools import pairwise
from typing import Self

import attrs
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.linalg import toeplitz
from scipy.ndimage import correlate1d

from tvsysid.methods.cascade.shape import Shape
from tvsysid.numerics import Array
from tvsysid.numerics.bases import FourierSeries
from tvsysid.numerics.decimation import TAPS
from tvsysid.numerics.differentiation import derivative_weights
from tvsysid.numerics.moments import row_blocks
from tvsysid.numerics.stretch import decimated

# share of the Nyquist frequency over which so few lags give velocity and acceleration to 0.3 %
BAND = 0.6
HALF_WIDTH = (
    8  # samples to either side from which velocity and acceleration follow at the recorded rate
)
FITTED = (0.5, 15.0)  # Hz, over which viscosity and inertia are those of the intrinsic response
FOLDS = 3  # of realizations, taken in turn, each predicted from the others
WINDOW = 256  # samples of a realization whose noise counts as correlated, at most
HIGHEST = 8  # order of difference of the angle up to which the intrinsic response is free


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
    for order in range(3, HIGHEST + 1):
        taps = odd if order % 2 else np.ones(1)
        for _ in range(order // 2):
            taps = np.convolve(taps, second)
        if len(taps) <= len(offsets):
            rows.append(np.pad(taps, (len(offsets) - len(taps)) // 2))
    return np.stack(rows)


def second_order_fit(lags: Array) -> Array:
    """Return weights (quantity, lag) that turn a response into stiffness, viscosity and inertia.

    The lags are in s. The weights are a least-squares fit to the frequency response from 0.5 to
    15 Hz.
    """
    omega = 2 * np.pi * np.linspace(*FITTED, 60)
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
    total = np.where(known, values, 0.0).sum(axis=axis, keepdims=True)
    return np.asarray(
        np.where(known, values - total / np.maximum(known.sum(axis=axis, keepdims=True), 1), 0.0)
    )


@attrs.frozen(eq=False)
class Data:
    """Torque and intrinsic ``signals``, as deviations from their mean over realizations.

    The ``torque`` has shape (realization, time). ``rows`` and ``times`` of an ensemble are
    fitted. ``bases`` are the functions of time (time, function) by which each signal's
    coefficient changes, at all times. ``noise`` is the autocorrelation of the noise, and
    ``windows`` are stretches of time with the inverse of its matrix. ``own``
    (fold, column, column) are the products of the intrinsic columns and the torque, which is
    last, by ``folds`` of realizations.
    """

    torque: Array
    signals: Array
    bases: tuple[Array, ...]
    rows: NDArray[np.int64]
    times: slice
    folds: list[NDArray[np.int64]]
    noise: Array
    windows: list[tuple[slice, Array]]
    own: Array

    @classmethod
    def of(
        cls, torque: Array, signals: Array, bases: tuple[Array, ...], fitted: NDArray[np.bool_]
    ) -> Self:
        """Return the data of a torque (realization, time) and of signals, where ``fitted``.

        ``signals`` have shape (signal, realization, time), and ``fitted`` has that of the torque.
        The data keep the times that are fitted in half as many realizations as at the best time.
        They keep the realizations that are fitted at all of these times.
        """
        often = fitted.sum(axis=0)
        inside = np.flatnonzero(2 * often >= often.max())
        times = slice(int(inside[0]), int(inside[-1]) + 1)
        rows = np.flatnonzero(fitted[:, times].all(axis=1))
        folds = [np.arange(first, len(rows), FOLDS) for first in range(min(FOLDS, len(rows)))]
        torque, signals = deviations(torque[rows, times]), deviations(signals[:, rows, times])
        empty = np.zeros(())
        return cls(torque, signals, bases, rows, times, folds, empty, [], empty).weighed(np.ones(1))

    @property
    def number(self) -> float:
        """Return the number of samples that are independent of the means."""
        rows, times = self.torque.shape
        return float((rows - 1) * times if rows > 1 else times - len(self.windows))

    @property
    def varies(self) -> bool:
        """Return whether any coefficient changes over time."""
        return any(functions.shape[1] > 1 for functions in self.bases)

    @property
    def functions(self) -> list[Array]:
        """Return the functions of time of each signal and of the torque, at the fitted times."""
        return [*(each[self.times] for each in self.bases), np.ones((self.torque.shape[1], 1))]

    def constant(self) -> Self:
        """Return the data with constant coefficients."""
        first = np.cumsum([0, *(functions.shape[1] for functions in self.bases)])
        bases = tuple(functions[:, :1] for functions in self.bases)
        return attrs.evolve(self, bases=bases, own=self.own[:, first[:, None], first])

    def weighed(self, noise: Array, true: Array | None = None) -> Self:
        """Return the data weighted by the inverse of the noise's autocorrelation.

        The autocorrelation begins at lag 0, and holds within a realization or a window of it. If
        the ``true`` autocorrelation is another one, the products are those of the sandwich
        covariance of the coefficients.
        """
        rows, times = self.torque.shape
        edges = np.linspace(0, times, -(-times // WINDOW) + 1).astype(int)
        inverses = {}
        for size in map(int, set(np.diff(edges))):
            inverse = np.asarray(np.linalg.inv(_matrix(noise, size)), dtype=np.float64)
            if rows == 1:  # its mean is not known
                weight = inverse.sum(axis=0)
                inverse -= np.outer(weight, weight) / weight.sum()
            inverses[size] = inverse if true is None else inverse @ _matrix(true, size) @ inverse
        windows = [(slice(start, stop), inverses[stop - start]) for start, stop in pairwise(edges)]
        data = attrs.evolve(self, noise=noise, windows=windows)
        return attrs.evolve(data, own=np.stack([data.products(fold) for fold in self.folds]))

    def are_few(self, columns: int) -> bool:
        """Return whether products of this number of columns are faster from the columns."""
        return columns * len(self.torque) < 3 * len(self.windows[0][1])

    def products(self, rows: NDArray[np.int64]) -> Array:
        """Return weighted products of the intrinsic columns and the torque of some realizations."""
        functions, signals = self.functions, (*self.signals[:, rows], self.torque[rows])
        ends = np.cumsum([0, *(each.shape[1] for each in functions)])
        if self.are_few(ends[-1]):
            columns = np.concatenate(
                [x * a.T[:, None] for a, x in zip(functions, signals, strict=True)]
            )
            return np.tensordot(columns, self.whitened(columns), axes=((1, 2), (1, 2)))
        out = np.zeros((ends[-1], ends[-1]))
        for inside, inverse in self.windows:
            for i, a in enumerate(functions):
                for j, b in enumerate(functions[: i + 1]):
                    weighted = signals[i][:, inside].T @ signals[j][:, inside] * inverse
                    out[ends[i] : ends[i + 1], ends[j] : ends[j + 1]] += (
                        a[inside].T @ weighted @ b[inside]
                    )
        return np.tril(out) + np.tril(out, -1).T

    def whitened(self, values: Array) -> Array:
        """Multiply values (…, time) by the inverse covariance of the noise."""
        parts = [np.tensordot(values[..., inside], inverse, 1) for inside, inverse in self.windows]
        return np.concatenate(parts, axis=-1)

    def features(self, weights: Array) -> list[Array]:
        """Return matrices (time, column) that give weighted sums of the signals' coefficients.

        ``weights`` have shape (sum, signal). There is one matrix for each sum.
        """
        return [
            np.concatenate([a * w for a, w in zip(self.bases, row, strict=True)], axis=1)
            for row in weights
        ]

    def cross(self, white: Array, rows: slice | NDArray[np.int64] = slice(None)) -> Array:
        """Return products (column, signal) of intrinsic columns and torque with whitened signals.

        Only the realizations ``rows`` are summed.
        """
        every = (*self.signals[:, rows], self.torque[rows])
        parts = [
            np.einsum("rt,krt->kt", x, white) @ a
            for a, x in zip(self.functions, every, strict=True)
        ]
        return np.concatenate(parts, axis=1).T

    def torque_of(self, coefficients: Array) -> Array:
        """Return the intrinsic torque (realization, time), as a deviation from its mean."""
        out, at = np.zeros_like(self.torque), 0
        for functions, signal in zip(self.functions, self.signals, strict=False):
            out += (functions @ coefficients[at : at + functions.shape[1]]) * signal
            at += functions.shape[1]
        return deviations(out) if len(out) == 1 else out


def _matrix(correlation: Array, times: int) -> Array:
    return np.asarray(toeplitz(np.pad(correlation, (0, times))[:times]))


@attrs.frozen(eq=False)
class Reflex:
    """Columns of the reflex pathway: its drive times functions of time, behind delay and muscle.

    ``drive`` gives the rows (realization, history + time) for a threshold, as deviations from
    their mean over realizations. They are 0 where nothing was recorded. ``basis`` is that of the
    gain over a ``period`` in s.
    """

    drive: Callable[[float], Array]
    basis: FourierSeries
    period: float
    rate: float
    data: Data

    def functions(self, shape: Shape) -> Array:
        """Return the functions (history + time, function) of the gain at the times of arrival."""
        stop, total = self.data.times.stop, self.drive(shape.threshold).shape[1]
        return _functions(self.basis, stop - total, stop, self.rate, shape.delay, self.period)

    def windows(self, shape: Shape) -> Iterator[tuple[slice, slice, Array, Array, Array]]:
        """Yield each window of time, with its drive, its matrices and its functions of time.

        Each item holds the window of time, the window of the muscle's drive, the inverse matrix
        of the noise, the matrix of the muscle, and the functions (time, function) of the gain.
        """
        times, functions = self.data.torque.shape[1], self.functions(shape)
        history, longest = len(functions) - times, min(times, WINDOW)
        response = shape.response(history + longest, self.rate)
        matrix = toeplitz(response[history:], np.pad(response[history::-1], (0, longest - 1)))
        for inside, inverse in self.data.windows:
            driven = slice(inside.start, inside.stop + history)
            yield (
                inside,
                driven,
                inverse,
                matrix[: len(inverse), : len(inverse) + history],
                functions[driven],
            )

    def moments(self, shape: Shape, fold: int | None) -> tuple[Array, Array]:
        """Return weighted products of the columns with each other, and with all other columns.

        The other columns are the intrinsic ones and the torque.
        """
        data = self.data
        rows = slice(None) if fold is None else data.folds[fold]
        if data.are_few(2 * self.basis.harmonics + 1):
            columns = self.columns(shape)[:, rows]
            white = data.whitened(columns)
            return np.tensordot(columns, white, axes=((1, 2), (1, 2))), data.cross(white, rows)
        drive, own, cross = self.drive(shape.threshold)[rows], np.zeros(()), np.zeros(())
        every = [*zip(data.functions, (*data.signals[:, rows], data.torque[rows]), strict=True)]
        for inside, driven, inverse, muscle, gain in self.windows(shape):
            part, later = drive[:, driven], inverse @ muscle
            own = own + gain.T @ (muscle.T @ later * (part.T @ part)) @ gain
            cross = (
                cross
                + np.concatenate([a[inside].T @ (x[:, inside].T @ part * later) for a, x in every])
                @ gain
            )
        return own, cross

    def with_signals(self, shape: Shape, weighted: Array) -> Array:
        """Return products (signal, function) of the columns with weighted signals.

        ``weighted`` has shape (signal, realization, time).
        """
        rows, out = self.drive(shape.threshold), np.zeros(())
        for inside, driven, _, muscle, gain in self.windows(shape):
            out = (
                out
                + np.einsum("rs,krs->ks", rows[:, driven], weighted[..., inside] @ muscle) @ gain
            )
        return out

    def columns(self, shape: Shape, mixture: Array | None = None) -> Array:
        """Return the regressors (function, realization, time) as deviations from their mean.

        A ``mixture`` (function, sum) gives weighted sums of them instead.
        """
        functions, times = self.functions(shape), self.data.torque.shape[1]
        history = len(functions) - times
        gain = functions if mixture is None else functions @ mixture
        driven = self.drive(shape.threshold) * gain.T[:, None]
        columns = shape.delayed(driven, self.rate)[..., history:]
        return deviations(columns) if driven.shape[1] == 1 else columns

    def torque(self, shape: Shape, coefficients: Array) -> Array:
        """Return the reflex torque (realization, time): the columns times their coefficients."""
        return np.asarray(self.columns(shape, coefficients[:, None])[0])


@lru_cache(maxsize=2)  # of the gain that changes, and of the one that does not
def _functions(
    basis: FourierSeries, start: int, stop: int, rate: float, delay: float, period: float
) -> Array:
    return basis((np.arange(start, stop) / rate + delay) / period)


def lagged_signals(
    angle: Array, context: int, lags: int, rate: float
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the intrinsic signals of angles with context, and at which times they are known.

    The signals have shape (signal, realization, time). They are known where their lags lie within
    the context.
    """
    missing = max(0, lags - context)
    angle = np.pad(angle, ((0, 0), (missing, missing)))
    first = max(0, context - lags)
    windows = sliding_window_view(angle[:, first : angle.shape[1] - first], 2 * lags + 1, axis=1)
    filters = intrinsic_filters(lags, rate)[:, ::-1]
    signals = np.moveaxis(np.tensordot(windows, filters, axes=(2, 1)), 2, 0)
    known = np.zeros(signals.shape[2], dtype=bool)
    known[missing : len(known) - missing] = True
    return np.ascontiguousarray(signals), known


def unresolved(recorded: Array, lags: int, rate: float) -> Array:
    """Return velocity and acceleration that the lags of the decimated angle miss.

    Their shape is (2, realization, time). They are derivatives of the angle as ``recorded``
    (realization, time, sample), decimated as the torque was. With them, the model follows the
    torque of fast movements that decimation aliases to a slower one. They are zero where a filter
    reaches beyond the samples.
    """
    samples = recorded.shape[-1]
    out = np.zeros((2, *recorded.shape[:2]))
    reach = max(lags, -(-(HALF_WIDTH + TAPS // 2) // samples))
    inside = slice(reach, recorded.shape[1] - reach)
    if samples == 1 or inside.stop <= inside.start:
        return out
    few = intrinsic_filters(lags, rate)[:, ::-1]
    many = derivative_weights(HALF_WIDTH, BAND)[:, ::-1]
    for some in row_blocks(len(recorded), recorded.shape[1] * samples):
        angle = recorded[some].reshape(-1, recorded.shape[1] * samples)
        slow = decimated(angle, samples)
        for order in (1, 2):
            fast = decimated(correlate1d(angle, many[order] * (rate * samples) ** order), samples)
            out[order - 1, some, inside] = (fast - correlate1d(slow, few[order]))[:, inside]
    return out
