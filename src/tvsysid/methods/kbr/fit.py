r"""Fit an impedance beside a smooth external term of the torque.

.. math:: y = X w + T f + e, \qquad e \sim N(0, \sigma^2 I), \qquad
          w \sim N(0, P^{-1}), \qquad f \sim N(0, q^{-1} I)

The numbers of y are the real and imaginary parts of spectra, and :math:`\sigma^2` is the variance
of each: half of that of the complex noise. The cost of equation 16 of van de Ruit et al. 2021 has
no half before the priors, so that a weight has half the variance of its kernel.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import attrs
import numpy as np
from scipy.linalg import blas

from tvsysid.methods.kbr.record import Mask, Record, Sums
from tvsysid.numerics.gaussian import SMALLEST_RESIDUAL, Moments, solve
from tvsysid.signals import Array

CONVERGED = 1e-4  # relative change of the noise variance at which iterations stop
ITERATIONS = 30  # maximum number of noise variances tried
INITIAL_NOISE = 1e-2  # initial noise variance, as a share of the torque's power
SMOOTH_HZ = 0.5  # half width of the window over which the residual's power is averaged
MIN_POWER = 1e-3  # smallest power of the residual in the weights, as a share of the largest


@attrs.frozen(eq=False)
class Fit:
    r"""Posterior of the weights and the noise variance.

    ``factor`` F gives the covariance :math:`\sigma^2 F F^T`. ``effective`` is the effective number
    of parameters.
    """

    mean: Array
    noise_variance: float
    effective: float
    iterations: int
    factor: Array

    @property
    def covariance(self) -> Array:
        """Return the posterior covariance (column, column)."""
        return self.noise_variance * (self.factor @ self.factor.T)


def fit(sums: Sums, precision: Array) -> Fit:
    r"""Fit the weights under a prior precision (column,) and find the noise variance they leave.

    .. math:: \sigma^2 = \frac{\|\hat e\|^2}{N - N_{eff}}

    is a fixed point, found by secants in the logarithm of the noise variance. There, the derivative
    of the evidence by the noise variance vanishes. If the sums have twice as many columns as the
    prior, the second half are instruments (:func:`by_instruments`).
    """
    power = float(sums.products[-1, -1]) / sums.number
    noise, floor = INITIAL_NOISE * power, SMALLEST_RESIDUAL * power
    slope, place_before, gap_before = -1.0, math.nan, math.nan
    for iteration in range(1, ITERATIONS + 1):
        moments, shrinkage = sums.marginal(noise), sums.shrinkage(noise)
        if len(precision) == len(moments.cross):
            found = solve(moments, precision, noise)
            mean, residual, factor = found.mean, found.residual, found.inverse_factor.T
            mixed = sums.mixed[:-1] * shrinkage
            through = blas.dtrmm(1.0, found.inverse_factor, mixed, lower=1)
            effective = found.effective - noise * sums.prior * float(np.sum(through**2))
        else:
            mean, residual, effective, factor = by_instruments(moments, noise * precision)
        # The sums penalize the external terms. Count these among the effective parameters, and
        # take their penalty out of the squared residual.
        terms = shrinkage * (sums.mixed[-1] - mean @ sums.mixed[: len(mean)])
        effective += float(sums.powers @ shrinkage)
        residual -= noise * sums.prior * float(terms @ terms)
        wanted = max(residual / max(sums.number - effective, 1.0), floor)
        place, gap = math.log(noise), math.log(wanted / noise)
        if abs(gap) <= CONVERGED:
            break
        if iteration > 1 and place != place_before:
            slope = (gap - gap_before) / (place - place_before)
        # If the slope of the secant is unusable, take the step of the fixed point.
        step = -gap / slope if slope < -0.1 else gap
        place_before, gap_before = place, gap
        noise = max(math.exp(place + min(max(step, -7.0), 7.0)), floor)
    return Fit(mean, noise, effective, iteration, factor)


def by_instruments(moments: Moments, prior: Array) -> tuple[Array, float, float, Array]:
    r"""Fit regressors X that noise moves, too, by instruments Z in the left factor.

    Return mean, squared residual, effective number of parameters and covariance factor.

    .. math:: A\, \hat w = Z^T M y, \qquad A = Z^T M X + \sigma^2 P, \qquad
              F F^T = A^{-1} (Z^T M Z + \sigma^2 P) A^{-T}

    with M the matrix that takes out the external terms, and ``prior`` the diagonal of
    :math:`\sigma^2 P`. The columns are those of X, then as many of Z. The residual is y - X w.
    """
    gram, cross, square, _ = moments
    gram = np.tril(gram) + np.tril(gram, -1).T
    count, lengths = len(prior), np.sqrt(np.diag(gram))
    x, z = slice(count), slice(count, None)
    units = np.outer(lengths[z], lengths[x])
    inverse = np.linalg.inv((gram[z, x] + np.diag(prior)) / units) / units.T
    mean = inverse @ cross[z]
    residual = square - 2 * float(mean @ cross[x]) + float(mean @ gram[x, x] @ mean)
    factor = inverse @ np.linalg.cholesky(gram[z, z] + np.diag(prior))
    return mean, residual, count - float(prior @ np.diag(inverse)), factor


@attrs.frozen(eq=False)
class KernelPosterior:
    """Posterior of all coefficients of the kernel's features.

    ``fit`` is the posterior of the ``visible`` coefficients. The others are not fitted: they keep
    their prior, with mean 0 and the prior ``precision``. ``visible`` and ``precision`` have the
    shape (signal, column).
    """

    fit: Fit
    visible: Mask
    precision: Array

    @property
    def mean(self) -> Array:
        """Return the posterior mean, shape (coefficient,)."""
        mean = np.zeros(self.visible.size)
        mean[self.visible.ravel()] = self.fit.mean
        return mean

    @property
    def covariance(self) -> Array:
        """Return the posterior covariance, shape (coefficient, coefficient).

        It takes some megabytes. It is therefore calculated on request.
        """
        visible = self.visible.ravel()
        # The constants have no prior; they are always visible.
        prior = np.where(self.precision > 0, self.precision, 1.0)
        covariance = np.diag(1 / prior.ravel())
        covariance[np.ix_(visible, visible)] = self.fit.covariance
        return covariance


def fit_coefficients(record: Record, variances: Array, reweighted: int) -> KernelPosterior:
    """Fit the coefficients that the data can see, with prior ``variances`` (signal,).

    The frequencies are weighted by the residual's power. The weights are updated ``reweighted``
    times.
    """
    rate = record.runs[0].rate
    numbers = max(1.0, record.size * min(record.band[1] / rate, 0.5))
    noise, weights = INITIAL_NOISE * 0.5 * float(record.powers[-1]) / numbers, None
    posterior = _fit_visible(record, variances, noise, weights)
    for _ in range(reweighted):
        weights = residual_weights(record, posterior, weights or record.white)
        posterior = _fit_visible(record, variances, posterior.fit.noise_variance, weights)
    return posterior


def _fit_visible(
    record: Record, variances: Array, noise: float, weights: Sequence[Array] | None
) -> KernelPosterior:
    """Fit the features whose torque can exceed a share of the ``noise`` variance.

    This variance is lowered until it is at most twice that of the fit.
    """
    precision = np.outer(2 / variances, record.kernel.precision)
    largest_weight = max(map(np.max, weights)) if weights else 1.0
    while True:
        visible = record.visible(variances * largest_weight**2, noise)
        has_instrument = len(record.powers) > 4
        chosen = np.concatenate([visible, visible]) if has_instrument else visible
        found = fit(record.sums(chosen, weights), precision[visible])
        if 2 * found.noise_variance >= noise or visible.all():
            return KernelPosterior(found, visible, precision)
        noise = found.noise_variance


def residual_weights(
    record: Record, posterior: KernelPosterior, before: Sequence[Array]
) -> list[Array]:
    """Return weights of each run's frequencies by the residual of a fit with other weights.

    They are inverse to the residual's power, which is a mean within :data:`SMOOTH_HZ` over all
    runs. Its spectrum is mirrored at the ends.
    """
    coefficients = np.append(-posterior.fit.mean, 1.0)
    prior = posterior.fit.noise_variance * record.prior
    powers = []
    for run, white in zip(record.runs, before, strict=True):
        rows = run.rows(record.kernel, posterior.visible)
        left = np.concatenate([coefficients @ each for _, each in rows]) * white
        terms, squares = run.external_terms(white)
        products = terms.view(np.float64) @ left.view(np.float64)
        unexplained = left - products / (squares + prior) @ terms
        powers.append(np.abs(unexplained / white) ** 2)
    frequencies = [run.frequency for run in record.runs]
    at, frequency = max(frequencies, key=len), np.concatenate(frequencies)
    mirrored = np.r_[2 * frequency.min() - frequency, frequency, 2 * frequency.max() - frequency]
    order = np.argsort(mirrored, kind="stable")
    first, last = np.searchsorted(
        mirrored[order], [at - SMOOTH_HZ, np.nextafter(at + SMOOTH_HZ, np.inf)]
    )
    total = np.append(0.0, np.cumsum(np.tile(np.concatenate(powers), 3)[order]))
    power = (total[last] - total[first]) / (last - first)
    power = np.maximum(power, max(MIN_POWER * power.max(), np.finfo(float).tiny))
    power /= power.mean()
    return [1 / np.sqrt(np.interp(run.frequency, at, power)) for run in record.runs]
