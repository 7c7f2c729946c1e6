"""Compute the columns of the reflex pathway and their products with other columns."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache

import attrs
import numpy as np
from scipy.linalg import toeplitz

from tvsysid.methods.cascade.columns import deviations
from tvsysid.methods.cascade.data import ALL, Data
from tvsysid.methods.cascade.shape import Shape
from tvsysid.numerics import Array
from tvsysid.numerics.bases import FourierSeries


@attrs.frozen(eq=False)
class Reflex:
    """Columns of the reflex pathway: its drive times functions of time, behind delay and muscle.

    ``drive`` gives the rows (realization, history + time) for a threshold, as deviations from
    their mean over realizations. They are 0 where nothing was recorded. ``basis`` is that of the
    gain over a ``period`` in s. The fitted ``times`` are samples of a realization.
    """

    drive: Callable[[float], Array]
    basis: FourierSeries
    period: float
    rate: float
    times: slice

    def _gain(self, shape: Shape) -> Array:
        """Return the functions (history + time, function) of the gain at the times of arrival."""
        stop, total = self.times.stop, self.drive(shape.threshold).shape[1]
        return _arriving(self.basis, stop - total, stop, self.rate, shape.delay, self.period)

    def columns(self, shape: Shape, mixture: Array | None = None) -> Array:
        """Return the regressors (function, realization, time) as deviations from their mean.

        The gain is that at the time of arrival. A ``mixture`` (function, sum) gives weighted sums
        of the regressors instead.
        """
        gain, drive = self._gain(shape), self.drive(shape.threshold)
        driven = drive * (gain if mixture is None else gain @ mixture).T[:, None]
        history = len(gain) - (self.times.stop - self.times.start)
        columns = shape.delayed(driven, self.rate)[..., history:]
        return deviations(columns) if len(drive) == 1 else columns

    def torque(self, shape: Shape, coefficients: Array) -> Array:
        """Return the reflex torque (realization, time): the columns times their coefficients."""
        return np.asarray(self.columns(shape, coefficients[:, None])[0])

    def products(self, shape: Shape, data: Data, rows: slice = ALL) -> tuple[Array, Array]:
        """Return weighted products of the columns with each other, and with all other columns.

        The other columns are the intrinsic ones and the torque. Sums over many realizations come
        first: one matrix (time, time) for each pair of signals serves all functions of time.
        """
        if data.are_few(2 * self.basis.harmonics + 1):
            columns = self.columns(shape)[:, rows]
            white = data.whitened(columns)
            return np.tensordot(columns, white, ((1, 2), (1, 2))), data.cross(white, rows)
        drive, gram, cross = self.drive(shape.threshold)[rows], np.zeros(()), np.zeros(())
        factors = list(data.factors(rows))
        for inside, driven, inverse, muscle, gain in self._windows(shape, data):
            part, later = drive[:, driven], inverse @ muscle
            gram = gram + gain.T @ (muscle.T @ later * (part.T @ part)) @ gain
            mixed = [a[inside].T @ (x[:, inside].T @ part * later) for x, a in factors]
            cross = cross + np.concatenate(mixed) @ gain
        return gram, cross

    def with_signals(self, shape: Shape, data: Data, white: Array) -> Array:
        """Return products (function, signal) of the columns with whitened signals."""
        drive, out = self.drive(shape.threshold), np.zeros(())
        for inside, driven, _, muscle, gain in self._windows(shape, data):
            late = np.einsum("rs,krs->sk", drive[:, driven], white[..., inside] @ muscle)
            out = out + gain.T @ late
        return out

    def _windows(
        self, shape: Shape, data: Data
    ) -> Iterator[tuple[slice, slice, Array, Array, Array]]:
        """Yield each window of time, with its drive, its matrices and its functions of time.

        Each item holds the window of time, the window of the muscle's drive, the inverse matrix
        of the noise, the matrix of the muscle, and the functions (time, function) of the gain.
        """
        gain, times = self._gain(shape), data.torque.shape[1]
        history, longest = len(gain) - times, max(len(inverse) for _, inverse in data.windows)
        response = shape.response(history + longest, self.rate)
        matrix = toeplitz(response[history:], np.pad(response[history::-1], (0, longest - 1)))
        for inside, inverse in data.windows:
            driven = slice(inside.start, inside.stop + history)
            muscle = matrix[: len(inverse), : len(inverse) + history]
            yield inside, driven, inverse, muscle, gain[driven]


@lru_cache(maxsize=2)  # of the gain that changes, and of the one that does not
def _arriving(
    basis: FourierSeries, start: int, stop: int, rate: float, delay: float, period: float
) -> Array:
    return basis((np.arange(start, stop) / rate + delay) / period)
