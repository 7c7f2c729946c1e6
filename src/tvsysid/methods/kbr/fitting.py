r"""Fit an impedance beside a smooth external term of the torque.

.. math:: y = X w + T f + e, \qquad
          \min_{w, f} \frac{\|e\|^2}{\sigma^2} + w^T P w + q f^T f

The numbers of y are the real and imaginary parts of spectra, and :math:`\sigma^2` is the variance
of the complex noise: each part has half of it. The cost of equation 16 of van de Ruit et al. 2021
has no half before the priors, so that a weight has half the variance of its kernel.
"""

from __future__ import annotations

import math
from functools import partial

import attrs
import numpy as np
from scipy.linalg import blas

from tvsysid.methods.kbr.kernel import Kernel
from tvsysid.methods.kbr.record import (
    WHITE,
    Mask,
    NoiseSpectrum,
    Record,
    Sums,
    clocks_of,
)
from tvsysid.methods.shared.residuals import PosteriorErrors
from tvsysid.models import StandardError
from tvsysid.numerics.gaussian import SMALLEST_RESIDUAL, Moments, Posterior, solve
from tvsysid.signals import Array, Ensemble

CONVERGED = 1e-4  # relative change of the noise variance; another step changes 1e-4 of it
ITERATIONS = 30  # noise variances tried at most
# share of the noise that the torque of a feature must be able to reach for it to be fitted
VISIBLE = 0.03
# share of the torque's power that the noise is taken to have at least, until it is known
GUESS = 1e-2
SMOOTH_HZ = 0.5  # to either side, over which the residual's power is averaged
FLOOR = 1e-3  # share of the largest power below which none is taken to lie


def posterior_at(moments: Moments, precision: Array, noise: float) -> Posterior:
    """Return the posterior for prior precisions P and a variance of the complex noise."""
    return solve(moments, 2 * precision, 0.5 * noise)


@attrs.frozen(eq=False)
class Fit:
    r"""Posterior of the weights and the noise variance.

    ``factor`` F gives the covariance :math:`\tfrac12 \sigma^2 F F^T`. ``effective`` is the
    effective number of parameters.
    """

    mean: Array
    noise_variance: float
    effective: float
    iterations: int
    factor: Array

    @property
    def covariance(self) -> Array:
        """Return the posterior covariance (column, column)."""
        return 0.5 * self.noise_variance * (self.factor @ self.factor.T)


def fit(sums: Sums, precision: Array) -> Fit:
    r"""Fit the weights under a prior precision (column,) and find the noise variance they leave.

    .. math:: \sigma^2 = \frac{2 \|\hat e\|^2}{N - N_{eff}}

    is a fixed point, found by secants in the logarithm of the noise variance. There, the derivative
    of the evidence by the noise variance vanishes.
    """
    (noise, floor), slope, before = _first_noise(sums.moments), -1.0, None
    for iteration in range(1, ITERATIONS + 1):
        found, shrinkage = (
            posterior_at(sums.marginal(noise), precision, noise),
            sums.shrinkage(noise),
        )
        residual = found.residual - sums.prior_cost(found.mean, noise)
        through = blas.dtrmm(1.0, found.inverse_factor, sums.mixed * shrinkage, lower=1)
        spread = float(shrinkage.sum()) + float(np.sum(through**2))
        effective = found.effective + len(shrinkage) - noise * sums.prior * spread
        wanted = max(2 * residual / max(sums.moments.number - effective, 1.0), floor)
        place, gap = math.log(noise), math.log(wanted / noise)
        if abs(gap) <= CONVERGED:
            break
        if before is not None and place != before[0]:
            slope = (gap - before[1]) / (place - before[0])
        # Where the secant is no help, the plain step.
        step = -gap / slope if slope < -0.1 else gap
        before = place, gap
        noise = max(math.exp(place + min(max(step, -7.0), 7.0)), floor)
    return Fit(found.mean, noise, effective, iteration, found.inverse_factor.T)


