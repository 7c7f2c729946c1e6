r"""Fit a torque that contains a smooth external term besides the impedance.

.. math:: y = X w + T f + e, \qquad
          \min_{w, f} \frac{\|e\|^2}{\sigma^2} + w^T P w + q f^T f

The numbers of y are the real and imaginary parts of spectra, and :math:`\sigma^2` is the variance
of the complex noise: each part has half of it. The cost of equation 16 of van de Ruit et al. 2021
has no half before the priors, so that a weight has half the variance of its kernel.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import attrs
import numpy as np
from scipy.linalg import blas

from tvsysid.numerics import Array
from tvsysid.numerics.gaussian import SMALLEST_RESIDUAL, Moments, Posterior, solve

CONVERGED = 1e-4  # relative change of the noise variance; another step changes 1e-4 of it
ITERATIONS = 30  # noise variances tried at most


class Sums(NamedTuple):
    """Moments of regressors and torque, and their products with the external terms.

    ``mixed`` is XᵀT, ``cross`` Tᵀy and ``powers`` the diagonal of TᵀT; the terms are orthogonal.
    ``prior`` is q, the prior precision of each term.
    """

    moments: Moments
    mixed: Array
    cross: Array
    powers: Array
    prior: float

    def shrinkage(self, noise: float) -> Array:
        r"""Return :math:`(T^T T + \sigma^2 q)^{-1}`, shape (term,)."""
        return 1 / (self.powers + noise * self.prior)

    def marginal(self, noise: float) -> Moments:
        """Return the moments with the external terms integrated out for this noise variance."""
        gram, cross, square, number = self.moments
        shrinkage = self.shrinkage(noise)
        mixed = self.mixed * np.sqrt(shrinkage)
        return Moments(
            blas.dsyrk(-1.0, mixed, beta=1.0, c=gram, lower=1),
            cross - self.mixed @ (shrinkage * self.cross),
            square - float(shrinkage @ self.cross**2),
            number,
        )

    def prior_cost(self, mean: Array, noise: float) -> float:
        r"""Return :math:`\sigma^2 q f^T f` for the external terms beside given weights."""
        terms = self.shrinkage(noise) * (self.cross - mean @ self.mixed[: len(mean)])
        return noise * self.prior * float(terms @ terms)

    @property
    def floor(self) -> float:
        """Return the noise variance that is rounding."""
        return 2 * SMALLEST_RESIDUAL * self.moments.square / self.moments.number

    @property
    def first_noise(self) -> float:
        """Return the noise variance at which the search begins."""
        return max(0.02 * self.moments.square / self.moments.number, self.floor)


@attrs.frozen(eq=False)
class Fit:
    r"""Posterior of the weights and the noise variance.

    The covariance is :math:`\tfrac12 \sigma^2 A^{-1} S A^{-T}`, with A^{-1} the ``inverse`` and
    S the ``spread``, or one. ``effective`` is the effective number of parameters.
    """

    mean: Array
    noise_variance: float
    effective: float
    iterations: int
    inverse: Array
    spread: Array | None = None

    @property
    def covariance(self) -> Array:
        """Return the posterior covariance (column, column)."""
        inner = self.inverse if self.spread is None else self.inverse @ self.spread
        return np.asarray(0.5 * self.noise_variance * inner @ self.inverse.T)


def posterior_at(moments: Moments, precision: Array, noise: float) -> Posterior:
    """Return the posterior for prior precisions P and a variance of the complex noise."""
    return solve(moments, 2 * precision, 0.5 * noise)


def fit(sums: Sums, precision: Array) -> Fit:
    r"""Fit the weights under a prior precision (column,) and find the noise variance they leave.

    .. math:: \sigma^2 = \frac{2 \|\hat e\|^2}{N - N_{eff}}

    is a fixed point, found by secants in the logarithm of the noise variance. There, the derivative
    of the evidence by the noise variance vanishes.
    """
    number, noise = sums.moments.number, sums.first_noise
    slope, before = -1.0, None
    for iteration in range(1, ITERATIONS + 1):
        found = posterior_at(sums.marginal(noise), precision, noise)
        residual = found.residual - sums.prior_cost(found.mean, noise)
        shrinkage = sums.shrinkage(noise)
        through = blas.dtrmm(1.0, found.inverse_factor, sums.mixed * shrinkage, lower=1)
        spread = float(shrinkage.sum()) + float(np.sum(through**2))
        effective = found.effective + len(shrinkage) - noise * sums.prior * spread
        wanted = max(2 * residual / max(number - effective, 1.0), sums.floor)
        place, gap = math.log(noise), math.log(wanted / noise)
        if abs(gap) <= CONVERGED:
            break
        if before is not None and place != before[0]:
            slope = (gap - before[1]) / (place - before[0])
        # Where the secant is no help, the plain step.
        step = -gap / slope if slope < -0.1 else gap
        before = place, gap
        noise = max(math.exp(place + min(max(step, -7.0), 7.0)), sums.floor)
    return Fit(found.mean, noise, effective, iteration, found.inverse_factor.T)


def instrumental(sums: Sums, precision: Array) -> Fit:
    r"""Fit regressors X that noise moves, too, by instruments Z in their place in the left factor.

    .. math:: A\, \hat w = Z^T M y, \qquad A = Z^T M X + \sigma^2 P, \qquad
              S = Z^T M Z + \sigma^2 P

    with M the matrix that takes out the external terms. The columns of ``sums`` are those of X,
    then as many of Z. The noise variance is that of y - X w.
    """
    count, number, noise = len(precision), sums.moments.number, sums.first_noise
    for iteration in range(1, ITERATIONS + 1):
        gram, cross, square, _ = sums.marginal(noise)
        gram = np.tril(gram) + np.tril(gram, -1).T
        prior = noise * precision
        scale = np.sqrt(np.diag(gram))
        scaled = np.outer(1 / scale[count:], 1 / scale[:count])
        inverse = scaled.T * np.linalg.inv(scaled * (gram[count:, :count] + np.diag(prior)))
        mean = inverse @ cross[count:]
        residual = square - 2 * float(mean @ cross[:count])
        residual += float(mean @ gram[:count, :count] @ mean) - sums.prior_cost(mean, noise)
        of_terms = float(np.sum(sums.powers * sums.shrinkage(noise)))
        effective = count - float(prior @ np.diag(inverse)) + of_terms
        before, noise = noise, max(2 * residual / max(number - effective, 1.0), sums.floor)
        if abs(noise / before - 1) <= CONVERGED:
            break
    spread = gram[count:, count:] + np.diag(noise * precision)
    return Fit(mean, noise, effective, iteration, inverse, spread)
