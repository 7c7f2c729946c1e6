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
from tvsysid.methods.kbr.external import Sums, fit
from tvsysid.methods.kbr.kernel import ENDLESS, Kernel, harmonic_features
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate
from tvsysid.numerics.gaussian import Moments
from tvsysid.numerics.lowpass import low_pass
from tvsysid.numerics.spectra import half_cosine_spectrum
from tvsysid.signals import Array, Ensemble

ComplexArray = NDArray[np.complex128]
Chosen = NDArray[np.bool_]

DEGREE = math.degrees(1.0)  # 1 N·m/deg in N·m/rad
# modulus in N·m/rad at 1 Hz of the paper's joint, for which gamma counts in (N·m/deg)²
USUAL = 100.0
BLOCK = 512  # frequencies whose regressors are held at once
EXTERNAL_TERMS = (
    5  # half-cosines over a run, the fastest of two cycles, that make up the smooth external term
)
LARGEST = 2**31  # bytes above which regressors are refused


class NoiseSpectrum(NamedTuple):
    """Power of the noise divided by its mean, at frequencies in Hz."""

    frequency: Array
    power: Array

    def weights(self, frequency: Array) -> Array:
        """Return the weights of other frequencies in Hz."""
        return np.asarray(1 / np.sqrt(np.interp(frequency, self.frequency, self.power)))


WHITE = NoiseSpectrum(np.zeros(1), np.ones(1))