def instrumental_fit(sums: Sums, precision: Array) -> Fit:
    r"""Fit regressors X that noise moves, too, by instruments Z in their place in the left factor.

    .. math:: A\, \hat w = Z^T M y, \qquad A = Z^T M X + \sigma^2 P, \qquad
              F F^T = A^{-1} (Z^T M Z + \sigma^2 P) A^{-T}

    with M the matrix that takes out the external terms. The columns of ``sums`` are those of X,
    then as many of Z. The noise variance is that of y - X w.
    """
    count, (noise, floor) = len(precision), _first_noise(sums.moments)
    for iteration in range(1, ITERATIONS + 1):
        gram, cross, square, number = sums.marginal(noise)
        gram = np.tril(gram) + np.tril(gram, -1).T
        prior, lengths = noise * precision, np.sqrt(np.diag(gram))
        units = np.outer(lengths[count:], lengths[:count])
        inverse = np.linalg.inv((gram[count:, :count] + np.diag(prior)) / units) / units.T
        mean = inverse @ cross[count:]
        residual = square - 2 * float(mean @ cross[:count])
        residual += float(mean @ gram[:count, :count] @ mean) - sums.prior_cost(mean, noise)
        of_terms = float(sums.powers @ sums.shrinkage(noise))
        effective = count - float(prior @ np.diag(inverse)) + of_terms
        before, noise = noise, max(2 * residual / max(number - effective, 1.0), floor)
        if abs(noise / before - 1) <= CONVERGED:
            break
    spread = gram[count:, count:] + np.diag(noise * precision)
    return Fit(mean, noise, effective, iteration, inverse @ np.linalg.cholesky(spread))


def _first_noise(moments: Moments) -> tuple[float, float]:
    """Return the noise variance at which a search begins, and the one that is rounding."""
    power = moments.square / moments.number
    return 0.02 * power, 2 * SMALLEST_RESIDUAL * power


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
    noise, spectrum = GUESS * 0.5 * float(record.powers[-1]) / bins, WHITE
    posterior = _fit_visible(record, kernel, variances, noise, spectrum)
    for _ in range(reweighted):
        spectrum = residual_spectrum(record, posterior, spectrum)
        noise = 0.5 * posterior.fit.noise_variance
        posterior = _fit_visible(record, kernel, variances, noise, spectrum)
    return posterior


def _fit_visible(
    record: Record, kernel: Kernel, variances: Array, noise: float, spectrum: NoiseSpectrum
) -> KernelPosterior:
    """Fit the features that exceed a part of the noise, which is lowered until the fit has it."""
    order, has_instrument = len(variances), len(record.powers) > 4
    powers = variances * record.powers[:order] / spectrum.power.min()
    while True:
        visible = kernel.visible(powers, VISIBLE * noise)
        lower = np.zeros((3 - order, kernel.columns), dtype=bool)
        chosen = np.concatenate([visible, lower, visible]) if has_instrument else visible
        sums = record.sums(kernel, chosen, spectrum)
        precision = np.outer(1 / variances, kernel.precision)[visible]
        found = (instrumental_fit if has_instrument else fit)(sums, precision)
        if found.noise_variance >= noise or visible.all():
            return KernelPosterior(found, visible, kernel, variances)
        noise = 0.5 * found.noise_variance


