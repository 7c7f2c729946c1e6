"""Hold the columns of both pathways as factors, and sum their products under coloured noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache, reduce
from itertools import pairwise
from typing import NamedTuple, Self

import attrs
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz

from tvsysid.methods.cascade.columns import deviations
from tvsysid.methods.cascade.shape import Shape
from tvsysid.numerics import Array
from tvsysid.numerics.bases import FourierSeries
from tvsysid.numerics.gaussian import Moments

FOLDS = 3  # interleaved sets of realizations, each predicted from the others
MAX_WINDOW = 256  # samples of a realization whose noise counts as correlated
ALL = slice(None)


class Factor(NamedTuple):
    """Columns of the regression: a signal times functions of time, perhaps behind a muscle.

    The ``signal`` has shape (realization, history + time), the ``functions`` (history + time,
    column). The ``muscle`` is the matrix (time, history + time) of its impulse response.
    """

    signal: Array
    functions: Array
    muscle: Array | None = None

    @classmethod
    def column(cls, values: Array) -> Factor:
        """Return a single column of values (realization, time)."""
        return cls(values, np.ones((values.shape[1], 1)))

    def within(self, window: slice, rows: slice) -> Factor:
        """Return the factor for some realizations and a window of time."""
        times, muscle = window, None
        if self.muscle is not None:
            history = self.muscle.shape[1] - self.muscle.shape[0]
            count = window.stop - window.start
            times = slice(window.start, window.stop + history)
            muscle = self.muscle[:count, : count + history]
        return Factor(self.signal[rows, times], self.functions[times], muscle)

    def products(self, others: Sequence[Factor], weights: Array) -> Array:
        """Return products with the columns of others, weighted by a matrix (time, time).

        Sums over many realizations come first: one matrix (time, time) for each pair of signals
        serves all functions of time. Few columns are multiplied by the weights themselves.
        """
        columns, rows = self.functions.shape[1], len(self.signal)
        are_few = columns * rows < len(others) * (columns + rows)
        if are_few:
            values = self.signal * self.functions.T[:, None]
            left = (values if self.muscle is None else values @ self.muscle.T) @ weights
        else:
            left = weights if self.muscle is None else self.muscle.T @ weights
        parts = []
        for other in others:
            right = left if other.muscle is None else left @ other.muscle
            if are_few:
                sums = np.einsum("krt,rt->kt", right, other.signal)
            else:
                sums = self.functions.T @ (self.signal.T @ other.signal * right)
            parts.append(sums @ other.functions)
        return np.concatenate(parts, axis=1)


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

    def torque(self, shape: Shape, coefficients: Array) -> Array:
        """Return the reflex torque (realization, time) as a deviation from its mean.

        The gain is that at the time of arrival.
        """
        gain = self._gain(shape) @ coefficients
        driven = shape.delayed(self.drive(shape.threshold) * gain, self.rate)
        torque = driven[:, len(gain) - (self.times.stop - self.times.start) :]
        return deviations(torque) if len(torque) == 1 else torque

    def columns(self, shape: Shape) -> Array:
        """Return the columns (function, realization, time)."""
        units = np.eye(2 * self.basis.harmonics + 1)
        return np.stack([self.torque(shape, unit) for unit in units])

    def factor(self, shape: Shape) -> Factor:
        """Return the columns as a signal, functions of time and a muscle."""
        if self.basis.harmonics == 0:  # a constant gain is one column
            return Factor.column(self.torque(shape, np.ones(1)))
        gain = self._gain(shape)
        history = len(gain) - (self.times.stop - self.times.start)
        longest = min(len(gain) - history, MAX_WINDOW)
        response = shape.response(history + longest, self.rate)
        muscle = toeplitz(response[history:], np.pad(response[history::-1], (0, longest - 1)))
        return Factor(self.drive(shape.threshold), gain, muscle)


@lru_cache(maxsize=2)  # of the gain that changes, and of the one that does not
def _arriving(
    basis: FourierSeries, start: int, stop: int, rate: float, delay: float, period: float
) -> Array:
    return basis((np.arange(start, stop) / rate + delay) / period)


@attrs.frozen(eq=False)
class Data:
    """Torque and intrinsic ``signals``, as deviations from their mean over realizations.

    The ``torque`` has shape (realization, time), the signals (signal, realization, time). ``rows``
    and ``times`` of an ensemble are fitted. ``bases`` are the functions of time (time, function)
    by which each signal's coefficient changes, at all times. ``noise`` is the autocorrelation of
    the noise, and ``windows`` are stretches of time with the inverse of its matrix.
    """

    torque: Array
    signals: Array
    bases: tuple[Array, ...]
    rows: NDArray[np.int64]
    times: slice
    noise: Array = attrs.field(factory=lambda: np.ones(1))
    windows: list[tuple[slice, Array]] = attrs.field(factory=list)

    @classmethod
    def of(
        cls, torque: Array, signals: Array, bases: tuple[Array, ...], fitted: NDArray[np.bool_]
    ) -> Self:
        """Return the data of a torque and of signals, where ``fitted`` (realization, time).

        The data keep the times that are fitted in half as many realizations as at the best time.
        They keep the realizations that are fitted at all of these times.
        """
        often = fitted.sum(axis=0)
        inside = np.flatnonzero(2 * often >= often.max())
        times = slice(int(inside[0]), int(inside[-1]) + 1)
        rows = np.flatnonzero(fitted[:, times].all(axis=1))
        torque, signals = deviations(torque[rows, times]), deviations(signals[:, rows, times])
        return cls(torque, signals, bases, rows, times).weighted(np.ones(1))

    @property
    def folds(self) -> list[slice]:
        """Return the realizations of each fold."""
        return [slice(first, None, FOLDS) for first in range(min(FOLDS, len(self.torque)))]

    @property
    def number(self) -> float:
        """Return the number of samples that are independent of the means."""
        rows, times = self.torque.shape
        return float((rows - 1) * times if rows > 1 else times - len(self.windows))

    @property
    def varies(self) -> bool:
        """Return whether any coefficient changes over time."""
        return any(functions.shape[1] > 1 for functions in self.bases)

    def constant(self) -> Self:
        """Return the data with constant coefficients."""
        return attrs.evolve(self, bases=tuple(functions[:, :1] for functions in self.bases))

    def weighted(self, noise: Array, true: Array | None = None) -> Self:
        """Return the data weighted by the inverse of the noise's autocorrelation.

        The autocorrelation begins at lag 0, and holds within a realization or a window of it. If
        the ``true`` autocorrelation is another one, the moments are those of the sandwich
        covariance of the coefficients.
        """
        rows, times = self.torque.shape
        edges = np.linspace(0, times, -(-times // MAX_WINDOW) + 1).astype(int)
        inverses = {}
        for size in map(int, set(np.diff(edges))):
            inverse = np.asarray(np.linalg.inv(_matrix(noise, size)), dtype=np.float64)
            if rows == 1:  # its mean is not known
                weight = inverse.sum(axis=0)
                inverse -= np.outer(weight, weight) / weight.sum()
            inverses[size] = inverse if true is None else inverse @ _matrix(true, size) @ inverse
        windows = [(slice(start, stop), inverses[stop - start]) for start, stop in pairwise(edges)]
        return attrs.evolve(self, noise=noise, windows=windows)

    @property
    def factors(self) -> list[Factor]:
        """Return the intrinsic columns."""
        every = zip(self.signals, self.bases, strict=True)
        return [Factor(signal, functions[self.times]) for signal, functions in every]

    @property
    def output(self) -> Factor:
        """Return the torque as a column."""
        return Factor.column(self.torque)

    @cached_property
    def fold_moments(self) -> list[Moments]:
        """Return the moments of the intrinsic columns in each fold."""
        every = [*self.factors, self.output]
        ends = np.cumsum([0, *(each.functions.shape[1] for each in every)])
        found = []
        for rows in self.folds:
            products = np.zeros((ends[-1], ends[-1]))
            for window, weights in self.windows:
                parts = [each.within(window, rows) for each in every]
                for place, part in enumerate(parts):
                    lower = slice(ends[place], ends[place + 1]), slice(ends[place + 1])
                    products[lower] += part.products(parts[: place + 1], weights)
            products = np.tril(products) + np.tril(products, -1).T
            share = len(self.torque[rows]) / len(self.torque)
            found.append(Moments.of(products, share * self.number))
        return found

    @cached_property
    def moments(self) -> Moments:
        """Return the moments of the intrinsic columns."""
        return Moments._make(sum(each) for each in zip(*self.fold_moments, strict=True))

    def append(
        self, moments: Moments, known: Sequence[Factor], extra: Sequence[Factor], rows: slice = ALL
    ) -> Moments:
        """Append ``extra`` columns to the moments of ``known`` ones, of some realizations."""
        every, products = [*known, *extra, self.output], np.zeros(())
        for window, weights in self.windows:
            parts = [each.within(window, rows) for each in every]
            new = parts[len(known) : -1]
            products = products + np.concatenate([each.products(parts, weights) for each in new])
        count = len(moments.cross)
        cross, gram, right = products[:, :count], products[:, count:-1], products[:, -1]
        return moments._replace(
            gram=np.block([[moments.gram, cross.T], [cross, gram]]),
            cross=np.append(moments.cross, right),
        )

    def features(self, weights: Array) -> list[Array]:
        """Return matrices (time, column) that give weighted sums of the signals' coefficients.

        ``weights`` have shape (sum, signal). There is one matrix for each sum.
        """
        return [
            np.concatenate([a * w for a, w in zip(self.bases, row, strict=True)], axis=1)
            for row in weights
        ]

    def over_time(self, coefficients: Array) -> Array:
        """Return the coefficient of each signal at all times (time, signal)."""
        ends = np.cumsum([functions.shape[1] for functions in self.bases])
        parts = np.split(coefficients, ends[:-1])
        return np.stack([a @ c for a, c in zip(self.bases, parts, strict=True)], axis=1)

    def intrinsic(self, coefficients: Array) -> Array:
        """Return the intrinsic torque (realization, time), as a deviation from its mean."""
        varying = self.over_time(coefficients)[self.times].T
        out = np.zeros_like(self.torque)
        for coefficient, signal in zip(varying, self.signals, strict=True):
            out += coefficient * signal
        return deviations(out) if len(out) == 1 else out

    def squares(self, values: Array) -> Array:
        """Return the weighted squares of values (realization, time), one for each realization."""
        parts = [
            np.sum(values[:, window] @ weights * values[:, window], axis=1)
            for window, weights in self.windows
        ]
        return reduce(np.add, parts)


def _matrix(correlation: Array, times: int) -> Array:
    return np.asarray(toeplitz(np.pad(correlation, (0, times))[:times]))
