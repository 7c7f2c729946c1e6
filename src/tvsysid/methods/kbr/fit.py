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

from tvsysid.methods.kbr.kernel import Kernel
from tvsysid.methods.kbr.record import WHITE, Mask, NoiseSpectrum, Record, Sums
from tvsysid.numerics.gaussian import SMALLEST_RESIDUAL, solve
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
    by = by_regressors if len(precision) == len(sums.moments.cross) else by_instruments
    number, power = sums.moments.number, sums.moments.square / sums.moments.number
    noise, floor = GUESS * power, SMALLEST_RESIDUAL * power
    slope, place_before, gap_before = -1.0, math.nan, math.nan
    for iteration in range(1, ITERATIONS + 1):
        mean, residual, effective, factor = by(sums, precision, noise)
        effective += float(sums.powers @ sums.shrinkage(noise))
        residual -= sums.prior_cost(mean, noise)
        wanted = max(residual / max(number - effective, 1.0), floor)
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


def by_regressors(sums: Sums, precision: Array, noise: float) -> tuple[Array, float, float, Array]:
    """Return mean, squared residual, effective number and factor at a noise variance.

    The external terms count with what they take from the residual, not as parameters.
    """
    found = solve(sums.marginal(noise), precision, noise)
    mixed = sums.mixed * sums.shrinkage(noise)
    through = blas.dtrmm(1.0, found.inverse_factor, mixed, lower=1)
    effective = found.effective - noise * sums.prior * float(np.sum(through**2))
    return found.mean, found.residual, effective, found.inverse_factor.T


def by_instruments(sums: Sums, precision: Array, noise: float) -> tuple[Array, float, float, Array]:
    r"""Return the same of regressors X that noise moves, too, by instruments Z in the left factor.

    .. math:: A\, \hat w = Z^T M y, \qquad A = Z^T M X + \sigma^2 P, \qquad
              F F^T = A^{-1} (Z^T M Z + \sigma^2 P) A^{-T}

    with M the matrix that takes out the external terms. The columns of ``sums`` are those of X,
    then as many of Z. The residual is y - X w.
    """
    gram, cross, square, _ = sums.marginal(noise)
    gram = np.tril(gram) + np.tril(gram, -1).T
    prior, count, lengths = noise * precision, len(precision), np.sqrt(np.diag(gram))
    x, z = slice(count), slice(count, None)
    units = np.outer(lengths[z], lengths[x])
    inverse = np.linalg.inv((gram[z, x] + np.diag(prior)) / units) / units.T
    mean = inverse @ cross[z]
    residual = square - 2 * float(mean @ cross[x]) + float(mean @ gram[x, x] @ mean)
    factor = inverse @ np.linalg.cholesky(gram[z, z] + np.diag(prior))
    return mean, residual, count - float(prior @ np.diag(inverse)), factor


@attrs.frozen(eq=False)
class KernelPosterior:
    """Posterior of all coefficients: of those fitted, and by the prior alone of the others.

    ``fit`` is that of the coefficients ``visible``, mask (coefficient, column). The other
    coefficients have no effect that the data can show. For them the prior is all that is known:
    its ``variances`` (coefficient,).
    """

    fit: Fit
    visible: Mask
    kernel: Kernel
    variances: Array

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
        precision, visible = self.kernel.precision, self.visible.ravel()
        unseen = np.divide(0.5, precision, out=np.zeros_like(precision), where=precision > 0)
        covariance = np.diag(np.outer(self.variances, unseen).ravel())
        covariance[np.ix_(visible, visible)] = self.fit.covariance
        return covariance


def fit_coefficients(
    record: Record, kernel: Kernel, variances: Array, reweighted: int = 0
) -> KernelPosterior:
    """Fit the coefficients that the data can see, with prior ``variances`` (coefficient,).

    The frequencies are weighted by the residual's spectrum. The weights are updated ``reweighted``
    times.
    """
    runs = record.stacks[0]
    bins = max(1.0, record.size * min(runs.band[1] / runs.rate, 0.5))
    noise = GUESS * 0.5 * float(record.powers[-1]) / bins
    posterior, spectrum = _fit_visible(record, kernel, variances, noise, WHITE), WHITE
    for _ in range(reweighted):
        spectrum = residual_spectrum(record, posterior, spectrum)
        noise = posterior.fit.noise_variance
        posterior = _fit_visible(record, kernel, variances, noise, spectrum)
    return posterior


def _fit_visible(
    record: Record, kernel: Kernel, variances: Array, noise: float, spectrum: NoiseSpectrum
) -> KernelPosterior:
    """Fit the features that exceed a part of the noise, which is lowered until the fit has it."""
    order, has_instrument = len(variances), len(record.powers) > 4
    powers = variances * record.powers[:order] / spectrum.power.min()
    while True:
        visible = kernel.visible(powers, noise)
        lower = np.zeros((3 - order, kernel.columns), dtype=bool)
        chosen = np.concatenate([visible, lower, visible]) if has_instrument else visible
        precision = np.outer(2 / variances, kernel.precision)[visible]
        found = fit(record.sums(kernel, chosen, spectrum), precision)
        if 2 * found.noise_variance >= noise or visible.all():
            return KernelPosterior(found, visible, kernel, variances)
        noise = found.noise_variance


def residual_spectrum(
    record: Record, posterior: KernelPosterior, before: NoiseSpectrum
) -> NoiseSpectrum:
    """Return the spectrum of the torque's residual after a fit under the spectrum ``before``.

    The power at a frequency is a mean within :data:`SMOOTH_HZ`.
    """
    weights = np.append(-posterior.fit.mean, 1.0)
    prior = posterior.fit.noise_variance * record.prior
    spectra = []
    for runs in record.stacks:
        blocks = runs.rows(posterior.kernel, posterior.visible)
        left = np.concatenate([np.tensordot(weights, rows, axes=1) for _, rows in blocks], axis=1)
        white = before.weights(runs.frequency)
        terms, powers = runs.external_terms(white)
        left *= white
        products = left.view(np.float64) @ terms.view(np.float64).T
        left -= products / (powers + prior) @ terms
        power = np.sum(np.abs(left) ** 2, axis=0) / white**2
        spectra.append((runs.frequency, power, np.full_like(power, len(left))))
    at = max((frequency for frequency, _, _ in spectra), key=len)
    frequency, *parts = np.concatenate(spectra, axis=1)
    # The spectrum is mirrored at its ends.
    mirrored = np.r_[2 * frequency.min() - frequency, frequency, 2 * frequency.max() - frequency]
    order = np.argsort(mirrored, kind="stable")
    ends = np.searchsorted(mirrored[order], [at - SMOOTH_HZ, np.nextafter(at + SMOOTH_HZ, np.inf)])
    totals = np.pad(np.cumsum(np.tile(parts, 3)[:, order], axis=1), ((0, 0), (1, 0)))
    powers, counts = totals[:, ends[1]] - totals[:, ends[0]]
    power = powers / counts
    power = np.maximum(power, max(FLOOR * power.max(), np.finfo(float).tiny))
    return NoiseSpectrum(at, power / power.mean())