def residual_spectrum(
    record: Record, posterior: KernelPosterior, before: NoiseSpectrum
) -> NoiseSpectrum:
    """Return the spectrum of the torque's residual after a fit under the spectrum ``before``."""
    weights = np.append(-posterior.fit.mean, 1.0)
    prior = posterior.fit.noise_variance * record.prior
    spectra = []
    for runs in record.stacks:
        blocks = runs.rows(posterior.kernel, posterior.visible)
        left = np.concatenate([np.tensordot(weights, rows, axes=1) for _, rows in blocks], axis=1)
        terms = runs.external_terms
        white = before.weights(runs.frequency)
        seen, target = ((each * white).view(np.float64) for each in (terms, left))
        system = seen @ seen.T + prior * np.eye(len(terms))
        left -= np.linalg.solve(system, seen @ target.T).T @ terms
        power = np.sum(np.abs(left) ** 2, axis=0)
        spectra.append((runs.frequency, power, np.full_like(power, len(left))))
    at = max((frequency for frequency, _, _ in spectra), key=len)
    frequency, power, count = map(np.concatenate, zip(*spectra, strict=True))
    power = smoothed(frequency, power, count, at)
    power = np.maximum(power, max(FLOOR * power.max(), np.finfo(float).tiny))
    return NoiseSpectrum(at, power / power.mean())


def smoothed(frequency: Array, power: Array, count: Array, at: Array) -> Array:
    """Return the mean power within :data:`SMOOTH_HZ` of each frequency of ``at``.

    Each ``power`` is a sum of ``count`` squares. The spectrum is mirrored at its ends.
    """
    low, high = frequency.min(), frequency.max()
    mirrored = np.concatenate([2 * low - frequency, frequency, 2 * high - frequency])
    order = np.argsort(mirrored, kind="stable")
    first = np.searchsorted(mirrored[order], at - SMOOTH_HZ, "left")
    last = np.searchsorted(mirrored[order], at + SMOOTH_HZ, "right")
    powers, counts = (np.r_[0.0, np.cumsum(np.tile(each, 3)[order])] for each in (power, count))
    return np.asarray((powers[last] - powers[first]) / (counts[last] - counts[first]))


def times_of(ensemble: Ensemble, kernel: Kernel) -> Array:
    """Return the times in s of each realization, shape (realization, 2, time).

    The first row counts from the trial's time 0, the second is the record's clock. Where all
    realizations have the same impedance, only the first is returned.
    """
    assert ensemble.onsets is not None
    phases = np.round(ensemble.onsets % kernel.period, 9) % kernel.period
    starts = np.stack([ensemble.onsets, clocks_of(ensemble)], axis=1)
    some = starts[:1] if kernel.decay is None and np.ptp(phases) < 1e-9 else starts
    return np.asarray(some[..., None] + ensemble.time)


def impedance_over(ensemble: Ensemble, kernel: Kernel, coefficients: Array) -> Array:
    """Return stiffness, viscosity and inertia at :func:`times_of`, shape (realization, time, 3).

    A model of an order below 2 has zeros for its missing quantities.
    """
    phase, clock = np.moveaxis(times_of(ensemble, kernel), 1, 0)
    periodic, slow = kernel.periodic_features(phase), kernel.slow_features(clock)
    weights = np.zeros((slow.shape[-1], periodic.shape[-1], 3))
    for signal, of_signal in enumerate(coefficients.reshape(-1, kernel.columns)):
        weights[kernel.slow, kernel.place, signal] = of_signal
    return np.asarray(np.einsum("...h,...hm->...m", periodic, np.tensordot(slow, weights, 1)))


@attrs.frozen(eq=False)
class KernelErrors:
    """Standard errors of sums of features, averaged over realizations.

    The features are calculated on request. ``times`` are those of :func:`times_of`.
    ``of_noise`` makes the errors from expansions and covariances.
    """

    posterior: KernelPosterior
    times: Array
    of_noise: partial[PosteriorErrors]

    def standard_errors(self) -> dict[str, StandardError]:
        """Return the standard error of each quantity, by its name."""
        kernel, covariance = self.posterior.kernel, self.posterior.covariance
        features = sum(kernel(*each) for each in self.times) / len(self.times)
        count, columns = len(self.posterior.variances), kernel.columns
        blocks = covariance.reshape(count, columns, count, columns)
        covariances = tuple(blocks[number, :, number] for number in range(count))
        return self.of_noise((features,) * count, covariances).standard_errors()
