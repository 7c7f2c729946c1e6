r"""Fit an impedance beside a smooth external term of the torque.

.. math:: y = X w + T f + e, \qquad e \sim N(0, \sigma^2 I), \qquad
          w \sim N(0, P^{-1}), \qquad f \sim N(0, q^{-1} I)

The numbers of y are the real and imaginary parts of spectra, and :math:`\sigma^2` is the variance
of each: half of that of the complex noise. The cost of equation 16 of van de Ruit et al. 2021 has
no half before the priors, so that a weight has half the variance of its kernel.
"""

from __future__ import annotations

import math

import attrs
import numpy as np
from scipy.linalg import blas

from tvsysid.methods.kbr.record import WHITE, Mask, NoiseSpectrum, Record, Sums
from tvsysid.numerics.gaussian import SMALLEST_RESIDUAL, Moments, solve
from tvsysid.signals import Array

CONVERGED = 1e-4  # relative change of the noise variance; another step changes 1e-4 of it
ITERATIONS = 30  # noise variances tried at most
# share of the torque's power that the noise is taken to have at least, until it is known
GUESS = 1e-2
SMOOTH_HZ = 0.5  # to either side, over which the residual's power is averaged
FLOOR = 1e-3  # share of the largest power below which none is taken to lie


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
    by = by_regressors if len(precision) == len(sums.products) - 1 else by_instruments
    power = float(sums.products[-1, -1]) / sums.number
    noise, floor = GUESS * power, SMALLEST_RESIDUAL * power
    slope, place_before, gap_before = -1.0, math.nan, math.nan
    for iteration in range(1, ITERATIONS + 1):
        mean, residual, effective, factor = by(sums, sums.marginal(noise), precision, noise)
        # The external terms count with what they take from the residual, not as parameters.
        shrinkage = sums.shrinkage(noise)
        terms = shrinkage * (sums.mixed[-1] - mean @ sums.mixed[: len(mean)])
        effective += float(sums.powers @ shrinkage)
        residual -= noise * sums.prior * float(terms @ terms)
        wanted = max(residual / max(sums.number - effective, 1.0), floor)
        place, gap = math.log(noise), math.log(wanted / noise)
        if abs(gap) <= CONVERGED:
            break
        if iteration > 1 and place != place_before:
            slope = (gap - gap_before) / (place - place_before)
        # Where the secant is no help, the plain step.
        step = -gap / slope if slope < -0.1 else gap
        place_before, gap_before = place, gap
        noise = max(math.exp(place + min(max(step, -7.0), 7.0)), floor)
    return Fit(mean, noise, effective, iteration, factor)


def by_regressors(
    sums: Sums, moments: Moments, precision: Array, noise: float
) -> tuple[Array, float, float, Array]:
    """Return mean, squared residual, effective number and factor at a noise variance."""
    found = solve(moments, precision, noise)
    mixed = sums.mixed[:-1] * sums.shrinkage(noise)
    through = blas.dtrmm(1.0, found.inverse_factor, mixed, lower=1)
    effective = found.effective - noise * sums.prior * float(np.sum(through**2))
    return found.mean, found.residual, effective, found.inverse_factor.T


def by_instruments(
    sums: Sums, moments: Moments, precision: Array, noise: float
) -> tuple[Array, float, float, Array]:
    r"""Return the same of regressors X that noise moves, too, by instruments Z in the left factor.

    .. math:: A\, \hat w = Z^T M y, \qquad A = Z^T M X + \sigma^2 P, \qquad
              F F^T = A^{-1} (Z^T M Z + \sigma^2 P) A^{-T}

    with M the matrix that takes out the external terms. The columns of ``sums`` are those of X,
    then as many of Z. The residual is y - X w.
    """
    gram, cross, square, _ = moments
    gram = np.tril(gram) + np.tril(gram, -1).T
    prior, count, lengths = np.diag(noise * precision), len(precision), np.sqrt(np.diag(gram))
    x, z = slice(count), slice(count, None)
    units = np.outer(lengths[z], lengths[x])
    inverse = np.linalg.inv((gram[z, x] + prior) / units) / units.T
    mean = inverse @ cross[z]
    residual = square - 2 * float(mean @ cross[x]) + float(mean @ gram[x, x] @ mean)
    factor = inverse @ np.linalg.cholesky(gram[z, z] + prior)
    return mean, residual, count - float(np.sum(prior * inverse.T)), factor


@attrs.frozen(eq=False)
class KernelPosterior:
    """Posterior of all coefficients: of those fitted, and by the prior alone of the others.

    ``fit`` is that of the ``visible`` coefficients. The data say nothing of the others, which have
    their prior ``precision``. Both have the shape (signal, column).
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


def fit_coefficients(record: Record, variances: Array, reweighted: int = 0) -> KernelPosterior:
    """Fit the coefficients that the data can see, with prior ``variances`` (signal,).

    The frequencies are weighted by the residual's spectrum. The weights are updated ``reweighted``
    times.
    """
    rate = record.runs[0].rate
    numbers = max(1.0, record.size * min(record.band[1] / rate, 0.5))
    noise, spectrum = GUESS * 0.5 * float(record.powers[-1]) / numbers, WHITE
    posterior = _fit_visible(record, variances, noise, spectrum)
    for _ in range(reweighted):
        spectrum = residual_spectrum(record, posterior, spectrum)
        posterior = _fit_visible(record, variances, posterior.fit.noise_variance, spectrum)
    return posterior


def _fit_visible(
    record: Record, variances: Array, noise: float, spectrum: NoiseSpectrum
) -> KernelPosterior:
    """Fit the features that exceed a part of the noise, which is lowered until the fit has it."""
    precision = np.outer(2 / variances, record.kernel.precision)
    has_instrument = len(record.powers) > 4
    while True:
        visible = record.visible(variances / spectrum.power.min(), noise)
        chosen = np.concatenate([visible, visible]) if has_instrument else visible
        found = fit(record.sums(chosen, spectrum), precision[visible])
        if 2 * found.noise_variance >= noise or visible.all():
            return KernelPosterior(found, visible, precision)
        noise = found.noise_variance


def residual_spectrum(
    record: Record, posterior: KernelPosterior, before: NoiseSpectrum
) -> NoiseSpectrum:
    """Return the spectrum of the torque's residual after a fit under the spectrum ``before``.

    The power at a frequency is a mean within :data:`SMOOTH_HZ`, over all runs. The spectrum is
    mirrored at its ends.
    """
    weights = np.append(-posterior.fit.mean, 1.0)
    prior = posterior.fit.noise_variance * record.prior
    powers = []
    for run in record.runs:
        rows = run.rows(record.kernel, posterior.visible)
        white = before.weights(run.frequency)
        left = np.concatenate([weights @ each for _, each in rows]) * white
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
    power = np.maximum(power, max(FLOOR * power.max(), np.finfo(float).tiny))
    return NoiseSpectrum(at, power / power.mean())
