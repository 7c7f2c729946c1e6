"""Fits of the features that a record can see; frequencies count alike, or by how strong the noise is there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tvsysid.methods.kbr.kernel import VISIBLE, Kernel
from tvsysid.methods.kbr.record import Chosen, ComplexArray, Record, Run
from tvsysid.numerics import Array
from tvsysid.numerics.gaussian import Fit, InstrumentalFit, fit, instrumental

Fitted = Fit | InstrumentalFit

GUESS = 1e-2  # share of the torque's power that the noise is taken to have at least, until it is known
SMOOTH = 0.5  # Hz to either side over which the residual's power is averaged
FLOOR = 1e-3  # share of the largest power below which none is taken to lie


@dataclass(frozen=True, eq=False)
class Weighting:
    """Weights of frequencies by the ``power`` of the noise over its mean, which is known at frequencies in Hz."""

    frequency: Array
    power: Array

    def __call__(self, frequency: Array) -> Array:
        """Weights at some frequencies in Hz."""
        return np.asarray(1 / np.sqrt(np.interp(frequency, self.frequency, self.power)))

    @property
    def largest(self) -> float:
        """Largest squared weight."""
        return float(1 / self.power.min())


def fitted(record: Record, kernel: Kernel, variances: Array, reweighted: int = 0) -> tuple[Fitted, Chosen]:
    """Fit the coefficients that the data can see, and say which these are, shape (coefficient, column).

    A record with twice as many signals as prior ``variances`` has instruments in its second half. The frequencies are
    weighted by what the fit left, so many times.
    """
    bins = max(1.0, record.size * min(record.band[1] / record.rate, 0.5))
    found, kept = _fit_visible(record, kernel, variances, GUESS * 0.5 * record.power / bins)
    weighting = None
    for _ in range(reweighted):
        weighting = residual_weighting(record, kernel, kept, found, weighting)
        found, kept = _fit_visible(record, kernel, variances, 0.5 * found.noise_variance, weighting)
    return found, kept


def _fit_visible(
    record: Record, kernel: Kernel, variances: Array, noise: float, weighting: Weighting | None = None
) -> tuple[Fitted, Chosen]:
    """Fit what noise lets the data see of the features, the noise being known when it is fitted."""
    count, strength = len(variances), 1.0 if weighting is None else weighting.largest
    instrumented = len(record.stacks[0].signals) > count
    powers = record.powers[:count] * strength
    while True:
        kept = kernel.visible(variances * powers, VISIBLE * noise)
        precision = np.outer(1 / variances, kernel.precision)[kept]
        chosen = np.concatenate([kept, kept]) if instrumented else kept
        statistics = record.statistics(kernel, chosen, weighting)
        found = (instrumental if instrumented else fit)(statistics, precision, record.weak_prior)
        if found.noise_variance >= noise or kept.all():
            return found, kept
        noise = 0.5 * found.noise_variance


def residual_weighting(
    record: Record, kernel: Kernel, kept: Chosen, found: Fitted, weighting: Weighting | None
) -> Weighting:
    """Weights by what a fit with (other) weights left of the torque."""
    spectra = []
    for run in record.stacks:
        low, high = run.bins(record.band)
        frequency = run.frequencies(low, high)
        weights = np.ones(high - low) if weighting is None else weighting(frequency)
        left = _left(run, kernel, kept, found, low, high)
        left -= _external(run.external_terms(low, high), left, weights, found.noise_variance * record.weak_prior)
        spectra.append((frequency, np.sum(np.abs(left) ** 2, axis=0), np.full(high - low, float(len(left)))))
    at = max(spectra, key=lambda each: len(each[0]))[0]
    frequency, power, count = (np.concatenate(each) for each in zip(*spectra, strict=True))
    smooth = smoothed(frequency, power, count, at)
    smooth = np.maximum(smooth, max(FLOOR * smooth.max(), np.finfo(float).tiny))
    return Weighting(at, smooth / smooth.mean())


def smoothed(frequency: Array, power: Array, count: Array, at: Array) -> Array:
    """Mean power of so many numbers within :data:`SMOOTH` of frequencies, mirrored at the ends."""
    mirrored = np.concatenate([2 * frequency.min() - frequency, frequency, 2 * frequency.max() - frequency])
    order = np.argsort(mirrored, kind="stable")
    first, last = (
        np.searchsorted(mirrored[order], at + side * SMOOTH, "left" if side < 0 else "right") for side in (-1, 1)
    )
    sums = [np.r_[0.0, np.cumsum(np.tile(each, 3)[order])] for each in (power, count)]
    return np.asarray((sums[0][last] - sums[0][first]) / (sums[1][last] - sums[1][first]))


def _left(run: Run, kernel: Kernel, kept: Chosen, found: Fitted, low: int, high: int) -> ComplexArray:
    """Spectrum (run, bin) of the torque less what the signals that were fitted, the first ones, explain."""
    left = run.output(low, high)
    fitted = run._replace(signals=run.signals[: len(kept)])
    for first, products in fitted.in_band(kernel, kept, low, high):
        left[:, first : first + products.shape[2]] -= np.tensordot(found.mean, products, axes=1)
    return left


def _external(terms: ComplexArray, left: ComplexArray, weights: Array, prior: float) -> ComplexArray:
    """External term of each run (run, bin)."""
    seen, target = ((each * weights).view(np.float64) for each in (terms, left))
    found = np.linalg.solve(seen @ seen.T + prior * np.eye(len(terms)), seen @ target.T)
    return np.asarray(found.T @ terms)
