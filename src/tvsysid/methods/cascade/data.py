"""What is fitted: torque, intrinsic signals, and the weights of their samples."""

from __future__ import annotations

from functools import cache, cached_property
from itertools import pairwise

import attrs
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import toeplitz

from tvsysid.errors import InputError
from tvsysid.methods.base import missing_edge
from tvsysid.methods.cascade.columns import (
    MAX_WINDOW,
    Columns,
    Windows,
    deviations,
    intrinsic_signals,
    products,
    unresolved,
)
from tvsysid.methods.cascade.pathways import history
from tvsysid.numerics import Array
from tvsysid.numerics.bases import FourierSeries
from tvsysid.signals import Ensemble

NEEDED_HISTORY_S = 0.45  # of the reflex's drive before a sample that is fitted
FOLDS = 3  # interleaved sets of realizations, each predicted from the others


@attrs.frozen(eq=False)
class Data:
    """Torque and intrinsic ``signals``, as deviations from their mean over realizations.

    The ``torque`` has shape (realization, time), the signals (signal, realization, time). ``rows``
    and ``times`` of an ensemble are fitted. ``functions`` (time, column) are those of all times by
    which coefficients change; those of a signal begin with the column ``starts``. ``gain`` is the
    basis of the reflex's gain over a ``period`` in s. ``noise`` is the autocorrelation of the
    noise, from lag 0 on. It weights the samples.
    """

    torque: Array
    signals: Array
    functions: Array
    starts: list[int]
    gain: FourierSeries
    period: float
    rate: float
    rows: NDArray[np.int64]
    times: slice
    noise: Array = attrs.field(factory=lambda: np.ones(1))

    @classmethod
    def of(cls, ensemble: Ensemble, harmonics: tuple[int, int, int], lags: int) -> Data:
        """Return the realizations with most recorded past, from where it is long enough."""
        rate = ensemble.sampling_rate
        signals = intrinsic_signals(ensemble.angle, lags, rate)
        signals[1:3] += unresolved(ensemble.angle_as_recorded, lags, rate)
        edge = missing_edge(lags, ensemble)
        last = ensemble.samples - edge
        past = history(ensemble, ensemble.angle, round(NEEDED_HISTORY_S * rate))
        missing = np.isnan(past[:, : ensemble.samples]).sum(axis=1)
        first = int(missing.min())
        if first >= last:
            raise InputError(
                f"JointCascade: the reflex needs {NEEDED_HISTORY_S:g} s of record before a fitted "
                f"sample; realizations have {ensemble.duration:g} s with "
                f"{ensemble.context / rate:g} s of context; give longer ones"
            )
        times, rows = slice(max(first, edge), last), np.flatnonzero(missing <= max(first, edge))
        counts = [*harmonics[:2], *[0] * (len(signals) - 2)]
        phase = ensemble.time / ensemble.duration
        return cls(
            torque=deviations(ensemble.torque[:, ensemble.core][rows, times]),
            signals=deviations(signals[..., ensemble.core][:, rows, times]),
            functions=np.concatenate([FourierSeries(count)(phase) for count in counts], axis=1),
            starts=np.cumsum([0, *(2 * count + 1 for count in counts[:-1])]).tolist(),
            gain=FourierSeries(harmonics[2] if any(counts) else 0),
            period=ensemble.duration,
            rate=rate,
            rows=rows,
            times=times,
        )

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
    def own(self) -> int:
        """Return the number of intrinsic columns."""
        return int(self.functions.shape[1])

    @property
    def varies(self) -> bool:
        """Return whether any coefficient changes over time."""
        return self.own > len(self.signals)

    @cached_property
    def constant(self) -> Data:
        """Return the data with constant coefficients."""
        functions, starts = self.functions[:, self.starts], list(range(len(self.starts)))
        return attrs.evolve(self, functions=functions, starts=starts, gain=FourierSeries(0))

    def weights(self, true: Array | None = None) -> Windows:
        """Return stretches of time, and the weights (time, time) of the samples in each.

        If the noise's ``true`` autocorrelation is another one, products of columns with these
        weights are those of the sandwich covariance of the coefficients.
        """
        rows, times = self.torque.shape
        edges = np.linspace(0, times, -(-times // MAX_WINDOW) + 1).astype(int).tolist()

        @cache
        def weights(size: int) -> Array:
            inverse = np.linalg.inv(_matrix(self.noise, size))
            if rows == 1:  # its mean is not known
                weight = inverse.sum(axis=0)
                inverse = inverse - np.outer(weight, weight) / weight.sum()
            return np.asarray(inverse if true is None else inverse @ _matrix(true, size) @ inverse)

        return [(slice(start, stop), weights(stop - start)) for start, stop in pairwise(edges)]

    @cached_property
    def windows(self) -> Windows:
        """Return the weights of the samples."""
        return self.weights()

    @property
    def columns(self) -> list[Columns]:
        """Return the torque and the intrinsic columns. Those after velocity are constant."""
        *changing, _ = np.split(self.functions[self.times], self.starts[1:3], axis=1)
        parts = zip(self.signals[:2, None], changing, strict=True)
        explicit = map(Columns.explicit, (self.torque[None], self.signals[2:]))
        return [next(explicit), *(Columns(*part) for part in parts), *explicit]

    @cached_property
    def fold_products(self) -> list[Array]:
        """Return the products of torque and intrinsic columns in each fold."""
        return [products(self.columns, self.windows, rows) for rows in self.folds]

    def features(self, weights: Array) -> Array:
        """Return the weights (time, column) that sum the signals' weighted coefficients."""
        return self.functions * np.repeat(weights, np.diff([*self.starts, self.own]))

    def over_time(self, coefficients: Array) -> Array:
        """Return the coefficient of each signal at all times (time, signal)."""
        return np.add.reduceat(self.functions * coefficients, self.starts, axis=1)

    def squares(self, values: Array) -> Array:
        """Return the weighted squares of values (realization, time), one for each realization."""
        parts = [values[:, times] @ weights * values[:, times] for times, weights in self.windows]
        return np.asarray(np.concatenate(parts, axis=1).sum(axis=1))


def _matrix(correlation: Array, times: int) -> Array:
    return np.asarray(toeplitz(np.pad(correlation, (0, times))[:times]))
