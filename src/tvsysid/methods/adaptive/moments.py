"""Moments of realizations at each time, and the constant coefficients beside stiffness."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import NamedTuple

import attrs
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
MIN_REALIZATIONS = 4  # realizations
SHORTEST = 16  # samples of a realization that have derivatives, at least
STILL = (
    1e-9  # share of the mean power below which an angle is still, or nothing is left of a regressor
)
U, V, A = range(3)  # angle, velocity, acceleration; further regressors follow, the torque is last


@attrs.frozen(eq=False, kw_only=True)
class Signals(ABC):
    """Signals of realizations.

    They are the angle, its velocity and acceleration, any further regressors, and the torque, at a
    ``rate`` in Hz. Angle and torque are in units of ``scale``. ``edges`` are the samples at either
    end of a realization that are missing. ``realizations`` is the number of realizations, and the
    number of independent ones. ``holds`` (constant,) are the noise variance over the prior
    variances of the constants. The products of the constants with each row of ``positive`` (row,
    constant) are not negative.
    """

    rate: float
    edges: tuple[int, int]
    realizations: tuple[int, int]
    holds: Array
    positive: Array
    scale: tuple[float, float] = (1.0, 1.0)

    @abstractmethod
    def blocks(self) -> Iterator[Array]:
        """Yield signals (signal, realization, time) of one block of realizations after another."""


@attrs.frozen(eq=False, kw_only=True)
class Derived(Signals):
    """Angle and torque of an ensemble, and the angle's derivatives.

    Derivatives are calculated for one block of realizations at a time. Signals are in units of
    their root mean square, so that no unit matters.
    """

    ensemble: Ensemble

    @classmethod
    def of(cls, ensemble: Ensemble) -> Derived:
        """Return the signals of an ensemble."""
        return cls(
            rate=ensemble.sampling_rate,
            edges=(missing_edge(HALF_WIDTH, ensemble),) * 2,
            realizations=(len(ensemble), independent_realizations(ensemble)),
            holds=np.zeros(2),
            positive=np.zeros((0, 2)),
            scale=(
                float(np.sqrt(np.mean(ensemble.angle**2))),
                float(np.sqrt(np.mean(ensemble.torque**2))),
            ),
            ensemble=ensemble,
        )

    def blocks(self) -> Iterator[Array]:
        """Yield the signals of one block of realizations after another."""
        ensemble = self.ensemble
        first = ensemble.context + self.edges[0] - HALF_WIDTH
        near = slice(first, ensemble.context + ensemble.samples - self.edges[1] + HALF_WIDTH)
        filters = derivative_weights() * ensemble.sampling_rate ** np.arange(3.0)[:, None]
        for some in row_blocks(len(ensemble), ensemble.samples):
            angle, torque = (x[some, near] for x in (ensemble.angle, ensemble.torque))
            out = np.empty((4, len(angle), angle.shape[1] - 2 * HALF_WIDTH))
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


def gram_of(signals: Signals) -> Array:
    """Return sums over realizations of products at each time, shape (time, signal, signal)."""
    total: Array | float = 0.0
    for block in signals.blocks():
        at_times = np.ascontiguousarray(block.transpose(2, 0, 1))
        total = total + at_times @ at_times.transpose(0, 2, 1)
    return np.asarray(total)


class Normal(NamedTuple):
    """Sums over realizations of products of signals with a weight W (time, time) between them.

    ``angle``, ``mixed`` and ``velocity`` are normal matrices (time, time) of coefficients that
    are free at each time, such as W ∘ Σ u uᵀ, and ``right`` (2, signal, time) their right sides
    u ∘ W x, v ∘ W x for every other signal x. ``steady`` (constant, signal) and ``low``
    (constant, time) are products in the low band of the constants' signals with all but the
    angle, and with the angle. ``excess`` (2,) are variances of the scores u ∘ W e, v ∘ W e over
    what W says of them.
    """

    angle: Array
    mixed: Array
    velocity: Array
    right: Array
    steady: Array
    low: Array
    excess: tuple[float, float]


def normal(
    signals: Signals, weights: tuple[Array, Array], coefficients: Array, viscosity: Array
) -> Normal:
    """Return the products with weights of the whole band and of the low one.

    The torque of a ``viscosity`` (time,) is subtracted from the torque. The ``coefficients``
    (signal, time) give the errors whose scores are compared.
    """
    whole, low = weights
    sums: list[Array] = []
    for every in signals.blocks():
        block = np.concatenate([every[:-1], every[-1:] - viscosity * every[V]])
        u, v, weighted = block[U], block[V], block[1:] @ whole
        slow = weighted[:-1] if low is whole else block[1:-1] @ low
        free = block[: V + 1]
        error = (block[-1] - np.einsum("krt,kt->rt", block[:-1], coefficients)) @ whole
        found = [
            u.T @ u,
            u.T @ v,
            v.T @ v,
            np.einsum("frt,irt->fit", free, weighted),
            np.tensordot(slow, block[1:], ((1, 2), (1, 2))),
            np.einsum("rt,irt->it", u, slow),
            np.einsum("frt,rt->ft", free**2, error**2),
            np.einsum("frt,rt->ft", free**2, u**2),
        ]
        sums = [one + other for one, other in zip(sums, found, strict=True)] if sums else found
    *squares, right, steady, slow, scores, alike = sums
    angle, mixed, velocity = (each * whole for each in squares)
    power = floored(np.diag(squares[0]))
    excess = []
    for place, matrix in enumerate((angle, velocity)):
        np.fill_diagonal(matrix, floored(np.diag(matrix)))
        own = floored(np.diag(squares[2 * place]))
        taken = (
            np.maximum(1 - alike[place] / (own * power), 1e-3)
            * signals.realizations[1]
            / signals.realizations[0]
        )
        excess.append(float(np.sum(scores[place]) / np.sum(np.diag(matrix) * taken)))
    return Normal(angle, mixed, velocity, right, steady, slow, (excess[0], excess[1]))


class Constants(NamedTuple):
    """Constant coefficients beside stiffness, and their covariance.

    They are viscosity, inertia and further ones. ``told`` is False where the signals are collinear.
    The coefficients are then 0 in the directions that the data do not determine.
    """

    values: Array
    covariance: Array
    told: bool


def without_angle(gram: Array) -> Array:
    """Return the products of signals after the angle is regressed out at each time.

    The angle itself is left out.
    """
    power = floored(gram[:, U, U])
    return np.asarray(
        gram[:, 1:, 1:] - gram[:, 1:, U, None] * gram[:, None, U, 1:] / power[:, None, None]
    )


def constants(free: Array, power: Array, holds: Array, positive: Array) -> Constants:
    """Estimate the constants from products of their signals and the torque.

    A free stiffness is eliminated from these products. ``power`` (constant,) is that of the signals
    before this. ``holds`` (constant,) is the precision of their priors. Their products with the
    rows of ``positive`` are not negative.
    """
    size = np.sqrt(np.maximum(power + holds, np.finfo(float).tiny))
    own, cross = free[:, :-1], free[:, -1]
    own = (own + own.T) / 2 + np.diag(holds)
    eigenvalues, vectors = np.linalg.eigh(own / np.outer(size, size))
    told = eigenvalues > STILL
    root = vectors[:, told] / size[:, None] / np.sqrt(eigenvalues[told])
    values = root @ nearest_inside(cross @ root, (positive @ root).T)
    return Constants(values, root @ root.T, bool(told.all()))


def floored(power: Array) -> Array:
    """Return the power at each time, at least a small floor."""
    return np.asarray(np.maximum(power, STILL * power.mean() + np.finfo(float).tiny))
