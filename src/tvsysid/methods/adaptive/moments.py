"""From realizations to one dimension: moments at each time, and the constants that stiffness stands beside."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.signal import firwin

from tvsysid.numerics import Array
from tvsysid.numerics.differentiation import HALF_WIDTH, derivative_weights
from tvsysid.numerics.moments import convolve_lags
from tvsysid.signals import Ensemble

LOW_BAND = firwin(21, 0.6)  # what aliasing and decimation leave alone
SHARE = 0.6  # of the samples that are independent in the low band
HELD = 2**16  # samples whose derivatives are held at once
STILL = 1e-9  # share of the mean power below which an angle is still
U, V, A = range(3)  # angle, velocity, acceleration; further regressors follow, the torque is last


@dataclass(frozen=True, eq=False)
class Signals:
    """Angle, its derivatives, further regressors and the torque, made anew for a block of realizations at a time.

    The filters of the derivatives do without ``missing`` samples at either end, those of the low band without
    ``missing_low``. Angle and torque count in their root mean squares, so that no unit matters.
    ``further`` are regressors (column, realization, context + time + context) beside the angle's.
    """

    ensemble: Ensemble
    scale: tuple[float, float]
    further: Array

    @classmethod
    def of(cls, ensemble: Ensemble, further: Array | None = None) -> Signals:
        """Of an ensemble."""
        rms = [float(np.sqrt(np.mean(np.square(x)))) for x in (ensemble.angle, ensemble.torque)]
        none = np.zeros((0, *ensemble.angle.shape))
        return cls(ensemble, (rms[0], rms[1]), none if further is None else further)

    def missing(self, low: bool = False) -> int:
        """Samples at either end of a realization without derivatives."""
        return max(0, HALF_WIDTH + low * (len(LOW_BAND) // 2) - self.ensemble.context)

    @property
    def known(self) -> int:
        """Samples of a realization that have derivatives."""
        return self.ensemble.samples - 2 * self.missing()

    def blocks(self, low: bool = False) -> Iterator[Array]:
        """Signals (signal, realization, time) of some realizations after the other."""
        ensemble, missing = self.ensemble, self.missing(low)
        reach = HALF_WIDTH + low * (len(LOW_BAND) // 2)
        first, stop = ensemble.context + missing, ensemble.context + ensemble.samples - missing
        filters = derivative_weights() * ensemble.sampling_rate ** np.arange(3.0)[:, None]
        if low:
            filters = np.stack([np.convolve(each, LOW_BAND) for each in filters])
        smooth = filters[0]
        length = max(1, HELD // ensemble.samples)
        for start in range(0, len(ensemble), length):
            rows = slice(start, start + length)
            angle, torque = ensemble.angle[rows], ensemble.torque[rows]
            out = np.empty((4 + len(self.further), len(angle), stop - first))
            near = slice(first - reach, stop + reach)
            for place, taps in enumerate(filters):
                out[place] = self._filtered(angle[:, near], taps, place == 0 and not low)
            for place, column in enumerate(self.further):
                out[3 + place] = self._filtered(column[rows, near], smooth, not low)
            out[-1] = self._filtered(torque[:, near], smooth, not low)
            out[:3] /= self.scale[0]
            out[-1] /= self.scale[1]
            yield out

    @staticmethod
    def _filtered(values: Array, taps: Array, plain: bool) -> Array:
        reach = len(taps) // 2
        times = values.shape[1] - 2 * reach
        if plain:
            return values[:, reach : reach + times]
        return convolve_lags(values, np.broadcast_to(taps, (times, len(taps))))

    def gram(self, low: bool = False) -> Array:
        """Sums over realizations of products of the signals at each time, (time, signal, signal)."""
        total = None
        for block in self.blocks(low):
            at_times = np.ascontiguousarray(block.transpose(2, 0, 1))
            part = at_times @ at_times.transpose(0, 2, 1)
            total = part if total is None else total + part
        assert total is not None
        return np.asarray(total)


class Constants(NamedTuple):
    """Coefficients beside stiffness that do not change (viscosity, inertia, further ones), and their covariance."""

    values: Array
    covariance: Array


def without_angle(gram: Array) -> Array:
    """Products of what of each signal but the angle is not in proportion to the angle at each time."""
    power = floored(gram[:, U, U])
    return np.asarray(gram[:, 1:, 1:] - gram[:, 1:, U, None] * gram[:, None, U, 1:] / power[:, None, None])


def constants(gram: Array, realizations: int, viscosity: Array | None = None) -> Constants:
    """Coefficients of the low band, with a stiffness that is free at each time; ``viscosity`` (time,) if it is known.

    A decimated acceleration is partly folded, which makes an inertia of the whole band 3 % too large.
    """
    times = len(gram)
    if viscosity is not None:
        gram = with_torque_less(gram, V, viscosity)
    free = without_angle(gram)[:, (viscosity is not None) :, (viscosity is not None) :].sum(axis=0)
    count = len(free) - 1
    size = np.sqrt(np.maximum(np.diag(free)[:-1], np.finfo(float).tiny))
    inverse = np.linalg.pinv(free[:-1, :-1] / np.outer(size, size), rcond=1e-10, hermitian=True) / np.outer(size, size)
    values = inverse @ free[:-1, -1]
    left = max(float(free[-1, -1] - values @ free[:-1, -1]), 0.0)
    covariance = inverse * left / max(realizations * times - times - count, 1.0) / SHARE
    return Constants(values, covariance)


def with_torque_less(gram: Array, place: int, coefficients: Array) -> Array:
    """Products when the torque loses one regressor times coefficients (time,) or one number."""
    out = gram.copy()
    change = gram[:, :, place] * np.reshape(coefficients, (-1, 1))
    out[:, :, -1] -= change
    out[:, -1] -= change
    out[:, -1, -1] += gram[:, place, place] * coefficients**2
    return out


def floored(power: Array) -> Array:
    """Power at each time, as if nothing were ever still."""
    return np.asarray(np.maximum(power, STILL * power.mean() + np.finfo(float).tiny))
