"""Hold the torque and the intrinsic signals of a joint, weighted by the noise's covariance."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Self

import attrs
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz

from tvsysid.methods.cascade.columns import deviations
from tvsysid.numerics import Array
from tvsysid.numerics.gaussian import Moments

FOLDS = 3  # interleaved sets of realizations, each predicted from the others
MAX_WINDOW = 256  # samples of a realization whose noise counts as correlated
ALL = slice(None)


@attrs.frozen(eq=False)
class Data:
    """Torque and intrinsic ``signals``, as deviations from their mean over realizations.

    The ``torque`` has shape (realization, time), the signals (signal, realization, time). ``rows``
    and ``times`` of an ensemble are fitted. ``bases`` are the functions of time (time, function)
    by which each signal's coefficient changes, at all times. ``noise`` is the autocorrelation of
    the noise, and ``windows`` are stretches of time with the inverse of its matrix. ``products``
    (fold, column, column) are those of the intrinsic columns and the torque, which is last.
    """

    torque: Array
    signals: Array
    bases: tuple[Array, ...]
    rows: NDArray[np.int64]
    times: slice
    noise: Array = attrs.field(factory=lambda: np.ones(1))
    windows: list[tuple[slice, Array]] = attrs.field(factory=list)
    products: Array = attrs.field(factory=lambda: np.zeros(()))

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

    @property
    def ends(self) -> NDArray[np.int64]:
        """Return where the columns of each signal begin, and the end of all."""
        return np.cumsum([0, *(functions.shape[1] for functions in self.bases)])

    def constant(self) -> Self:
        """Return the data with constant coefficients."""
        bases = tuple(functions[:, :1] for functions in self.bases)
        products = self.products[:, self.ends[:, None], self.ends]
        return attrs.evolve(self, bases=bases, products=products)

    def weighted(self, noise: Array, true: Array | None = None) -> Self:
        """Return the data weighted by the inverse of the noise's autocorrelation.

        The autocorrelation begins at lag 0, and holds within a realization or a window of it. If
        the ``true`` autocorrelation is another one, the products are those of the sandwich
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
        data = attrs.evolve(self, noise=noise, windows=windows)
        return attrs.evolve(data, products=np.stack([data._products(each) for each in self.folds]))

    def factors(self, rows: slice) -> Iterator[tuple[Array, Array]]:
        """Yield each signal (realization, time) and its functions of time; the torque is last."""
        for signal, functions in zip(self.signals, self.bases, strict=True):
            yield signal[rows], functions[self.times]
        yield self.torque[rows], np.ones((self.torque.shape[1], 1))

    def are_few(self, columns: int) -> bool:
        """Return whether products of this number of columns are faster from the columns."""
        return columns * len(self.torque) < 3 * len(self.windows[0][1])

    def _products(self, rows: slice) -> Array:
        """Return weighted products of the intrinsic columns and the torque of some realizations."""
        factors = list(self.factors(rows))
        if self.are_few(int(self.ends[-1])):
            columns = np.concatenate([x * functions.T[:, None] for x, functions in factors])
            return np.tensordot(columns, self.whitened(columns), ((1, 2), (1, 2)))
        ends = np.append(self.ends, self.ends[-1] + 1)
        out = np.zeros((ends[-1], ends[-1]))
        for inside, inverse in self.windows:
            for i, (x, a) in enumerate(factors):
                for j, (z, b) in enumerate(factors[: i + 1]):
                    weighted = x[:, inside].T @ z[:, inside] * inverse
                    block = slice(ends[i], ends[i + 1]), slice(ends[j], ends[j + 1])
                    out[block] += a[inside].T @ weighted @ b[inside]
        return np.tril(out) + np.tril(out, -1).T

    def moments(self, fold: int | None) -> Moments:
        """Return the weighted moments of the intrinsic columns, of a fold or of all."""
        if fold is None:
            return Moments.of(self.products.sum(axis=0), self.number)
        share = len(self.torque[self.folds[fold]]) / len(self.torque)
        return Moments.of(self.products[fold], share * self.number)

    def cross(self, white: Array, rows: slice = ALL) -> Array:
        """Return products (column, signal) of intrinsic columns and torque with whitened signals.

        Only the realizations ``rows`` are summed.
        """
        factors = self.factors(rows)
        parts = [np.einsum("rt,krt->kt", x, white) @ functions for x, functions in factors]
        return np.concatenate(parts, axis=1).T

    def whitened(self, values: Array) -> Array:
        """Multiply values (…, time) by the inverse covariance of the noise."""
        parts = [values[..., inside] @ inverse for inside, inverse in self.windows]
        return np.concatenate(parts, axis=-1)

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
        parts = np.split(coefficients, self.ends[1:-1])
        return np.stack([a @ c for a, c in zip(self.bases, parts, strict=True)], axis=1)

    def intrinsic(self, coefficients: Array) -> Array:
        """Return the intrinsic torque (realization, time), as a deviation from its mean."""
        varying = self.over_time(coefficients)[self.times].T
        out = np.zeros_like(self.torque)
        for coefficient, signal in zip(varying, self.signals, strict=True):
            out += coefficient * signal
        return deviations(out) if len(out) == 1 else out


def _matrix(correlation: Array, times: int) -> Array:
    return np.asarray(toeplitz(np.pad(correlation, (0, times))[:times]))


def appended(moments: Moments, cross: Array, gram: Array) -> Moments:
    """Append columns to moments.

    ``cross`` are their products with the other columns and, last, with the torque. ``gram`` are
    those with each other.
    """
    return moments._replace(
        gram=np.block([[moments.gram, cross[:-1]], [cross[:-1].T, gram]]),
        cross=np.append(moments.cross, cross[-1]),
    )
