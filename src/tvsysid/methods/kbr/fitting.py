"""Fit the features that the data can see, and evaluate the impedance that they make."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import attrs
import numpy as np

from tvsysid.methods.kbr.external import Fit, fit, instrumental
from tvsysid.methods.kbr.kernel import VISIBLE, Kernel, harmonic_features
from tvsysid.methods.kbr.record import WHITE, Chosen, NoiseSpectrum, Record, clocks_of
from tvsysid.methods.shared.residuals import PosteriorErrors
from tvsysid.models import StandardError
from tvsysid.signals import Array, Ensemble

GUESS = (
    1e-2  # share of the torque's power that the noise is taken to have at least, until it is known
)
SMOOTH = 0.5  # Hz to either side over which the residual's power is averaged
FLOOR = 1e-3  # share of the largest power below which none is taken to lie


@attrs.frozen(eq=False)
class KernelPosterior:
    """Posterior of all coefficients: of those fitted, and by the prior alone of the others.

    ``fit`` is that of the coefficients ``kept``, mask (coefficient, column).

    The other coefficients have no effect that the data can show. For them the prior is all that is
    known: its ``variances`` (coefficient,).
    """

    fit: Fit
    kept: Chosen
    kernel: Kernel
    variances: Array

    @property
    def mean(self) -> Array:
        """Return the posterior mean, shape (coefficient,)."""
        mean = np.zeros(self.kept.size)
        mean[self.kept.ravel()] = self.fit.mean
        return mean

    @property
    def covariance(self) -> Array:
        """Return the posterior covariance, shape (coefficient, coefficient).

        It takes some megabytes. It is therefore calculated on request.
        """
        unseen = np.outer(
            0.5 * self.variances,
            1 / np.where(self.kernel.precision > 0, self.kernel.precision, np.inf),
        )
        covariance = np.diag(unseen.ravel())
        covariance[np.ix_(self.kept.ravel(), self.kept.ravel())] = self.fit.covariance
        return covariance


def posterior_of(
    record: Record, kernel: Kernel, variances: Array, reweighted: int = 0
) -> KernelPosterior:
    """Fit the coefficients that the data can see, with prior ``variances`` (coefficient,).

    The frequencies are weighted by the residual's spectrum. The weights are updated ``reweighted``
    times.
    """
    bins = max(1.0, record.size * min(record.stacks[0].band[1] / record.stacks[0].rate, 0.5))
    posterior = _fit_visible(record, kernel, variances, GUESS * 0.5 * record.power / bins, WHITE)
    spectrum = WHITE
    for _ in range(reweighted):
        spectrum = residual_spectrum(record, posterior, spectrum)
        posterior = _fit_visible(
            record, kernel, variances, 0.5 * posterior.fit.noise_variance, spectrum
        )
    return posterior


def _fit_visible(
    record: Record, kernel: Kernel, variances: Array, noise: float, spectrum: NoiseSpectrum
) -> KernelPosterior:
    """Fit the features that the noise lets the data see. The fit gives the noise variance."""
    order, instrumented = len(variances), len(record.powers) > 3
    powers = variances * record.powers[:order] / spectrum.power.min()
    while True:
        kept = kernel.visible(powers, VISIBLE * noise)
        lower = np.zeros((3 - order, kernel.columns), dtype=bool)
        chosen = np.concatenate([kept, lower, kept]) if instrumented else kept
        sums = record.sums(kernel, chosen, spectrum)
        precision = np.outer(1 / variances, kernel.precision)[kept]
        found = (instrumental if instrumented else fit)(sums, precision)
        if found.noise_variance >= noise or kept.all():
            return KernelPosterior(found, kept, kernel, variances)
        noise = 0.5 * found.noise_variance


def residual_spectrum(
    record: Record, posterior: KernelPosterior, before: NoiseSpectrum
) -> NoiseSpectrum:
    """Return the spectrum of the torque's residual after a fit under the spectrum ``before``."""
    by = np.append(-posterior.fit.mean, 1.0)
    prior = posterior.fit.noise_variance * record.weak_prior
    spectra = []
    for runs in record.stacks:
        blocks = [
            np.tensordot(by, rows, axes=1)
            for _, rows in runs.rows(posterior.kernel, posterior.kept)
        ]
        left, terms = np.concatenate(blocks, axis=1), runs.external_terms
        # The external term of each run.
        seen, target = (
            (each * before.weights(runs.frequency)).view(np.float64) for each in (terms, left)
        )
        left -= (
            np.linalg.solve(seen @ seen.T + prior * np.eye(len(terms)), seen @ target.T).T @ terms
        )
        power = np.sum(np.abs(left) ** 2, axis=0)
        spectra.append((runs.frequency, power, np.full_like(power, len(left))))
    at = max((frequency for frequency, _, _ in spectra), key=len)
    frequency, power, count = (np.concatenate(each) for each in zip(*spectra, strict=True))
    smooth = smoothed(frequency, power, count, at)
    smooth = np.maximum(smooth, max(FLOOR * smooth.max(), np.finfo(float).tiny))
    return NoiseSpectrum(at, smooth / smooth.mean())


def smoothed(frequency: Array, power: Array, count: Array, at: Array) -> Array:
    """Return the mean power within :data:`SMOOTH` of each frequency of ``at``.

    Each ``power`` is a sum of ``count`` squares. The spectrum is mirrored at its ends.
    """
    mirrored = np.concatenate(
        [2 * frequency.min() - frequency, frequency, 2 * frequency.max() - frequency]
    )
    order = np.argsort(mirrored, kind="stable")
    first = np.searchsorted(mirrored[order], at - SMOOTH, "left")
    last = np.searchsorted(mirrored[order], at + SMOOTH, "right")
    powers, counts = (np.r_[0.0, np.cumsum(np.tile(each, 3)[order])] for each in (power, count))
    return np.asarray((powers[last] - powers[first]) / (counts[last] - counts[first]))


@attrs.frozen(eq=False)
class KernelErrors:
    """Standard errors of sums of features, averaged over realizations.

    The features are calculated on request. ``times`` are those of :func:`times_of`. ``of_noise``
    makes the errors from expansions and covariances.
    """

    posterior: KernelPosterior
    times: Array
    of_noise: partial[PosteriorErrors]

    def standard_errors(self) -> Mapping[str, StandardError]:
        """Return the standard error of each quantity, by its name."""
        kernel, covariance = self.posterior.kernel, self.posterior.covariance
        features = sum(kernel(*each) for each in self.times) / len(self.times)
        parts = (
            slice(first, first + kernel.columns)
            for first in range(0, len(covariance), kernel.columns)
        )
        covariances = tuple(covariance[part, part] for part in parts)
        return self.of_noise((features,) * len(covariances), covariances).standard_errors()


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
    periodic, slow = (
        harmonic_features(phase, kernel.period, kernel.highest),
        kernel.slow_features(clock),
    )
    weights = np.zeros((slow.shape[-1], periodic.shape[-1], 3))
    for signal, of_signal in enumerate(coefficients.reshape(-1, kernel.columns)):
        weights[kernel.slow, kernel.place, signal] = of_signal
    return np.asarray(np.einsum("...h,...hm->...m", periodic, np.tensordot(slow, weights, 1)))
