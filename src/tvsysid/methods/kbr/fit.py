"""Weights of kernel-based regression, with the noise variance that they leave."""

from __future__ import annotations

import numpy as np

from tvsysid.numerics.gaussian import (
    SMALLEST_RESIDUAL,
    FittedWeights,
    Moments,
    Posterior,
    by_instruments,
    solve,
)
from tvsysid.signals import Array

CONVERGED = 1e-5  # relative change of the noise variance at which iterations stop
ITERATIONS = 50  # maximum number of noise variances tried
INITIAL_NOISE = 1e-2  # initial noise variance, as a share of the torque's power


def fitted_weights(moments: Moments, precision: Array) -> FittedWeights:
    r"""Fit the weights under a prior precision (column,) and find the noise variance they leave.

    .. math:: y = X w + e, \qquad e \sim N(0, \sigma^2 I), \qquad w \sim N(0, P^{-1}), \qquad
              \sigma^2 = \frac{\|\hat e\|^2}{N - N_{eff}}

    At this fixed point the derivative of the evidence by the noise variance vanishes. The numbers
    of y are real and imaginary parts, so :math:`\sigma^2` is half the variance of complex noise.

    If the moments have twice as many columns as the prior, the second half are instruments
    (:func:`weights_by_instruments`).
    """
    has_instruments = len(moments.cross) > len(precision)
    power = moments.square / moments.number
    noise = INITIAL_NOISE * power
    found: Posterior | FittedWeights
    for _ in range(ITERATIONS):
        if has_instruments:
            found = weights_by_instruments(moments, precision, noise)
            variance = found.noise_variance
        else:
            found = posterior = solve(moments, precision, noise)
            variance = posterior.residual / max(moments.number - posterior.effective, 1.0)
        wanted = max(variance, SMALLEST_RESIDUAL * power)
        if abs(wanted - noise) <= CONVERGED * noise:
            break
        noise = wanted
    covariance = found.covariance * (noise / found.noise_variance)
    return FittedWeights(found.mean, covariance, noise, found.effective)


def weights_by_instruments(moments: Moments, precision: Array, noise: float) -> FittedWeights:
    """Fit the weights by instruments, under a prior and for an assumed noise variance.

    The ``moments`` are those of the columns, then of the instruments. The returned noise variance
    is that of the residual (:func:`tvsysid.numerics.gaussian.by_instruments`).
    """
    gram, cross, square, number = moments
    gram = np.tril(gram) + np.tril(gram, -1).T
    count = len(precision)
    x, z = slice(count), slice(count, None)
    posterior = solve(moments.take(np.arange(count, 2 * count)), precision, noise)

    def residual(mean: Array) -> float:
        return square - float(mean @ (2 * cross[x] - gram[x, x] @ mean))

    fit = FittedWeights(posterior.mean, posterior.covariance, noise, posterior.effective)
    return by_instruments(fit, gram[z, x] - gram[z, z], residual, number)
