"""Unbroken runs of a record, and the sums over their frequencies for kernel-based regression."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property, lru_cache
from typing import NamedTuple

import attrs
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.fft import rfft
from scipy.linalg import blas

from tvsysid.errors import InputError
from tvsysid.methods.kbr.kernel import ENDLESS, Kernel
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate
from tvsysid.numerics.gaussian import Moments
from tvsysid.numerics.lowpass import low_pass
from tvsysid.signals import Array, Ensemble

ComplexArray = NDArray[np.complex128]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

BLOCK = 512  # frequencies whose regressors are held at once
# half-cosines over a run, the fastest of two cycles, that make up the smooth external term
EXTERNAL_TERMS = 5


class NoiseSpectrum(NamedTuple):
    """Power of the noise divided by its mean, at frequencies in Hz."""

    frequency: Array
    power: Array

    def weights(self, frequency: Array) -> Array:
        """Return the weights of other frequencies in Hz."""
        return np.asarray(1 / np.sqrt(np.interp(frequency, self.frequency, self.power)))


WHITE = NoiseSpectrum(np.zeros(1), np.ones(1))


class Sums(NamedTuple):
    """Moments of regressors X and torque y, and their products with external terms T.

    The numbers of y are real and imaginary parts of spectra. ``mixed`` is XᵀT, ``cross`` Tᵀy and
    ``powers`` the diagonal of TᵀT. The terms are orthogonal. ``prior`` is q, the prior precision of
    each term.
    """

    moments: Moments
    mixed: Array
    cross: Array
    powers: Array
    prior: float

    def shrinkage(self, noise: float) -> Array:
        r"""Return :math:`(T^T T + \sigma^2 q)^{-1}`, shape (term,)."""
        return 1 / (self.powers + noise * self.prior)

    def marginal(self, noise: float) -> Moments:
        """Return the moments with the external terms integrated out for this noise variance."""
        gram, cross, square, number = self.moments
        shrinkage = self.shrinkage(noise)
        mixed = self.mixed * np.sqrt(shrinkage)
        return Moments(
            blas.dsyrk(-1.0, mixed, beta=1.0, c=gram, lower=1),
            cross - self.mixed @ (shrinkage * self.cross),
            square - float(shrinkage @ self.cross**2),
            number,
        )

    def prior_cost(self, mean: Array, noise: float) -> float:
        r"""Return :math:`\sigma^2 q f^T f` for the external terms f beside given weights."""
        terms = self.shrinkage(noise) * (self.cross - mean @ self.mixed[: len(mean)])
        return noise * self.prior * float(terms @ terms)


@attrs.frozen(eq=False)
class Runs:
    """Unbroken runs of a record, all of one length; the ``band`` in Hz is fitted.

    ``signals`` (signal, run, time) are the angle and its derivatives, then those of an
    instrument if there is one, and last the torque; ``rate`` in Hz; ``phase`` and ``clock``
    (run,), the time in s at the start, since the trial's time 0 and on the record's clock.
    Spectra are those of ``norm="ortho"``.
    """

    signals: Array
    rate: float
    band: tuple[float, float]
    phase: Array
    clock: Array

    @classmethod
    def of(cls, ensemble: Ensemble, members: Index, band: tuple[float, float]) -> Runs:
        """Join realizations (run, realization).

        The derivatives use the context at both ends, or lose samples.
        """
        rate, lost = ensemble.sampling_rate, max(0, HALF_WIDTH - ensemble.context)
        torque = ensemble.torque[members, ensemble.core].reshape(len(members), -1)
        angle = joined(ensemble, members, min(ensemble.context, HALF_WIDTH))
        signals = [*differentiate(angle, rate), torque[:, lost : torque.shape[1] - lost]]
        starts = ensemble.onsets, clocks_of(ensemble)
        phase, clock = (each[members[:, 0]] + lost / rate for each in starts)
        return cls(np.stack(signals), rate, band, phase, clock)

    @property
    def samples(self) -> int:
        """Return the number of samples of a run."""
        return int(self.signals.shape[2])

    @cached_property
    def bins(self) -> slice:
        """Return the bins in the band."""
        low, high = (frequency * self.samples / self.rate for frequency in self.band)
        return slice(math.ceil(low - 1e-9), min(math.floor(high + 1e-9), self.samples // 2) + 1)

    @property
    def frequency(self) -> Array:
        """Return the frequencies in Hz of the bins."""
        return np.arange(self.bins.start, self.bins.stop) * (self.rate / self.samples)

    @cached_property
    def spectra(self) -> ComplexArray:
        """Return the spectra of the signals at all frequencies, shape (signal, run, frequency)."""
        return np.asarray(rfft(self.signals, norm="ortho"))

    def external_terms(self, weights: Array) -> tuple[ComplexArray, Array]:
        """Return weighted spectra (term, bin) and powers (term,) of the external terms.

        The half-cosines are rotated so that their spectra are orthogonal in the band.
        """
        terms = _half_cosines(self.samples)[:, self.bins] * weights
        powers, axes = np.linalg.eigh((terms @ terms.conj().T).real)
        return axes.T @ terms, np.maximum(powers, 0.0)

    def rows(self, kernel: Kernel, chosen: Mask) -> Iterator[tuple[slice, ComplexArray]]:
        """Yield slices of bins and their regressors, shape (row, run, bin).

        ``chosen`` (signal, column) selects the regressors. The last row is the torque. Blocks of
        frequencies keep memory from growing with the record times the columns.
        """
        signal, column = np.nonzero(chosen)
        # The torque is a signal times the first column, the constant.
        signal, column = np.append(signal, len(self.signals) - 1), np.append(column, 0)
        periods = self.samples / self.rate / kernel.period
        reach = kernel.highest * round(periods)
        whole = kernel.highest * abs(periods - round(periods)) < 1e-9 * periods
        if whole and self.bins.stop - 1 + reach <= self.samples // 2:
            return self._shifted(kernel, signal, column, reach)
        return self._transformed(kernel, signal, column)

    def _shifted(
        self, kernel: Kernel, signal: Index, column: Index, reach: int
    ) -> Iterator[tuple[slice, ComplexArray]]:
        """Yield products with harmonics, as shifts in frequency of at most ``reach`` bins.

        These are exact where a run holds whole periods.
        """
        count = int(kernel.slow.max()) + 1
        pairs, source = np.unique(signal * count + kernel.slow[column], return_inverse=True)
        if count == 1:
            spectra = self.spectra[pairs]
        else:
            products = self.signals[pairs // count] * self._slow(kernel)[pairs % count]
            spectra = rfft(products, norm="ortho")
        spectra = spectra[..., : self.bins.stop + reach]
        # from bin -reach on
        spectra = np.concatenate([spectra[..., reach:0:-1].conj(), spectra], axis=-1)
        harmonic = kernel.harmonic[column]
        shift = harmonic * round(self.samples / self.rate / kernel.period)
        # A cosine is half of a turn and its conjugate; a sine is a quarter of a turn later.
        turn = np.exp(2j * np.pi * np.outer(harmonic, self.phase) / kernel.period)[..., None]
        turn *= np.where(kernel.sine[column] == 0, 0.5, -0.5j)[:, None, None]
        start, length = self.bins.start, max(1, BLOCK // self.signals.shape[1])
        for low in range(start, self.bins.stop, length):
            high = min(low + length, self.bins.stop)
            windows = sliding_window_view(spectra, high - low, axis=-1)
            rows = windows[source, :, low + reach - shift] * turn
            rows += windows[source, :, low + reach + shift] * turn.conj()
            yield slice(low - start, high - start), rows

    def _transformed(
        self, kernel: Kernel, signal: Index, column: Index
    ) -> Iterator[tuple[slice, ComplexArray]]:
        """Yield products with any features, each transformed."""
        slow, periodic = self._slow(kernel), kernel.periodic_features(self._times(self.phase))
        indices = zip(signal, kernel.place[column], kernel.slow[column], strict=True)
        products = (self.signals[m] * periodic[..., place] * slow[n] for m, place, n in indices)
        rows = [rfft(each, norm="ortho")[:, self.bins] for each in products]
        yield slice(0, self.bins.stop - self.bins.start), np.stack(rows)

    def _slow(self, kernel: Kernel) -> Array:
        """Return the slow functions over each run, shape (function, run, time)."""
        return np.moveaxis(kernel.slow_features(self._times(self.clock)), -1, 0)

    def _times(self, start: Array) -> Array:
        return np.add.outer(start, np.arange(self.samples) / self.rate)


@lru_cache(maxsize=4)
def _half_cosines(samples: int) -> ComplexArray:
    """Return the spectra of the first half-cosines over a number of samples."""
    place = (np.arange(samples) + 0.5) / samples
    terms = rfft(np.cos(np.pi * np.outer(np.arange(EXTERNAL_TERMS), place)), norm="ortho")
    terms.flags.writeable = False
    return np.asarray(terms)


@attrs.frozen(eq=False)
class Record:
    """A record in ``stacks`` of unbroken runs, from ``start`` to ``stop`` in s."""

    stacks: tuple[Runs, ...]
    start: float
    stop: float

    @classmethod
    def of(cls, ensemble: Ensemble, band: tuple[float, float]) -> Record:
        """Divide an ensemble into runs. Raise InputError if the band has no data."""
        rate, lost = ensemble.sampling_rate, max(0, HALF_WIDTH - ensemble.context)
        runs = [run for run in ensemble.runs if len(run) * ensemble.samples >= 2 * lost + 2]
        if not runs or band[0] >= rate / 2:
            raise InputError(
                f"KernelRegression: nothing is left of realizations of {ensemble.samples} samples "
                f"at {rate:g} Hz after {HALF_WIDTH} at either end for the derivatives, within a "
                f"band of {band[0]:g} to {band[1]:g} Hz; give context, longer realizations or a "
                "lower band"
            )
        lengths = dict.fromkeys(map(len, runs))
        groups = ([run for run in runs if len(run) == length] for length in lengths)
        stacks = tuple(Runs.of(ensemble, np.stack(members), band) for members in groups)
        stop = max(each.clock.max() + each.samples / rate for each in stacks)
        return cls(stacks, min(each.clock.min() for each in stacks), stop)

    def kernel(self, period: float, l1: float, l2: float = ENDLESS) -> Kernel:
        """Return the kernel with the features that matter over the record."""
        return Kernel.of(period, l1, l2, self.start, self.stop, self.stacks[0].rate)

    def with_instrument(self, other: Record) -> Record:
        """Return the record with the angles of another record after its own."""
        pairs = zip(self.stacks, other.stacks, strict=True)
        signals = (np.concatenate([own.signals[:3], z.signals]) for own, z in pairs)
        stacks = map(lambda own, each: attrs.evolve(own, signals=each), self.stacks, signals)
        return attrs.evolve(self, stacks=tuple(stacks))

    @cached_property
    def powers(self) -> Array:
        """Return the summed squares of each signal; the last is the torque."""
        return np.asarray(
            sum(np.einsum("mrt,mrt->m", runs.signals, runs.signals) for runs in self.stacks)
        )

    @property
    def size(self) -> int:
        """Return the number of samples of the torque."""
        return sum(runs.signals[-1].size for runs in self.stacks)

    @property
    def prior(self) -> float:
        """Return the prior precision of the external terms: two over the torque's mean square."""
        return 2 * self.size / (float(self.powers[-1]) or 1.0)

    def sums(self, kernel: Kernel, chosen: Mask, noise: NoiseSpectrum = WHITE) -> Sums:
        """Return weighted sums over the band's frequencies, of the chosen features.

        Real and imaginary parts count separately. Each run has its own external terms.
        """
        size, number = np.count_nonzero(chosen) + 1, 0
        gram = np.zeros((size, size), order="F")
        mixed, powers = [], []
        for runs in self.stacks:
            weights, count = noise.weights(runs.frequency), runs.signals.shape[1]
            terms, power = runs.external_terms(weights)
            of_terms = terms.view(np.float64).T
            between = np.zeros((size * count, EXTERNAL_TERMS))
            for bins, rows in runs.rows(kernel, chosen):
                parts = (rows if noise is WHITE else rows * weights[bins]).view(np.float64)
                flat = parts.reshape(size, -1)
                gram = blas.dsyrk(1.0, flat.T, beta=1.0, c=gram, trans=1, lower=1, overwrite_c=1)
                within = of_terms[2 * bins.start : 2 * bins.stop]
                between += parts.reshape(len(between), -1) @ within
            mixed.append(between.reshape(size, -1))
            powers.append(np.tile(power, count))
            number += 2 * count * len(weights)
        moments = Moments(np.asfortranarray(gram[:-1, :-1]), *Moments.of(gram, number)[1:])
        with_terms = np.concatenate(mixed, axis=1)
        return Sums(moments, with_terms[:-1], with_terms[-1], np.concatenate(powers), self.prior)


