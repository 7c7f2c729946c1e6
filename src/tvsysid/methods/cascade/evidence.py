"""Gaussian priors whose sizes follow from the data, on what a Gram matrix knows of them."""

from __future__ import annotations

import math
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
    """What a linear model needs of its columns: their ``gram`` matrix, products with the torque, the torque's square.

    ``number`` is how many independent samples there are.
    """

    gram: Array
    cross: Array
    square: float
    number: float

    @classmethod
    def of(cls, products: Array, number: float) -> Self:
        """Of products of the columns and the torque, which is last."""
        return cls(products[:-1, :-1], products[:-1, -1], float(products[-1, -1]), number)

    def scaled(self, scale: Array) -> Self:
        """Moments of columns that are divided by these numbers."""
        return self._replace(gram=self.gram / np.outer(scale, scale), cross=self.cross / scale)

    def without(self, part: Self) -> Self:
        """Moments of the other realizations."""
        gram, cross = self.gram - part.gram, self.cross - part.cross
        return type(self)(gram, cross, self.square - part.square, self.number - part.number)


class Family(NamedTuple):
    """Columns of one coefficient: a constant and the harmonics of its change.

    ``free`` if the constant's prior is flat.

    ``several`` are columns of one size without harmonics.
    """

    harmonics: int = 0
    free: bool = True
    several: int = 0

    @property
    def columns(self) -> int:
        """How many there are."""
        return self.several or 2 * self.harmonics + 1


class Prior(NamedTuple):
    r"""Log standard deviations of the columns' coefficients, relative to the noise: ``offset + design @ parameters``.

    Of a family's h-th harmonic it is :math:`\log\gamma - \nu \log h`; ``decay`` says which
    parameters are a
    :math:`\nu`.
    """

    offset: Array
    design: Array
    decay: NDArray[np.bool_]

    @classmethod
    def of(cls, families: tuple[Family, ...]) -> Self:
        """Prior of families of columns that follow each other."""
        offset, parts, decay = [], [], []
        start, total = 0, sum(family.columns for family in families)

        def parameter(values: Array, at: int, is_decay: bool = False) -> None:
            parts.append(np.zeros(total))
            parts[-1][at : at + len(values)] = values
            decay.append(is_decay)

        for family in families:
            flat = family.free and not family.several
            offset.append(np.where(flat & (np.arange(family.columns) == 0), FLAT, 0.0))
            if not flat:
                parameter(np.ones(family.several or 1), start)
            if family.harmonics:
                parameter(np.ones(2 * family.harmonics), start + 1)
                parameter(
                    -np.log(np.repeat(np.arange(1, family.harmonics + 1), 2)),
                    start + 1,
                    is_decay=True,
                )
            start += family.columns
        return cls(
            np.concatenate(offset),
            np.stack(parts, axis=1) if parts else np.zeros((total, 0)),
            np.array(decay),
        )

    @property
    def usual(self) -> Array:
        """Parameters to begin with."""
        return np.where(self.decay, USUAL_DECAY, 0.0)

    def spread(self, parameters: Array) -> Array:
        """Standard deviations, relative to the noise."""
        return np.asarray(np.exp(self.offset + self.design @ parameters))

    def log_density(self, parameters: Array) -> tuple[float, Array]:
        """Of the parameters themselves, and its gradient."""
        off = np.where(self.decay, (parameters - USUAL_DECAY) / DECAY_SPREAD, 0.0)
        return -0.5 * float(off @ off), -off / DECAY_SPREAD


class Solved(NamedTuple):
    """Posterior of coefficients whose prior has these standard deviations relative to the noise.

    ``inverse_factor`` is that of the Cholesky factor of ``S G S + 1``, with S the spread and G
    the Gram matrix. A share of the torque's square is ``lost`` because some quantities are not
    negative.
    """

    coefficients: Array
    log_evidence: float
    noise_variance: float
    inverse_factor: Array
    by_spread: Array
    lost: float

    @property
    def effective(self) -> float:
        """Effective number of parameters."""
        return len(self.coefficients) - float(np.sum(self.inverse_factor**2))


def solve(moments: Moments, spread: Array, positive: Array = UNLIMITED) -> Solved:
    r"""Ridge regression and its evidence, with the noise variance at its most probable.

    .. math:: \log p = -\tfrac n2 \log \frac{y^T (1 + \Phi S^2 \Phi^T)^{-1} y}{y^T y}
              - \tfrac12 \log|S \Phi^T\Phi S + 1|

    more than that of a torque that is all noise, so that no unit matters. ``by_spread`` are its
    derivatives by the logarithms of the spread. Of the coefficients whose products with each row
    of ``positive`` (row, coefficient) are not negative, those of greatest posterior density are
    returned.
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
    return Solved(spread * mean, density, left / moments.number, inverse, by_spread, lost)


def nearest_inside(point: Array, normals: Array) -> Array:
    """Return the nearest point whose products with no column of ``normals`` are negative."""
    if not (point @ normals < 0).any():
        return point
    size, sizes = np.linalg.norm(point), np.linalg.norm(normals, axis=0)
    unit = normals / np.maximum(sizes, np.finfo(float).tiny)
    return np.asarray(point + size * (unit @ scipy.optimize.nnls(unit, -point / size)[0]))


def tuned(moments: Moments, prior: Prior, start: Array) -> Array:
    """Hyper-parameters of greatest evidence near a start.

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
