"""Fit coefficients under Gaussian priors, whose sizes maximise the evidence."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import attrs
import numpy as np
import scipy
from numpy.typing import NDArray

from tvsysid.numerics import Array
from tvsysid.numerics.gaussian import Moments, Posterior, solve

FLAT_FAMILIES, FLAT_LOG_SIZE = 3, math.log(1e4)  # constants of impedance, relative to the noise
DECAY_MEAN, DECAY_SPREAD = 1.5, 2.0  # of the weak prior of a decay
# Families are stiffness, viscosity, inertia, differences and reflex gain. The parameters are the
# sizes of their constants and harmonics, and the decays of the latter.
FAMILIES = FLAT_FAMILIES + 2
IS_DECAY = np.repeat([False, False, True], FAMILIES)
BOUNDS = np.where(IS_DECAY[:, None], (0.6, 6.0), (-9.0, 3.0))
USUAL_PARAMETERS = np.where(IS_DECAY, DECAY_MEAN, 0.0)
MAX_ITERATIONS = 100  # of the search for the hyperparameters


def ridge(moments: Moments, spread: Array, positive: Array | None = None) -> Posterior:
    """Return the posterior of coefficients whose prior ``spread`` is relative to the noise.

    The noise variance is the most probable one. The mean has the greatest posterior density of all
    coefficients whose products with each row of ``positive`` (row, coefficient) are not negative.
    """
    found = solve(moments, spread**-2)
    mean, left = found.mean, found.left
    if positive is not None:
        free = found.inverse_factor @ moments.cross
        inside = nearest_inside(free, found.inverse_factor @ positive.T)
        mean, left = inside @ found.inverse_factor, left + float(free @ free - inside @ inside)
    left = max(left, 1e-14 * moments.square + np.finfo(float).tiny)
    noise = left / moments.number
    precision = found.precision / noise
    return attrs.evolve(found, mean=mean, left=left, noise_variance=noise, precision=precision)


def log_evidence(found: Posterior, square: float) -> float:
    r"""Return the evidence relative to that of a torque that is all noise.

    .. math:: \log p = -\tfrac n2 \log \frac{y^T (1 + \Phi S^2 \Phi^T)^{-1} y}{y^T y}
              - \tfrac12 \log|S \Phi^T\Phi S + 1|
    """
    return -0.5 * (found.number * math.log(found.left / square) + found.log_determinant)


def nearest_inside(point: Array, normals: Array) -> Array:
    """Return the nearest point whose products with no column of ``normals`` are negative."""
    if not (point @ normals < 0).any():
        return point
    size, sizes = np.linalg.norm(point), np.linalg.norm(normals, axis=0)
    unit = normals / np.maximum(sizes, np.finfo(float).tiny)
    return np.asarray(point + size * (unit @ scipy.optimize.nnls(unit, -point / size)[0]))


class Prior(NamedTuple):
    r"""Prior of the coefficients: their log standard deviations relative to the noise.

    These are ``offset + design @ parameters`` for columns of unit RMS. Each family of columns has
    three parameters: the size of its constant, and :math:`\log\gamma` and :math:`\nu`, which give
    :math:`\log\gamma - \nu \log h` for its h-th harmonic. ``first`` (column,) is the column of each
    family that is not modulated.
    """

    offset: Array
    design: Array
    first: NDArray[np.int64]

    @staticmethod
    @lru_cache(maxsize=4)
    def of(sizes: tuple[int, ...]) -> Prior:
        """Return the prior of the coefficients of signals, and of a reflex's gain, which is last.

        There are so many of each: a constant, and two for each harmonic. Constants of stiffness,
        viscosity and inertia have a flat prior. Signals beyond the acceleration share one size.
        """
        order = np.concatenate([np.arange(1, size + 1) // 2 for size in sizes])
        family = [*np.arange(len(sizes) - 1).clip(max=FLAT_FAMILIES), FAMILIES - 1]
        is_own = np.eye(FAMILIES)[np.repeat(family, sizes)]
        is_flat = is_own[:, :FLAT_FAMILIES].any(axis=1) & (order == 0)
        weights = (order == 0) & ~is_flat, order > 0, -np.log(order.clip(1))
        design = np.concatenate([is_own * each[:, None] for each in weights], axis=1)
        first = np.maximum.accumulate(np.where(order == 0, np.arange(len(order)), 0))
        return Prior(FLAT_LOG_SIZE * is_flat, design, first)

    def spread(self, moments: Moments, parameters: Array) -> Array:
        """Return the standard deviations of the coefficients relative to the noise."""
        power = np.diag(moments.gram)[self.first] / moments.number
        scale = np.sqrt(np.where(power > 0, power, 1.0))
        return np.asarray(np.exp(self.offset + self.design @ parameters) / scale)

    def tuned(self, moments: Moments, start: Array) -> Array:
        """Return the parameters of greatest evidence near a start."""

        def cost(parameters: Array) -> tuple[float, Array]:
            found, off = ridge(moments, self.spread(moments, parameters)), decays_off(parameters)
            slope = 2 * found.by_variances @ self.design - off / DECAY_SPREAD
            return 0.5 * float(off @ off) - log_evidence(found, moments.square), -slope

        options = {"maxiter": MAX_ITERATIONS, "ftol": 1e-14, "gtol": 1e-7}
        found = scipy.optimize.minimize(
            cost, start, jac=True, method="L-BFGS-B", bounds=BOUNDS, options=options
        )
        return np.asarray(found.x)


def decays_off(parameters: Array) -> Array:
    """Return the distance of each decay from its mean, in standard deviations."""
    return np.where(IS_DECAY, (parameters - DECAY_MEAN) / DECAY_SPREAD, 0.0)
