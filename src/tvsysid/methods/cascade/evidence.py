"""Fit coefficients under Gaussian priors, whose sizes maximise the evidence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.linalg import lapack

from tvsysid.numerics import Array

FLAT = math.log(
    1e4
)  # log standard deviation, relative to the noise, of what the prior says nothing of
SIZES = (-9.0, 3.0)  # bounds of a log size
DECAYS = (0.6, 6.0)  # bounds of the power with which harmonics fall
USUAL_DECAY, DECAY_SPREAD = 1.5, 2.0  # of the weak prior of a decay
UNLIMITED = np.zeros((0, 1))  # of no quantity that cannot be negative
ITERATIONS = 60  # of the search for the hyper-parameters, at most


class Moments(NamedTuple):
    """Weighted ``products`` of columns and torque, which is last.

    ``number`` is the number of independent samples.
    """

    products: Array
    number: float

    @property
    def gram(self) -> Array:
        """Return the products of the columns with each other."""
        return self.products[:-1, :-1]

    @property
    def cross(self) -> Array:
        """Return the products of the columns with the torque."""
        return self.products[:-1, -1]

    @property
    def square(self) -> float:
        """Return the sum of squares of the torque."""
        return float(self.products[-1, -1])

    def scaled(self, scale: Array) -> Self:
        """Return the moments of columns divided by ``scale``."""
        every = np.append(scale, 1.0)
        return self._replace(products=self.products / np.outer(every, every))

    def without(self, part: Self) -> Self:
        """Return moments of the other realizations."""
        return type(self)(self.products - part.products, self.number - part.number)


class Prior(NamedTuple):
    r"""Prior of the coefficients: their log standard deviations relative to the noise.

    These are ``offset + design @ parameters``. That of a family's h-th harmonic is
    :math:`\log\gamma - \nu \log h`; ``decay`` says which parameters are a :math:`\nu`. ``first``
    (column,) is the column of each family that is not modulated.
    """

    offset: Array
    design: Array
    decay: NDArray[np.bool_]
    first: NDArray[np.int64]

    @classmethod
    def of(cls, harmonics: Sequence[int], further: int = 0, gain: int | None = None) -> Self:
        """Return the prior of families of columns that follow each other.

        A family is a constant and as many ``harmonics``; its constant has a flat prior.
        ``further`` columns have one size. The ``gain`` of a reflex has harmonics too, and a
        constant of unknown size.
        """
        # The harmonic of each column: 0, 1, 1, 2, 2, ...
        orders = [np.repeat(np.arange(count + 1.0), 2)[1:] for count in (*harmonics, gain or 0)]
        orders.insert(-1, np.zeros(further))
        order = np.concatenate(orders if gain is not None else orders[:-1])
        family = np.repeat(np.arange(len(orders)), [len(each) for each in orders])[: len(order)]
        is_flat = (family < len(harmonics)) & (order == 0)
        columns, decay = [np.zeros((0, len(order)))], []
        for number in range(len(orders)):
            own = family == number
            sizes = own & (order == 0) & ~is_flat, own & (order > 0), own * -np.log(order.clip(1))
            kept = [size.any() for size in sizes]
            columns.append(np.array(sizes)[kept])
            decay += [is_decay for is_decay in np.array([False, False, True])[kept]]
        first = np.maximum.accumulate(np.where(order == 0, np.arange(len(order)), 0))
        return cls(
            FLAT * is_flat, np.concatenate(columns).T.copy(), np.array(decay, dtype=bool), first
        )

    @property
    def usual(self) -> Array:
        """Return the initial parameters."""
        return np.where(self.decay, USUAL_DECAY, 0.0)

    def spread(self, parameters: Array) -> Array:
        """Return the standard deviations relative to the noise."""
        return np.asarray(np.exp(self.offset + self.design @ parameters))

    def log_density(self, parameters: Array) -> tuple[float, Array]:
        """Return the log density of the parameters, and its gradient."""
        off = np.where(self.decay, (parameters - USUAL_DECAY) / DECAY_SPREAD, 0.0)
        return -0.5 * float(off @ off), -off / DECAY_SPREAD


class Posterior(NamedTuple):
    """Posterior of coefficients under a Gaussian prior relative to the noise.

    ``inverse_factor`` is the inverse Cholesky factor of ``S G S + 1``, with S the spread and G
    the Gram matrix. ``lost`` is the share of the torque's square that the fit loses because some
    quantities must not be negative.
    """

    coefficients: Array
    log_evidence: float
    noise_variance: float
    inverse_factor: Array
    by_spread: Array
    lost: float

    @property
    def effective(self) -> float:
        """Return the effective number of parameters."""
        return len(self.coefficients) - float(np.sum(self.inverse_factor**2))


def solve(moments: Moments, spread: Array, positive: Array = UNLIMITED) -> Posterior:
    r"""Solve the ridge regression, and compute its evidence at the most probable noise variance.

    .. math:: \log p = -\tfrac n2 \log \frac{y^T (1 + \Phi S^2 \Phi^T)^{-1} y}{y^T y}
              - \tfrac12 \log|S \Phi^T\Phi S + 1|

    The evidence is relative to that of a torque that is all noise, so that it has no unit.
    ``by_spread`` are its derivatives by the logarithms of the spread. The coefficients have the
    greatest posterior density of all whose products with each row of ``positive``
    (row, coefficient) are not negative.
    """
    system = np.asfortranarray(moments.gram * np.outer(spread, spread))
    system.ravel(order="A")[:: len(system) + 1] += 1.0
    factor, failed = lapack.dpotrf(system, lower=1, clean=1)
    if failed:  # columns that are alike to rounding
        factor, _ = lapack.dpotrf(system + 1e-10 * np.diag(np.diag(system)), lower=1, clean=1)
    inverse = lapack.dtrtri(factor, lower=1)[0]
    right = spread * moments.cross
    half = inverse @ right
    mean = half @ inverse
    limits, most = positive * spread, float(half @ half)
    if (limits @ mean < 0).any():
        half = nearest_inside(half, inverse @ limits.T)
        mean = half @ inverse
    floor = 1e-14 * moments.square + np.finfo(float).tiny
    explained = float(half @ half)
    left = max(moments.square - explained, floor)
    density = -0.5 * moments.number * math.log(left / moments.square) - float(
        np.sum(np.log(np.diag(factor)))
    )
    by_spread = moments.number / left * mean**2 - (1 - np.einsum("ij,ij->j", inverse, inverse))
    lost = (most - explained) / moments.square
    return Posterior(spread * mean, density, left / moments.number, inverse, by_spread, lost)


def nearest_inside(point: Array, normals: Array) -> Array:
    """Return the nearest point whose products with no column of ``normals`` are negative."""
    if not (point @ normals < 0).any():
        return point
    size, sizes = np.linalg.norm(point), np.linalg.norm(normals, axis=0)
    unit = normals / np.maximum(sizes, np.finfo(float).tiny)
    return np.asarray(point + size * (unit @ scipy.optimize.nnls(unit, -point / size)[0]))


def tuned(moments: Moments, prior: Prior, start: Array) -> Array:
    """Return the hyperparameters of greatest evidence near a start.

    The columns have unit RMS in each family.
    """
    if not len(start):
        return start

    def cost(parameters: Array) -> tuple[float, Array]:
        found = solve(moments, prior.spread(parameters))
        own, slope = prior.log_density(parameters)
        return -found.log_evidence - own, -(found.by_spread @ prior.design) - slope

    bounds = [DECAYS if is_decay else SIZES for is_decay in prior.decay]
    options = {"maxiter": ITERATIONS, "ftol": 1e-9}
    return np.asarray(
        scipy.optimize.minimize(
            cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options
        ).x
    )
