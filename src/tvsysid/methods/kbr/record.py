"""A record in the frequency domain, and its sums of products for kernel-based regression."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache

import attrs
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.fft import rfft
from scipy.linalg import blas

from tvsysid.errors import InputError
from tvsysid.methods.kbr.kernel import Kernel, clocks_of
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate
from tvsysid.numerics.gaussian import Moments
from tvsysid.numerics.noise import autocorrelation
from tvsysid.signals import Array, Ensemble

ComplexArray = NDArray[np.complex128]

BLOCK = 512  # frequencies whose regressors are held at once
# half-cosines over a run that model the smooth external term, from 0 to 2 cycles
EXTERNAL_TERMS = 5
MIN_POWER = 1e-9  # of a half-cosine in the band, relative to its samples; a fainter one is rounding


@attrs.frozen(eq=False)
class Run:
    """Consecutive realizations, as ``spectra`` of signals times the kernel's slow functions.

    The signals are the angle and its derivatives, then those of an instrument if there is one, and
    last the torque, which is multiplied by the first function only. ``known`` of the ``samples``
    have derivatives; the signals are 0 elsewhere. ``spectra`` (signal x function, frequency) have
    ``norm="ortho"``. They begin ``reach`` bins below the fitted ``bins``, and end as many above.
    A run begins at ``start`` s of the trial and lasts ``periods`` realizations.
    """

    spectra: ComplexArray
    bins: slice
    reach: int
    start: float
    periods: int
    samples: int
    known: int

    @classmethod
    def of(
        cls,
        ensembles: Sequence[Ensemble],
        realizations: NDArray[np.int64],
        kernel: Kernel,
        band: tuple[float, float],
    ) -> Run:
        """Join realizations; a second ensemble is the instrument. The ``band`` in Hz is fitted."""
        ensemble = ensembles[0]
        rate, lost = ensemble.sampling_rate, max(0, HALF_WIDTH - ensemble.context)
        angles = [differentiate(joined(each, realizations), rate) for each in ensembles]
        torque = ensemble.torque[realizations, ensemble.core].reshape(1, -1)
        samples = torque.size
        signals = np.zeros((3 * len(angles) + 1, samples))
        known = slice(lost, samples - lost)
        signals[:, known] = np.concatenate([*angles, torque[:, known]])
        clock = clocks_of(ensemble)[realizations[0]]
        slow = kernel.slow_features(clock + np.arange(samples) / rate).T
        products = (signals[:-1, None] * slow).reshape(-1, samples)
        low, high = (frequency * samples / rate for frequency in band)
        bins = slice(math.ceil(low - 1e-9), min(math.floor(high + 1e-9), samples // 2) + 1)
        reach = kernel.highest * len(realizations)
        # Spectra of real signals are mirrored at 0 and at the Nyquist frequency.
        place = np.arange(bins.start - reach, bins.stop + reach) % samples
        mirrored = place > samples // 2
        spectra = rfft(np.concatenate([products, signals[-1:]]), norm="ortho")
        spectra = spectra[:, np.where(mirrored, samples - place, place)]
        np.conjugate(spectra, out=spectra, where=mirrored)
        start = float(ensemble.onsets[realizations[0]])
        return cls(spectra, bins, reach, start, len(realizations), samples, samples - 2 * lost)

    def rows(self, kernel: Kernel) -> Iterator[tuple[slice, ComplexArray]]:
        """Yield slices of bins and their regressors (row, bin); the last row is the torque.

        The regressors are each signal times all columns of the kernel. A product with a harmonic is
        a shift in frequency, exact because a run holds whole periods. Blocks of frequencies keep
        memory from growing with the record times the columns.
        """
        torque = len(self.spectra) - 1
        signals = torque // kernel.functions
        source = np.append(np.arange(0, torque, kernel.functions)[:, None] + kernel.slow, torque)
        shift = np.append(np.tile(kernel.harmonic * self.periods, signals), 0)
        # A cosine is half the sum of a turn and its conjugate, a sine that a quarter turn later.
        # The torque has no shift: it is the sum of two halves.
        turn = np.exp(2j * np.pi * kernel.harmonic * self.start / kernel.period)
        turn *= np.where(kernel.sine == 0, 0.5, -0.5j)
        turn = np.append(np.tile(turn, signals), 0.5)[:, None]
        count = self.bins.stop - self.bins.start
        for low in range(0, count, BLOCK):
            high = min(low + BLOCK, count)
            windows = sliding_window_view(self.spectra, high - low, axis=1)
            rows = windows[source, low + self.reach - shift] * turn
            rows += windows[source, low + self.reach + shift] * turn.conj()
            yield slice(low, high), rows


@lru_cache(maxsize=4)
def external_terms(samples: int, known: int) -> ComplexArray:
    """Return spectra (term, frequency) of half-cosines over a run, 0 outside its known samples."""
    lost = (samples - known) // 2
    place = (np.arange(samples) + 0.5) / samples
    terms = np.cos(np.pi * np.outer(np.arange(EXTERNAL_TERMS), place))
    terms[:, :lost] = terms[:, samples - lost :] = 0.0
    return np.asarray(rfft(terms, norm="ortho"))


def runs_of(ensembles: Sequence[Ensemble], kernel: Kernel, band: tuple[float, float]) -> list[Run]:
    """Divide an ensemble, and that of its instrument, into runs; the ``band`` in Hz is fitted.

    Raise InputError if the band has no data.
    """
    ensemble = ensembles[0]
    lost = max(0, HALF_WIDTH - ensemble.context)
    long = [each for each in ensemble.runs if len(each) * ensemble.samples > 2 * lost + 1]
    runs = [Run.of(ensembles, each, kernel, band) for each in long]
    if not any(run.bins.start < run.bins.stop for run in runs):
        raise InputError(
            f"KernelRegression: nothing is left of realizations of {ensemble.samples} samples at "
            f"{ensemble.sampling_rate:g} Hz after {HALF_WIDTH} at either end for the derivatives, "
            f"within a band of {band[0]:g} to {band[1]:g} Hz; give context, longer realizations or "
            "a lower band"
        )
    return runs


def moments_of(
    runs: Sequence[Run], kernel: Kernel, weights: Sequence[Array] | None = None
) -> Moments:
    r"""Return sums over the band's frequencies of products of all regressors X and torque y.

    Real and imaginary parts count separately. ``weights`` are those of the frequencies of each
    run. The smooth external terms T of each run have no prior, and are projected out:

    .. math:: X^T M X, \quad X^T M y, \quad y^T M y, \qquad M = 1 - T (T^T T)^{-1} T^T
    """
    size = (len(runs[0].spectra) - 1) // kernel.functions * kernel.columns + 1  # and the torque
    products, mixed, number = np.zeros((size, size), order="F"), [], 0.0
    for index, run in enumerate(runs):
        terms = external_terms(run.samples, run.known)[:, run.bins]
        if weights:
            terms = terms * weights[index]
        numbers = terms.view(np.float64)
        powers, axes = np.linalg.eigh(numbers @ numbers.T)
        kept = powers > MIN_POWER * run.samples
        basis = axes[:, kept].T @ numbers / np.sqrt(powers[kept, None])
        with_terms = np.zeros((len(basis), size))
        for bins, rows in run.rows(kernel):
            parts = (rows * weights[index][bins] if weights else rows).view(np.float64)
            products = blas.dsyrk(
                1.0, parts.T, beta=1.0, c=products, trans=1, lower=1, overwrite_c=1
            )
            with_terms += basis[:, 2 * bins.start : 2 * bins.stop] @ parts.T
        mixed.append(with_terms)
        number += numbers.shape[1] * run.known / run.samples - len(basis)
    projected = np.concatenate(mixed)
    return Moments.of(products - projected.T @ projected, number)


def whitening(runs: Sequence[Run], residual: Array) -> list[Array]:
    """Return weights of each run's frequencies that make a residual (realization, time) white.

    They are inverse to the root of its spectrum, whose mean is taken as 1.
    """
    correlation = autocorrelation(residual - residual.mean())  # 1 at lag 0; negative lags mirror it
    powers = [2 * rfft(correlation, run.samples)[run.bins].real - 1 for run in runs]
    mean = np.mean(np.concatenate(powers))
    return [np.sqrt(mean / each) for each in powers]


def joined(ensemble: Ensemble, realizations: NDArray[np.int64]) -> Array:
    """Return the angle of consecutive realizations, with context for derivatives at the ends."""
    start, stop = ensemble.core.start, ensemble.core.stop
    context = min(ensemble.context, HALF_WIDTH)
    before = ensemble.angle[realizations[0], start - context : start]
    after = ensemble.angle[realizations[-1], stop : stop + context]
    return np.concatenate([before, ensemble.angle[realizations, start:stop].ravel(), after])
