"""From realizations to one dimension: moments at each time, and the constants that stiffness stands beside."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tvsysid.methods.base import missing_edge
from tvsysid.methods.cascade.evidence import nearest_inside
from tvsysid.methods.shared.residuals import independent_realizations
from tvsysid.numerics import Array
from tvsysid.numerics.decimation import decimation_weights
from tvsysid.numerics.differentiation import HALF_WIDTH, derivative_weights
from tvsysid.numerics.moments import convolve_lags, row_blocks
from tvsysid.signals import Ensemble

LOW_BAND = decimation_weights(1 / 0.6, 21)  # what aliasing and decimation leave alone
LOW_SHARE = 0.6  # of the samples that are independent in the low band
MIN_REALIZATIONS = 4  # realizations
SHORTEST = 16  # samples of a realization that have derivatives, at least
STILL = 1e-9  # share of the mean power below which an angle is still, or nothing is left of a regressor
U, V, A = range(3)  # angle, velocity, acceleration; further regressors follow, the torque is last


@dataclass(frozen=True, eq=False, kw_only=True)
class Signals(ABC):
    """Signals of realizations: the angle, its velocity and acceleration, any further regressors, and the torque.

    At a ``rate`` in Hz, the angle's and the torque in units of ``scale``. ``edges`` are the samples at either end of a
    realization that are missing; ``realizations`` how many there are, and how many are independent. A ``share`` of the
    samples that the constants are found from is independent; ``holds`` (constant,) is how strongly priors hold them.
    Their products with each row of ``positive`` (row, constant) are not negative.
    """

    rate: float
    edges: tuple[int, int]
    realizations: tuple[int, int]
    share: float
    holds: Array
    positive: Array
    scale: tuple[float, float] = (1.0, 1.0)

    @abstractmethod
    def blocks(self, low: bool = False) -> Iterator[Array]:
        """Signals (signal, realization, time) of some realizations after the other, or what the constants are from."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Derived(Signals):
    """Angle and torque of an ensemble and the angle's derivatives, made anew for a block of realizations at a time.

    They count in root mean squares, so that no unit matters.
    """

    ensemble: Ensemble

    @classmethod
    def of(cls, ensemble: Ensemble) -> Derived:
        """Of an ensemble."""
        return cls(
            rate=ensemble.sampling_rate,
            edges=(missing_edge(HALF_WIDTH, ensemble),) * 2,
            realizations=(len(ensemble), independent_realizations(ensemble)),
            share=LOW_SHARE,
            holds=np.zeros(2),
            positive=np.zeros((0, 2)),
            scale=(float(np.sqrt(np.mean(ensemble.angle**2))), float(np.sqrt(np.mean(ensemble.torque**2)))),
            ensemble=ensemble,
        )

    def blocks(self, low: bool = False) -> Iterator[Array]:
        """Signals of the whole band, or of the low one."""
        ensemble = self.ensemble
        reach = HALF_WIDTH + low * (len(LOW_BAND) // 2)
        missing = missing_edge(reach, ensemble)
        if low and ensemble.samples - 2 * missing < SHORTEST:
            yield from self.blocks()
            return
        near = slice(ensemble.context + missing - reach, ensemble.context + ensemble.samples - missing + reach)
        filters = derivative_weights() * ensemble.sampling_rate ** np.arange(3.0)[:, None]
        if low:
            filters = np.stack([np.convolve(each, LOW_BAND) for each in filters])
        for some in row_blocks(len(ensemble), ensemble.samples):
            angle, torque = (x[some, near] for x in (ensemble.angle, ensemble.torque))
            out = np.empty((4, len(angle), angle.shape[1] - 2 * reach))
            for place, taps in enumerate(filters):
                out[place] = _filtered(angle, taps / self.scale[0])
            out[-1] = _filtered(torque, filters[0] / self.scale[1])
            yield out


def _filtered(values: Array, taps: Array) -> Array:
    reach = len(taps) // 2
    times = values.shape[1] - 2 * reach
    if np.count_nonzero(taps) == 1:
        return np.asarray(values[:, reach : reach + times] * taps[reach])
    return convolve_lags(values, np.broadcast_to(taps, (times, len(taps))))


def gram_of(signals: Signals, low: bool = False) -> Array:
    """Sums over realizations of products of the signals at each time, (time, signal, signal)."""
    total: Array | float = 0.0
    for block in signals.blocks(low):
        at_times = np.ascontiguousarray(block.transpose(2, 0, 1))
        total = total + at_times @ at_times.transpose(0, 2, 1)
    return np.asarray(total)


class Constants(NamedTuple):
    """Coefficients beside stiffness that do not change (viscosity, inertia, further ones), and their covariance.

    Where the signals do not tell them apart they are not ``told``, and 0 in directions that nothing is known of.
    """

    values: Array
    covariance: Array
    told: bool


def without_angle(gram: Array) -> Array:
    """Products of what of each signal but the angle is not in proportion to the angle at each time."""
    power = floored(gram[:, U, U])
    return np.asarray(gram[:, 1:, 1:] - gram[:, 1:, U, None] * gram[:, None, U, 1:] / power[:, None, None])


def constants(gram: Array, signals: Signals, viscosity: Array | None = None) -> Constants:
    """Constants beside a stiffness that is free at each time; ``viscosity`` (time,) if it is known.

    From products in the low band: a decimated acceleration is partly folded, which makes an inertia of the whole band
    3 % too large.
    """
    times, known = len(gram), viscosity is not None
    if viscosity is not None:
        gram = with_torque_less(gram, V, viscosity)
    free = without_angle(gram)[:, known:, known:].sum(axis=0)
    cross, positive = free[:-1, -1], signals.positive[:, known:]
    own = free[:-1, :-1] + np.diag(signals.holds[known:]) / signals.share
    power = np.diag(gram.sum(axis=0))[1 + known : -1]
    size = np.sqrt(np.maximum(power, np.finfo(float).tiny))
    eigenvalues, vectors = np.linalg.eigh(own / np.outer(size, size))
    told = eigenvalues > STILL
    root = vectors[:, told] / size[:, None] / np.sqrt(eigenvalues[told])
    inverse = root @ root.T
    values = root @ nearest_inside(cross @ root, (positive @ root).T)
    left = max(float(free[-1, -1] - 2 * values @ cross + values @ free[:-1, :-1] @ values), 0.0)
    variance = left / max(signals.realizations[1] * times - times - len(values), 1.0)
    if not known:
        return Constants(values, inverse * variance / signals.share, bool(told.all()))
    covariance = np.pad(inverse * variance / signals.share, ((1, 0), (1, 0)))
    return Constants(np.concatenate([[0.0], values]), covariance, bool(told.all()))


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
