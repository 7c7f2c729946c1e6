"""A record in the frequency domain, and its sums of products for kernel-based regression."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache

import attrs
import numpy as np
from numpy.typing import NDArray
from scipy.fft import fft, rfft
from scipy.linalg import blas

from tvsysid.errors import InputError
from tvsysid.methods.base import missing_edge
from tvsysid.methods.kbr.kernel import Kernel, clocks_of
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate
from tvsysid.numerics.gaussian import Moments
from tvsysid.numerics.noise import autocorrelation
from tvsysid.signals import Array, Ensemble

ComplexArray = NDArray[np.complex128]

BLOCK = 512  # frequencies whose regressors are held at once
# half-cosines over a run, from 0 to 2 cycles, that model the paper's external torque f_ext
EXTERNAL_TERMS = 5
# A sum of half-cosines with less power per sample in the band than this is rounding error.
MIN_POWER = 1e-9


@attrs.frozen(eq=False)
class Runs:
    """Spectra of the runs of one length. A run is a sequence of realizations without a gap.

    Each signal is multiplied by each slow function of the kernel. The signals are the angle and its
    derivatives, then those of an instrument if there is one, and last the torque, which is
    multiplied by the first function only. The ends of a run, where derivatives are unknown, are 0.
    ``spectra`` (signal x function, run, frequency) have ``norm="ortho"``. Below and above the
    fitted ``bins`` they go on for the kernel's highest harmonic. Each run lasts ``periods``
    realizations, together ``samples``. All spectra count time from the trial's start.

    A *component* is the real or the imaginary part at a fitted frequency. ``weights`` (component,)
    multiply them. The ``external`` terms (run, term, component) are spectra of half-cosines. A run
    has ``freedom`` independent components.
    """

    spectra: ComplexArray
    bins: slice
    periods: int
    samples: int
    external: Array
    freedom: float
    weights: Array

    @classmethod
    def of(
        cls,
        ensembles: Sequence[Ensemble],
        realizations: NDArray[np.int64],
        kernel: Kernel,
        band: tuple[float, float],
    ) -> Runs:
        """Join ``realizations`` (run, realization) of an ensemble, and of its instrument if given.

        The ``band`` in Hz is fitted.
        """
        ensemble = ensembles[0]
        runs, periods = realizations.shape
        rate, samples = ensemble.sampling_rate, periods * ensemble.samples
        lost = missing_edge(HALF_WIDTH, ensemble)
        known = slice(lost, samples - lost)
        signals = np.zeros((3 * len(ensembles) + 1, runs, samples))
        angles = [differentiate(joined(each, realizations), rate) for each in ensembles]
        signals[:-1, :, known] = np.concatenate(angles)
        torque = ensemble.torque[realizations, ensemble.core].reshape(runs, -1)
        signals[-1, :, known] = torque[:, known]
        clocks = clocks_of(ensemble)[realizations[:, :1]] + np.arange(samples) / rate
        slow = np.ascontiguousarray(np.moveaxis(kernel.slow_features(clocks), -1, 0))
        products = (signals[:-1, None] * slow).reshape(-1, runs, samples)
        low, high = (frequency * samples / rate for frequency in band)
        bins = slice(math.ceil(low - 1e-9), min(math.floor(high + 1e-9), samples // 2) + 1)
        reach = kernel.highest * periods
        bin_numbers = np.arange(bins.start - reach, bins.stop + reach)
        spectra = fft(np.concatenate([products, signals[-1:]]), norm="ortho")
        spectra = spectra[..., bin_numbers % samples]
        # All spectra are delayed by the run's start within a period. So harmonics have phase 0 at
        # the start of the trial, and not at that of the run.
        starts = ensemble.onsets[realizations[:, :1]] % kernel.period
        delay = np.exp(-2j * np.pi * rate / samples * starts * bin_numbers)
        spectra *= delay
        delay = delay[:, None, reach : len(bin_numbers) - reach]
        external = (external_terms(samples, lost)[:, bins] * delay).view(np.float64)
        weights = np.ones(external.shape[-1])
        freedom = len(weights) * (1 - 2 * lost / samples)
        return cls(spectra, bins, periods, samples, external, freedom, weights)

    def rows(self, kernel: Kernel) -> Iterator[tuple[slice, Array]]:
        """Yield slices of components, and weighted regressors (row, run, component).

        The rows are each signal times all columns of the kernel, and the torque. A product with a
        harmonic is a shift in frequency, exact because a run holds whole periods. Blocks of
        frequencies keep memory from growing with the record times the columns.
        """
        runs, waves = self.spectra.shape[1], 2 * kernel.highest + 1
        first = np.searchsorted(kernel.wave, np.arange(waves + 1))
        # A cosine is half the sum of two shifts; a sine is half their difference, times i.
        signals = self.spectra[:-1].reshape(-1, kernel.functions, *self.spectra.shape[1:])
        halves, turned = 0.5 * signals, 0.5j * signals
        size, count = len(signals) * kernel.column_count, self.bins.stop - self.bins.start
        reach = kernel.highest * self.periods
        length = max(1, BLOCK // runs)
        for low in range(0, count, length):
            high = min(low + length, count)
            rows = np.empty((size + 1, runs, high - low), np.complex128)
            rows[-1] = self.spectra[-1, :, low + reach : high + reach]
            products = rows[:-1].reshape(len(signals), -1, runs, high - low)
            for wave in range(waves):
                own = slice(first[wave], first[wave + 1])  # columns of this wave
                slow = slice(kernel.slow[own.start], kernel.slow[own.stop - 1] + 1)
                is_sine = wave > 0 and wave % 2 == 0
                part, combine = (turned, np.subtract) if is_sine else (halves, np.add)
                up = reach + (wave + 1) // 2 * self.periods
                down = 2 * reach - up
                combine(
                    part[:, slow, :, low + up : high + up],
                    part[:, slow, :, low + down : high + down],
                    out=products[:, own],
                )
            components = slice(2 * low, 2 * high)
            parts = rows.view(np.float64)
            parts *= self.weights[components]
            yield components, parts


@lru_cache(maxsize=4)
def external_terms(samples: int, lost: int) -> ComplexArray:
    """Return spectra (term, frequency) of half-cosines over a run, 0 at its lost ends."""
    terms, known = np.zeros((EXTERNAL_TERMS, samples)), slice(lost, samples - lost)
    turns = np.outer(np.arange(EXTERNAL_TERMS), np.arange(samples) + 0.5) / samples
    terms[:, known] = np.cos(np.pi * turns[:, known])
    return rfft(terms, norm="ortho")


def runs_of(ensembles: Sequence[Ensemble], kernel: Kernel, band: tuple[float, float]) -> list[Runs]:
    """Divide an ensemble, and its instrument if given, into runs; the ``band`` in Hz is fitted.

    Raise InputError if the band has no data.
    """
    ensemble = ensembles[0]
    lost = missing_edge(HALF_WIDTH, ensemble)
    groups = []
    for length in {len(run) for run in ensemble.runs}:
        if length * ensemble.samples > 2 * lost + 1:
            realizations = np.stack([run for run in ensemble.runs if len(run) == length])
            groups.append(Runs.of(ensembles, realizations, kernel, band))
    groups = [runs for runs in groups if runs.weights.size]
    if not groups:
        raise InputError(
            f"KernelRegression: nothing is left of realizations of {ensemble.samples} samples at "
            f"{ensemble.sampling_rate:g} Hz after {HALF_WIDTH} at either end for the derivatives, "
            f"within a band of {band[0]:g} to {band[1]:g} Hz; give context, longer realizations or "
            "a lower band"
        )
    return groups


def moments_of(groups: Sequence[Runs], kernel: Kernel) -> Moments:
    r"""Return sums over the band's frequencies of products of all regressors X and torque y.

    Real and imaginary parts count separately. The smooth external terms T of each run have no
    prior, and are projected out:

    .. math:: X^T M X, \quad X^T M y, \quad y^T M y, \qquad M = 1 - T (T^T T)^{-1} T^T
    """
    size = (
        len(groups[0].spectra) - 1
    ) // kernel.functions * kernel.column_count + 1  # and the torque
    products, mixed, number = np.zeros((size, size), order="F"), [], 0.0
    for runs in groups:
        terms = runs.external * runs.weights
        # The terms of all runs have the same products, as they differ in phase alone.
        powers, axes = np.linalg.eigh(terms[0] @ terms[0].T)
        kept = powers > MIN_POWER * runs.samples
        basis = (axes[:, kept] / np.sqrt(powers[kept])).T @ terms
        with_terms = np.zeros((len(basis), size, basis.shape[1]))
        for components, rows in runs.rows(kernel):
            with_terms += rows.swapaxes(0, 1) @ basis[..., components].swapaxes(1, 2)
            flat = rows.reshape(size, -1).T
            products = blas.dsyrk(1.0, flat, beta=1.0, c=products, trans=1, lower=1, overwrite_c=1)
        mixed.append(with_terms.swapaxes(1, 2).reshape(-1, size))
        number += len(basis) * (runs.freedom - basis.shape[1])
    projected = np.concatenate(mixed)
    products = blas.dsyrk(-1.0, projected, beta=1.0, c=products, trans=1, lower=1, overwrite_c=1)
    return Moments.of(products, number)


def whitened(groups: Sequence[Runs], residual: Array) -> list[Runs]:
    """Return runs with weights that make a residual (realization, time) white.

    The weights are the inverse square root of the residual's spectrum relative to its mean.
    """
    correlation = autocorrelation(residual - residual.mean())  # 1 at lag 0; negative lags mirror it
    powers = [2 * rfft(correlation, runs.samples)[runs.bins].real - 1 for runs in groups]
    mean = np.mean(np.concatenate(powers))
    return [
        attrs.evolve(runs, weights=np.repeat(np.sqrt(mean / power), 2))
        for runs, power in zip(groups, powers, strict=True)
    ]


def joined(ensemble: Ensemble, realizations: NDArray[np.int64]) -> Array:
    """Return the angle (run, time) of runs, with context for derivatives at the ends."""
    start, stop = ensemble.core.start, ensemble.core.stop
    context = min(ensemble.context, HALF_WIDTH)
    before = ensemble.angle[realizations[:, 0], start - context : start]
    inside = ensemble.angle[realizations, start:stop].reshape(len(realizations), -1)
    after = ensemble.angle[realizations[:, -1], stop : stop + context]
    return np.concatenate([before, inside, after], axis=1)