def clocks_of(ensemble: Ensemble) -> Array:
    """Return the onset in s of each realization on one clock, with trials one after another."""
    span = float(np.ptp(ensemble.onsets)) + ensemble.duration
    _, number = np.unique(ensemble.trials, return_inverse=True)
    return np.asarray(ensemble.onsets + number * span)


def joined(ensemble: Ensemble, members: Index, context: int) -> Array:
    """Return the angle (run, time) of consecutive realizations, with context at both ends."""
    start, stop = ensemble.core.start, ensemble.core.stop
    before = ensemble.angle[members[:, 0], start - context : start]
    after = ensemble.angle[members[:, -1], stop : stop + context]
    inside = ensemble.angle[members, start:stop].reshape(len(members), -1)
    return np.concatenate([before, inside, after], axis=1)


def lagged(ensemble: Ensemble, lag: float) -> Ensemble:
    """Return an ensemble whose angle passed a first-order lag (time constant in s) in each run.

    Within an unbroken run the lag continues from one realization to the next. The first sample of a
    run's context is taken as the end of a rest; see :func:`tvsysid.numerics.lowpass.low_pass`.
    """
    if lag == 0:
        return ensemble
    angle = np.empty_like(ensemble.angle)
    for realizations in ensemble.runs:
        (whole,) = joined(ensemble, realizations[None], ensemble.context)
        passed = low_pass(whole, lag, ensemble.sampling_rate)
        angle[realizations] = sliding_window_view(passed, angle.shape[1])[:: ensemble.samples]
    return attrs.evolve(ensemble, angle=angle)
