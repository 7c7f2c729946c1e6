"""A record in the frequency domain, and its sums of products for kernel-based regression."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import NamedTuple

import attrs
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.fft import rfft
from scipy.linalg import blas

from tvsysid.errors import InputError
from tvsysid.methods.kbr.kernel import Kernel
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate
from tvsysid.numerics.gaussian import Moments
from tvsysid.signals import Array, Ensemble

ComplexArray = NDArray[np.complex128]
Mask = NDArray[np.bool_]

BLOCK = 512  # frequencies whose regressors are held at once
# half-cosines over a run that model the smooth external term, from 0 to 2 cycles
EXTERNAL_TERMS = 5
# share of the noise that the torque of a feature must be able to reach for it to be fitted
VISIBLE = 0.03


class Sums(NamedTuple):
    """Products of regressors X and torque y with each other, and with external terms T.

    The values of y are real and imaginary parts of spectra. ``products`` is [X y]ᵀ[X y], of which
    only the lower triangle is read. ``mixed`` is [X y]ᵀT. The terms are orthogonal, and ``powers``
    are their squares. ``prior`` is the prior precision of each term. ``number`` is the effective
    number of values of y.
    """

    products: Array
    mixed: Array
    powers: Array
    prior: float
    number: float

    def shrinkage(self, noise: float) -> Array:
        r"""Return :math:`(T^T T + \sigma^2 q)^{-1}`, shape (term,), with q the prior precision."""
        return 1 / (self.powers + noise * self.prior)

    def marginal(self, noise: float) -> Moments:
        """Return the moments with the external terms integrated out for this noise variance."""
        mixed = self.mixed * np.sqrt(self.shrinkage(noise))
        products = blas.dsyrk(-1.0, mixed, beta=1.0, c=self.products, lower=1)
        return Moments.of(products, self.number)


@attrs.frozen(eq=False)
class Run:
    """Consecutive realizations, as ``spectra`` of signals times the kernel's slow functions.

    The signals are the angle and its derivatives, then those of an instrument if there is one, and
    last the torque, which is multiplied by the first function only. ``known`` of the ``samples``
    have derivatives; the signals are 0 elsewhere. ``spectra`` (signal x function, frequency) have
    ``norm="ortho"``. They begin ``reach`` bins below the fitted ``bins``, and end as many above.
    A run begins at ``start`` s of the trial and lasts ``periods`` realizations. ``powers`` are the
    squares of the signals, ``rate`` is the sampling rate in Hz.
    """

    spectra: ComplexArray
    powers: Array
    bins: slice
    reach: int
    start: float
    periods: int
    samples: int
    known: int
    rate: float

    @classmethod
    def of(
        cls,
        ensembles: Sequence[Ensemble],
        realizations: NDArray[np.int64],
        clock: float,
        kernel: Kernel,
        band: tuple[float, float],
    ) -> Run:
        """Join realizations from a ``clock`` time on; a second ensemble is the instrument."""
        ensemble = ensembles[0]
        rate, lost = ensemble.sampling_rate, max(0, HALF_WIDTH - ensemble.context)
        angles = [differentiate(joined(each, realizations), rate) for each in ensembles]
        torque = ensemble.torque[realizations, ensemble.core].reshape(1, -1)
        samples = torque.size
        signals = np.zeros((3 * len(angles) + 1, samples))
        known = slice(lost, samples - lost)
        signals[:, known] = np.concatenate([*angles, torque[:, known]])
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
        return cls(
            spectra,
            np.einsum("mt,mt->m", signals, signals),
            bins,
            reach,
            float(ensemble.onsets[realizations[0]]),
            len(realizations),
            samples,
            samples - 2 * lost,
            rate,
        )

    @property
    def frequency(self) -> Array:
        """Return the frequencies in Hz of the bins."""
        return np.arange(self.bins.start, self.bins.stop) * (self.rate / self.samples)

    def external_terms(self, weights: Array) -> tuple[ComplexArray, Array]:
        """Return weighted spectra (term, bin) and powers (term,) of the external terms.

        The half-cosines are rotated so that their spectra are orthogonal in the band.
        """
        terms = _half_cosines(self.samples, self.known)[:, self.bins] * weights
        powers, axes = np.linalg.eigh((terms @ terms.conj().T).real)
        return axes.T @ terms, np.maximum(powers, 0.0)

    def rows(self, kernel: Kernel, chosen: Mask) -> Iterator[tuple[slice, ComplexArray]]:
        """Yield slices of bins and their regressors, shape (row, bin).

        ``chosen`` (signal, column) selects the regressors. The last row is the torque. A product
        with a harmonic is a shift in frequency, exact because a run holds whole periods. Blocks of
        frequencies keep memory from growing with the record times the columns.
        """
        signal, column = np.nonzero(chosen)
        # The torque is a signal times the first column, the constant.
        signal, column = np.append(signal, len(self.powers) - 1), np.append(column, 0)
        source = signal * (1 + kernel.projection.shape[1]) + kernel.slow[column]
        shift = kernel.harmonic[column] * self.periods
        # A cosine is half of a turn and its conjugate; a sine is a quarter of a turn later.
        turn = np.exp(2j * np.pi * kernel.harmonic[column] * self.start / kernel.period)[:, None]
        turn *= np.where(kernel.sine[column] == 0, 0.5, -0.5j)[:, None]
        count = self.bins.stop - self.bins.start
        for low in range(0, count, BLOCK):
            high = min(low + BLOCK, count)
            windows = sliding_window_view(self.spectra, high - low, axis=1)
            rows = windows[source, low + self.reach - shift] * turn
            rows += windows[source, low + self.reach + shift] * turn.conj()
            yield slice(low, high), rows


@lru_cache(maxsize=4)
def _half_cosines(samples: int, known: int) -> ComplexArray:
    """Return the spectra of the first half-cosines over a run, 0 outside its known samples."""
    lost = (samples - known) // 2
    place = (np.arange(samples) + 0.5) / samples
    terms = np.cos(np.pi * np.outer(np.arange(EXTERNAL_TERMS), place))
    terms[:, :lost] = terms[:, samples - lost :] = 0.0
    spectra = np.asarray(rfft(terms, norm="ortho"))
    spectra.flags.writeable = False
    return spectra


@attrs.frozen(eq=False)
class Record:
    """Runs of a record, and the kernel whose features multiply its signals.

    The ``band`` in Hz is fitted. ``powers`` are the summed squares of each signal, the torque last.
    """

    runs: tuple[Run, ...]
    kernel: Kernel
    band: tuple[float, float]
    powers: Array

    @classmethod
    def of(
        cls,
        ensembles: Sequence[Ensemble],
        kernel: Kernel,
        band: tuple[float, float],
    ) -> Record:
        """Divide an ensemble, and that of its instrument, into runs.

        Raise InputError if the band has no data.
        """
        ensemble = ensembles[0]
        lost = max(0, HALF_WIDTH - ensemble.context)
        long = [each for each in ensemble.runs if len(each) * ensemble.samples > 2 * lost + 1]
        clocks = clocks_of(ensemble)
        runs = tuple(Run.of(ensembles, each, clocks[each[0]], kernel, band) for each in long)
        if not any(len(run.frequency) for run in runs):
            raise InputError(
                f"KernelRegression: nothing is left of realizations of {ensemble.samples} samples "
                f"at {ensemble.sampling_rate:g} Hz after {HALF_WIDTH} at either end for the "
                f"derivatives, within a band of {band[0]:g} to {band[1]:g} Hz; give context, "
                "longer realizations or a lower band"
            )
        return cls(runs, kernel, band, np.sum([run.powers for run in runs], axis=0))

    @property
    def size(self) -> int:
        """Return the number of known samples."""
        return sum(run.known for run in self.runs)

    @property
    def white(self) -> list[Array]:
        """Return equal weights of all frequencies, for each run."""
        return [np.ones(len(run.frequency)) for run in self.runs]

    @property
    def prior(self) -> float:
        """Return the prior precision of the external terms: two over the torque's mean square."""
        return 2 * self.size / (float(self.powers[-1]) or 1.0)

    def visible(self, variances: Array, noise: float) -> Mask:
        """Return which features may exceed a share of the noise, shape (signal, column).

        ``variances`` (signal,) are prior variances, ``noise`` is a sum of squares.
        """
        powers = variances * self.powers[: len(variances)]
        return np.asarray(powers[:, None] >= VISIBLE * noise * self.kernel.precision)

    def sums(self, chosen: Mask, weights: Sequence[Array] | None = None) -> Sums:
        """Return sums over the band's frequencies, of the chosen features.

        Real and imaginary parts count separately. Each run has its own external terms. ``weights``
        are those of the frequencies of each run.
        """
        size, number = np.count_nonzero(chosen) + 1, 0.0
        products, mixed, powers = np.zeros((size, size), order="F"), [], []
        for run, weight in zip(self.runs, weights or self.white, strict=True):
            terms, power = run.external_terms(weight)
            with_terms = np.zeros((size, EXTERNAL_TERMS))
            for bins, rows in run.rows(self.kernel, chosen):
                parts = (rows * weight[bins] if weights else rows).view(np.float64)
                products = blas.dsyrk(
                    1.0, parts.T, beta=1.0, c=products, trans=1, lower=1, overwrite_c=1
                )
                with_terms += parts @ terms[:, bins].view(np.float64).T
            mixed.append(with_terms)
            powers.append(power)
            number += 2 * len(weight) * run.known / run.samples
        with_all = np.concatenate(mixed, axis=1)
        return Sums(products, with_all, np.concatenate(powers), self.prior, number)


def kernel_over(ensemble: Ensemble, l1: float, l2: float) -> Kernel:
    """Return the kernel of an ensemble, whose period is the duration of a realization."""
    clocks = clocks_of(ensemble)
    span = float(np.ptp(clocks)) + ensemble.duration
    rate = ensemble.sampling_rate
    return Kernel.of(ensemble.duration, l1, l2, float(clocks.min()), span, rate)


def clocks_of(ensemble: Ensemble) -> Array:
    """Return the onset in s of each realization on one clock, with trials one after another."""
    span = float(np.ptp(ensemble.onsets)) + ensemble.duration
    _, number = np.unique(ensemble.trials, return_inverse=True)
    return np.asarray(ensemble.onsets + number * span)


def joined(ensemble: Ensemble, realizations: NDArray[np.int64]) -> Array:
    """Return the angle of consecutive realizations, with context for derivatives at the ends."""
    start, stop = ensemble.core.start, ensemble.core.stop
    context = min(ensemble.context, HALF_WIDTH)
    before = ensemble.angle[realizations[0], start - context : start]
    after = ensemble.angle[realizations[-1], stop : stop + context]
    return np.concatenate([before, ensemble.angle[realizations, start:stop].ravel(), after])
