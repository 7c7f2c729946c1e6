r"""Fit an impedance with a known prior, and estimate the noise variance.

.. math:: y = X w + e, \qquad e \sim N(0, \sigma^2 I), \qquad w \sim N(0, P^{-1})

The numbers of y are the real and imaginary parts of spectra, and :math:`\sigma^2` is the variance
of each: half of that of the complex noise. The cost of equation 16 of van de Ruit et al. 2021 has
no half before the priors, so that a weight has half the variance of its kernel.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tvsysid.numerics.gaussian import SMALLEST_RESIDUAL, FittedWeights, Moments, solve
from tvsysid.signals import Array

CONVERGED = 1e-5  # relative change of the noise variance at which iterations stop
ITERATIONS = 50  # maximum number of noise variances tried
INITIAL_NOISE = 1e-2  # initial noise variance, as a share of the torque's power


def fit(moments: Moments, precision: Array) -> FittedWeights:
    r"""Fit the weights under a prior precision (column,) and find the noise variance they leave.

    .. math:: \sigma^2 = \frac{\|\hat e\|^2}{N - N_{eff}}

    At this fixed point the derivative of the evidence by the noise variance vanishes. If the
    moments have twice as many columns as the prior, the second half are instruments
    (:func:`by_instruments`).
    """
    power = moments.square / moments.number
    noise = INITIAL_NOISE * power
    fitted = solve if len(precision) == len(moments.cross) else by_instruments
    for _ in range(ITERATIONS):
        found = fitted(moments, precision, noise)
        left = found.residual / max(moments.number - found.effective, 1.0)
        wanted = max(left, SMALLEST_RESIDUAL * power)
        if abs(wanted - noise) <= CONVERGED * noise:
            break
        noise = wanted
    return FittedWeights(found.mean, found.covariance, noise, found.effective)


class InstrumentalFit(NamedTuple):
    """Weights, their covariance, sum of squared residuals and effective number of parameters."""

    mean: Array
    covariance: Array
    residual: float
    effective: float


def by_instruments(moments: Moments, precision: Array, noise_variance: float) -> InstrumentalFit:
    r"""Fit regressors X that noise moves, too, by instruments Z in the left factor.

    .. math:: A\, \hat w = Z^T y, \qquad A = Z^T X + \sigma^2 P, \qquad
              C = \sigma^2 A^{-1} (Z^T Z + \sigma^2 P) A^{-T}

    with P the prior precision and C the covariance. The columns are those of X, then as many of Z.
    The residual is y - X w.
    """
    gram, cross, square, _ = moments
    gram = np.tril(gram) + np.tril(gram, -1).T
    count, lengths, prior = len(precision), np.sqrt(np.diag(gram)), noise_variance * precision
    x, z = slice(count), slice(count, None)
    units = np.outer(lengths[z], lengths[x])
    inverse = np.linalg.inv((gram[z, x] + np.diag(prior)) / units) / units.T
    mean = inverse @ cross[z]
    covariance = noise_variance * inverse @ (gram[z, z] + np.diag(prior)) @ inverse.T
    residual = square - 2 * float(mean @ cross[x]) + float(mean @ gram[x, x] @ mean)
    return InstrumentalFit(mean, covariance, residual, count - float(prior @ np.diag(inverse)))
