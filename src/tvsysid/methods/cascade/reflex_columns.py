"""Compute the columns of the reflex pathway and their products with other columns."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import attrs
import numpy as np
from scipy.linalg import toeplitz

from tvsysid.methods.cascade.columns import deviations
from tvsysid.methods.cascade.data import MAX_WINDOW, Factor
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

    def factor(self, shape: Shape) -> Factor:
        """Return the columns as a signal, functions of time and a muscle."""
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
