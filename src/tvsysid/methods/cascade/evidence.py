"""Fit coefficients under Gaussian priors, whose sizes maximise the evidence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.linalg import block_diag

from tvsysid.numerics import Array
from tvsysid.numerics.gaussian import Moments, Posterior, solve

FLAT_LOG_SIZE = math.log(1e4)  # relative to the noise
LOG_SIZE_BOUNDS = (-9.0, 3.0)
DECAY_BOUNDS = (0.6, 6.0)  # of the power with which harmonics fall
DECAY_MEAN, DECAY_SPREAD = 1.5, 2.0  # of the weak prior of a decay
UNLIMITED = np.zeros((0, 0))  # no quantity must keep one sign
MAX_ITERATIONS = 60  # of the search for the hyperparameters


class Ridge(NamedTuple):
    """Posterior of coefficients whose prior ``spread`` is relative to the noise.

    The ``noise_variance`` is the most probable one. ``lost`` is the share of the torque's square
    that the fit loses because some quantities must keep one sign.
    """

    coefficients: Array
    spread: Array
    posterior: Posterior
    square: float
    left: float
    lost: float = 0.0

    @classmethod
    def of(cls, moments: Moments, spread: Array, positive: Array = UNLIMITED) -> Self:
        r"""Fit by ridge regression.

        The coefficients have the greatest posterior density of all whose products with each row of
        ``positive`` (row, coefficient) are not negative.
        """
        posterior = solve(moments, spread**-2)
        floor = 1e-14 * moments.square + np.finfo(float).tiny
        found = cls(posterior.mean, spread, posterior, moments.square, max(posterior.left, floor))
        if not len(positive) or (positive @ posterior.mean >= 0).all():
            return found
        factor = posterior.inverse_factor
        free = factor @ moments.cross
        inside = nearest_inside(free, factor @ positive.T)
        lost = float(free @ free - inside @ inside)
        return found._replace(
            coefficients=inside @ factor, left=found.left + lost, lost=lost / moments.square
        )

    @property
    def noise_variance(self) -> float:
        """Return the most probable noise variance."""
        return self.left / self.posterior.number

    @property
    def log_evidence(self) -> float:
        r"""Return the evidence relative to that of a torque that is all noise.

        .. math:: \log p = -\tfrac n2 \log \frac{y^T (1 + \Phi S^2 \Phi^T)^{-1} y}{y^T y}
                  - \tfrac12 \log|S \Phi^T\Phi S + 1|
        """
        share = self.left / self.square
        return -0.5 * (self.posterior.number * math.log(share) + self.posterior.log_determinant)

    @property
    def by_spread(self) -> Array:
        """Return the derivatives of the log evidence by the logarithms of the spread."""
        strength = (self.posterior.mean / self.spread) ** 2
        return strength / self.noise_variance - self.posterior.determined


def nearest_inside(point: Array, normals: Array) -> Array:
    """Return the nearest point whose products with no column of ``normals`` are negative."""
    if not (point @ normals < 0).any():
        return point
    size, sizes = np.linalg.norm(point), np.linalg.norm(normals, axis=0)
    unit = normals / np.maximum(sizes, np.finfo(float).tiny)
    return np.asarray(point + size * (unit @ scipy.optimize.nnls(unit, -point / size)[0]))


class Prior(NamedTuple):
    r"""Prior of the coefficients: their log standard deviations relative to the noise.

    These are ``offset + design @ parameters`` for columns of unit RMS. That of a family's h-th
    harmonic is :math:`\log\gamma - \nu \log h`; ``decay`` says which parameters are a
    :math:`\nu`. ``first`` (column,) is the column of each family that is not modulated.
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
        families = [(_harmonics(count), True) for count in harmonics]
        families.append((np.zeros(further), False))
        if gain is not None:
            families.append((_harmonics(gain), False))
        designs, decay = [], []
        for order, is_flat in families:
            rows = np.array([(order == 0) & (not is_flat), order > 0, -np.log(order.clip(1))])
            kept = rows.any(axis=1)
            designs.append(rows[kept].T)
            decay.append(np.array([False, False, True])[kept])
        order = np.concatenate([each for each, _ in families])
        first = np.maximum.accumulate(np.where(order == 0, np.arange(len(order)), 0))
        offset = np.concatenate(
            [FLAT_LOG_SIZE * ((order == 0) & is_flat) for order, is_flat in families]
        )
        return cls(offset, block_diag(*designs), np.concatenate(decay), first)

    @property
    def usual(self) -> Array:
        """Return the initial parameters."""
        return np.where(self.decay, DECAY_MEAN, 0.0)

    def scale(self, moments: Moments) -> Array:
        """Return the RMS of the column of each family that is not modulated, (column,)."""
        power = np.maximum(np.diag(moments.gram), 0.0)[self.first] / moments.number
        return np.sqrt(np.where(power > 0, power, 1.0))

    def spread(self, parameters: Array) -> Array:
        """Return the standard deviations relative to the noise, of columns of unit RMS."""
        return np.exp(self.offset + self.design @ parameters)

    def log_density(self, parameters: Array) -> tuple[float, Array]:
        """Return the log density of the parameters, and its gradient."""
        off = np.where(self.decay, (parameters - DECAY_MEAN) / DECAY_SPREAD, 0.0)
        return -0.5 * float(off @ off), -off / DECAY_SPREAD

    def tuned(self, moments: Moments, start: Array) -> Array:
        """Return the parameters of greatest evidence near a start."""
        if not len(start):
            return start

        scale = self.scale(moments)

        def cost(parameters: Array) -> tuple[float, Array]:
            found = Ridge.of(moments, self.spread(parameters) / scale)
            density, slope = self.log_density(parameters)
            return -found.log_evidence - density, -(found.by_spread @ self.design) - slope

        bounds = [DECAY_BOUNDS if is_decay else LOG_SIZE_BOUNDS for is_decay in self.decay]
        options = {"maxiter": MAX_ITERATIONS, "ftol": 1e-9}
        found = scipy.optimize.minimize(
            cost, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options
        )
        return np.asarray(found.x)


def _harmonics(count: int) -> Array:
    """Return the harmonic of each function of a Fourier series: 0, 1, 1, 2, 2 and so on."""
    return np.repeat(np.arange(count + 1.0), 2)[1:]