@attrs.frozen(eq=False)
class Runs:
    """Unbroken runs of a record, all of one length; the ``band`` in Hz is fitted.

    ``signals`` (signal, run, time) are the angle and its derivatives, then those of an
    instrument if there is one; ``torque`` (run, time); ``rate`` in Hz; ``phase`` and ``clock``
    (run,), the time in s at the start, since the trial's time 0 and on the record's clock.
    Spectra are those of ``norm="ortho"``.
    """

    signals: Array
    torque: Array
    rate: float
    band: tuple[float, float]
    phase: Array
    clock: Array

    @classmethod
    def of(cls, ensemble: Ensemble, members: NDArray[np.int64], band: tuple[float, float]) -> Runs:
        """Join realizations (run, realization).

        The derivatives use the context at both ends, or lose samples.
        """
        assert ensemble.onsets is not None
        rate, first = ensemble.sampling_rate, members[:, 0]
        lost = max(0, HALF_WIDTH - ensemble.context)
        torque = ensemble.torque[members, ensemble.core].reshape(len(members), -1)
        torque = torque[:, lost : torque.shape[1] - lost]
        signals = differentiate(_joined(ensemble, members, min(ensemble.context, HALF_WIDTH)), rate)
        return cls(
            signals,
            torque,
            rate,
            band,
            ensemble.onsets[first] + lost / rate,
            clocks_of(ensemble)[first] + lost / rate,
        )

    @cached_property
    def bins(self) -> slice:
        """Return the bins in the band."""
        low, high = (frequency * self.torque.shape[1] / self.rate for frequency in self.band)
        return slice(
            math.ceil(low - 1e-9), min(math.floor(high + 1e-9), self.torque.shape[1] // 2) + 1
        )

    @property
    def frequency(self) -> Array:
        """Return the frequencies in Hz of the bins."""
        return np.asarray(
            np.arange(self.bins.start, self.bins.stop) * (self.rate / self.torque.shape[1])
        )

    @cached_property
    def spectra(self) -> ComplexArray:
        """Return the spectra of the signals at all frequencies, shape (signal, run, frequency)."""
        return np.asarray(rfft(self.signals, norm="ortho"))

    @cached_property
    def output(self) -> ComplexArray:
        """Return the spectrum of the torque, shape (run, bin)."""
        return np.asarray(rfft(self.torque, norm="ortho")[:, self.bins])

    @property
    def external_terms(self) -> ComplexArray:
        """Return the spectra of the external term's half-cosines, shape (term, bin)."""
        return _half_cosines(self.torque.shape[1], self.bins.start, self.bins.stop)

    def rows(self, kernel: Kernel, chosen: Chosen) -> Iterator[tuple[slice, ComplexArray]]:
        """Yield slices of bins and their regressors, shape (row, run, bin).

        ``chosen`` (signal, column) selects the regressors. The last row is the torque. Blocks of
        frequencies keep memory from growing with the record times the columns.
        """
        count = self.torque.shape[1]
        periods = count / self.rate / kernel.period
        shift = round(periods)
        reach = self.bins.stop - 1 + kernel.highest * shift
        whole = kernel.highest * abs(periods - shift) < 1e-9 * periods and reach <= count // 2
        for bins, out in (self._shifted if whole else self._transformed)(kernel, chosen):
            out[-1] = self.output[:, bins]
            yield bins, out

    def _shifted(self, kernel: Kernel, chosen: Chosen) -> Iterator[tuple[slice, ComplexArray]]:
        """Yield products with harmonics, as shifts in frequency.

        These are exact where a run holds whole periods.
        """
        signal, column = np.nonzero(chosen)
        runs, count = self.torque.shape
        shift = round(count / self.rate / kernel.period)
        reach = kernel.highest * shift
        spectra, source = self.spectra[..., : self.bins.stop + reach], signal
        if kernel.decay is not None:
            slow = self._slow(kernel)
            pairs, source = np.unique(signal * len(slow) + kernel.slow[column], return_inverse=True)
            m, n = divmod(pairs, len(slow))
            spectra = rfft(self.signals[m] * slow[n], norm="ortho")[..., : self.bins.stop + reach]
        spectra = np.concatenate(
            [spectra[..., reach:0:-1].conj(), spectra], axis=-1
        )  # from bin -reach on
        cosine = kernel.sine[column] == 0
        source, harmonic = source[cosine], kernel.harmonic[column[cosine]]
        turn = 0.5 * np.exp(2j * np.pi * np.outer(harmonic, self.phase) / kernel.period)[..., None]
        length = max(1, BLOCK // runs)
        for start in range(self.bins.start, self.bins.stop, length):
            stop = min(start + length, self.bins.stop)
            windows = sliding_window_view(spectra, stop - start, axis=-1)
            up = windows[source, :, start + reach - harmonic * shift]
            down = windows[source, :, start + reach + harmonic * shift]
            up *= turn
            down *= turn.conj()
            out = np.empty((len(column) + 1, runs, stop - start), dtype=np.complex128)
            out[:-1][cosine] = up + down
            up -= down
            up *= -1j
            out[:-1][~cosine] = up[harmonic > 0]
            yield slice(start - self.bins.start, stop - self.bins.start), out

    def _transformed(self, kernel: Kernel, chosen: Chosen) -> Iterator[tuple[slice, ComplexArray]]:
        """Yield products with any features, each transformed."""
        signal, column = np.nonzero(chosen)
        shape = (len(column) + 1, *self.output.shape)
        if (size := 16 * math.prod(shape)) > LARGEST:
            raise InputError(
                f"KernelRegression: {len(column)} regressors over {shape[2]} frequencies would "
                "take "
                f"{size / 2**30:.1f} GiB; give realizations of whole periods, fewer of them, or a "
                "longer length_decay"
            )
        slow = self._slow(kernel)
        periodic = harmonic_features(self._times(self.phase), kernel.period, kernel.highest)
        out = np.empty(shape, dtype=np.complex128)
        for row, m, place, n in zip(
            out, signal, kernel.place[column], kernel.slow[column], strict=False
        ):
            row[:] = rfft(self.signals[m] * periodic[..., place] * slow[n], norm="ortho")[
                :, self.bins
            ]
        yield slice(0, shape[2]), out

    def _slow(self, kernel: Kernel) -> Array:
        """Return the slow functions over each run, shape (function, run, time)."""
        return np.ascontiguousarray(
            np.moveaxis(kernel.slow_features(self._times(self.clock)), -1, 0)
        )

    def _times(self, start: Array) -> Array:
        return np.add.outer(start, np.arange(self.torque.shape[1]) / self.rate)


@lru_cache(maxsize=4)
def _half_cosines(samples: int, low: int, high: int) -> ComplexArray:
    """Return the spectra of the first half-cosines over a number of samples.

    They are cached because each iteration of a fit needs them.
    """
    terms = np.stack(
        [half_cosine_spectrum(term, samples, low, high) for term in range(EXTERNAL_TERMS)]
    )
    terms *= 1 / math.sqrt(samples)
    terms.flags.writeable = False
    return terms


def lagged(ensemble: Ensemble, lag: float) -> Ensemble:
    """Return an ensemble whose angle passed a first-order lag (time constant in s) in each run.

    Within an unbroken run the lag continues from one realization to the next. The first sample of a
    run's context is taken as the end of a rest; see :func:`tvsysid.numerics.lowpass.low_pass`.
    """
    if lag == 0:
        return ensemble
    angle = np.empty_like(ensemble.angle)
    for realizations in ensemble.runs:
        passed = low_pass(
            _joined(ensemble, realizations[None], ensemble.context)[0], lag, ensemble.sampling_rate
        )
        angle[realizations] = sliding_window_view(passed, angle.shape[1])[:: ensemble.samples]
    return attrs.evolve(ensemble, angle=angle)


def _joined(ensemble: Ensemble, members: NDArray[np.int64], context: int) -> Array:
    """Return the angle (run, time) of consecutive realizations, with context at both ends."""
    start, stop = ensemble.core.start, ensemble.core.stop
    before = ensemble.angle[members[:, 0], start - context : start]
    after = ensemble.angle[members[:, -1], stop : stop + context]
    inside = ensemble.angle[members, start:stop].reshape(len(members), -1)
    return np.concatenate([before, inside, after], axis=1)


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
                "at "
                f"{rate:g} Hz after {HALF_WIDTH} at either end for the derivatives, within a band "
                "of "
                f"{band[0]:g} to {band[1]:g} Hz; give context, longer realizations or a lower band"
            )
        groups = (
            [run for run in runs if len(run) == length] for length in dict.fromkeys(map(len, runs))
        )
        stacks = tuple(Runs.of(ensemble, np.stack(members), band) for members in groups)
        stop = max(each.clock.max() + each.torque.shape[1] / rate for each in stacks)
        return cls(stacks, min(each.clock.min() for each in stacks), stop)

    def kernel(self, period: float, l1: float, l2: float = ENDLESS) -> Kernel:
        """Return the kernel with the features that matter over the record."""
        return Kernel.of(period, l1, l2, self.start, self.stop, self.stacks[0].rate)

    def with_instrument(self, other: Record) -> Record:
        """Return the record with the signals of another record after its own."""
        pairs = zip(self.stacks, other.stacks, strict=True)
        return attrs.evolve(
            self,
            stacks=tuple(
                attrs.evolve(a, signals=np.concatenate([a.signals, b.signals])) for a, b in pairs
            ),
        )

    @property
    def scale(self) -> float:
        """Return the stiffness in N·m/rad that corresponds to a gamma of 1.

        It is a fixed share of the modulus at 1 Hz of the constant impedance that fits best: 1
        N·m/deg for the paper's joint. Unlike the torque over the angle, it does not depend on the
        perturbation or the noise. A joint without stiffness also has a modulus at 1 Hz.
        """
        constant = Kernel.of(1.0, math.inf, math.inf, 0.0, 1.0, 1.0)
        found = fit(self.sums(constant, np.ones((3, 1), dtype=bool)), np.zeros(3))
        modulus = abs(np.polynomial.polynomial.polyval(2j * np.pi, found.mean))
        least = 1e-6 * math.sqrt(
            self.power / self.powers[0]
        )  # of a torque that does not answer at all
        return DEGREE / USUAL * max(float(modulus), least)

    @cached_property
    def powers(self) -> Array:
        """Return the summed squares of each signal."""
        return np.asarray(
            sum(np.einsum("mrt,mrt->m", runs.signals, runs.signals) for runs in self.stacks)
        )

    @cached_property
    def power(self) -> float:
        """Return the summed squares of the torque."""
        return sum(float(np.vdot(runs.torque, runs.torque)) for runs in self.stacks)

    @property
    def size(self) -> int:
        """Return the number of samples of the torque."""
        return sum(runs.torque.size for runs in self.stacks)

    @property
    def weak_prior(self) -> float:
        """Return the prior precision of the external terms: one over the torque's mean square."""
        return self.size / (self.power or 1.0)

    def sums(self, kernel: Kernel, chosen: Chosen, noise: NoiseSpectrum = WHITE) -> Sums:
        """Return weighted sums over the band's frequencies, of the chosen features.

        Real and imaginary parts count separately. Each run has its own external terms. They are
        rotated so that they are orthogonal in the band.
        """
        size, number = np.count_nonzero(chosen) + 1, 0
        gram = np.zeros((size, size), order="F")
        mixed, powers = [], []
        for runs in self.stacks:
            weights = noise.weights(runs.frequency)
            terms = runs.external_terms * weights
            power, axes = np.linalg.eigh((terms @ terms.conj().T).real)
            turned = (axes.T @ terms).view(np.float64)
            between = np.zeros((size * len(runs.torque), EXTERNAL_TERMS))
            for bins, rows in runs.rows(kernel, chosen):
                parts = (rows if noise is WHITE else rows * weights[bins]).view(np.float64)
                flat = parts.reshape(size, -1)
                gram = blas.dsyrk(1.0, flat.T, beta=1.0, c=gram, trans=1, lower=1, overwrite_c=1)
                between += (
                    parts.reshape(len(between), -1) @ turned[:, 2 * bins.start : 2 * bins.stop].T
                )
            mixed.append(between.reshape(size, -1))
            powers.append(np.tile(np.maximum(power, 0.0), len(runs.torque)))
            number += 2 * runs.output.size
        nuisance = np.concatenate(mixed, axis=1)
        moments = Moments(np.asfortranarray(gram[:-1, :-1]), *Moments.of(gram, number)[1:])
        return Sums(moments, nuisance[:-1], nuisance[-1], np.concatenate(powers), self.weak_prior)


def clocks_of(ensemble: Ensemble) -> Array:
    """Return the onset in s of each realization on one clock, with trials one after another."""
    assert ensemble.onsets is not None
    assert ensemble.trials is not None
    span = float(np.ptp(ensemble.onsets)) + ensemble.duration
    _, number = np.unique(ensemble.trials, return_inverse=True)
    return ensemble.onsets + number * span
