"""A record in unbroken runs, and what kernel-based regression needs of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.fft import rfft
from scipy.linalg import blas

from tvsysid.errors import InputError
from tvsysid.methods.kbr.kernel import Kernel, harmonic_features
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate
from tvsysid.numerics.gaussian import Statistics, fit
from tvsysid.numerics.lowpass import low_pass
from tvsysid.numerics.spectra import half_cosine_spectrum
from tvsysid.signals import Array, Ensemble

ComplexArray = NDArray[np.complex128]
Chosen = NDArray[np.bool_]

DEGREE = math.degrees(1.0)  # 1 N·m/deg in N·m/rad
USUAL = 100.0  # modulus in N·m/rad of the impedance at 1 Hz whose gamma counts in (N·m/deg)²: that of the paper's joint
BLOCK = 2048  # frequencies whose regressors are held at once
STACK = 32  # runs of one length that are transformed together
EXTERNAL_TERMS = 5  # half-cosines over a run, the fastest of two cycles, that make up the smooth external term
LARGEST = 2**31  # bytes above which regressors are refused


class Run(NamedTuple):
    """Unbroken stretches of record of one length: angle and its derivatives, torque, and when they were.

    ``signals`` (derivative, run, time), ``torque`` (run, time), ``rate`` in Hz; ``phase`` and ``clock`` (run,), the
    time in s at the start, since the trial's time 0 and on the record's clock.
    """

    signals: Array
    torque: Array
    rate: float
    phase: Array
    clock: Array

    @classmethod
    def of(cls, ensemble: Ensemble, realizations: NDArray[np.int64], clock: float, order: int) -> Run:
        """Join realizations that follow each other; the derivatives use the context at both ends, or lose samples."""
        assert ensemble.onsets is not None
        rate, used = ensemble.sampling_rate, min(ensemble.context, HALF_WIDTH)
        lost = HALF_WIDTH - used
        torque = ensemble.torque[realizations, ensemble.core].ravel()
        torque = torque[lost : len(torque) - lost]
        signals = np.zeros((order + 1, 0))
        if len(torque):
            signals = differentiate(_joined(ensemble, realizations, used), rate)[: order + 1]
        times = (np.array([onset + lost / rate]) for onset in (float(ensemble.onsets[realizations[0]]), clock))
        return cls(signals[:, None], torque[None], rate, *times)

    def bins(self, band: tuple[float, float]) -> tuple[int, int]:
        """First frequency in the band, and the one after the last."""
        count = self.torque.shape[1]
        low = math.ceil(band[0] * count / self.rate - 1e-9)
        return low, min(math.floor(band[1] * count / self.rate + 1e-9), count // 2) + 1

    def frequencies(self, low: int, high: int) -> Array:
        """Frequencies in Hz of some bins."""
        return np.asarray(np.arange(low, high) * (self.rate / self.torque.shape[1]))

    def output(self, low: int, high: int) -> ComplexArray:
        """Spectrum of the torque (run, bin)."""
        spectrum: ComplexArray = np.ascontiguousarray(rfft(self.torque)[:, low:high])
        return spectrum * (1 / math.sqrt(self.torque.shape[1]))

    def external_terms(self, low: int, high: int) -> ComplexArray:
        """Spectra of the half-cosines that make up the external term, (term, bin)."""
        return _half_cosines(self.torque.shape[1], low, high)

    def in_band(self, kernel: Kernel, kept: Chosen, low: int, high: int) -> Iterator[tuple[int, ComplexArray]]:
        """Regressors kept (column, run, bin), in blocks of frequencies, and the first bin of each.

        In blocks, so that memory does not grow with the record times the columns.
        """
        count = self.torque.shape[1]
        periods = count / self.rate / kernel.period
        shift = round(periods)
        whole = abs(periods - shift) < 1e-9 * periods and high - 1 + kernel.harmonics * shift <= count // 2
        return (self._shifted if whole else self._transformed)(kernel, kept, low, high)

    def _shifted(self, kernel: Kernel, kept: Chosen, low: int, high: int) -> Iterator[tuple[int, ComplexArray]]:
        """Products with harmonics as shifts in frequency: exact where the run holds whole periods."""
        runs, count = self.torque.shape
        shift = round(count / self.rate / kernel.period)
        reach = kernel.harmonics * shift
        below = max(0, reach - low)
        slow = self._slow(kernel)
        # Of each signal and harmonic the first slow functions are kept, since their variances descend.
        order, part, _ = np.transpose(kernel.products)
        cosines = kept & (part == 0) & (kernel.precision > 0)
        used = np.stack([np.bincount(order[row], minlength=kernel.harmonics + 1) for row in cosines])

        def reaching(x: Array) -> ComplexArray:
            """Spectra from bin low - reach to high + reach."""
            spectrum = rfft(x)
            ends = spectrum[..., below:0:-1].conj(), spectrum[..., max(0, low - reach) : high + reach]
            found = np.concatenate(ends, axis=-1)
            found *= 1 / math.sqrt(count)
            return np.asarray(found, dtype=np.complex128)

        # Shape (slow function, run, bin) for each signal. The constant, which comes first, needs no product.
        spectra = [reaching(signal)[None] for signal in self.signals]
        if kernel.decay is not None:
            for place, (signal, most) in enumerate(zip(self.signals, used.max(axis=1), strict=True)):
                spectra[place] = np.concatenate([spectra[place], reaching(signal * slow[1 : 1 + most])])
        first = 0 if kernel.decay is None else 1
        harmonics = np.arange(kernel.harmonics + 1)
        turns = 0.5 * np.exp(2j * np.pi * np.outer(harmonics, self.phase) / kernel.period)[:, :, None]
        length = max(1, BLOCK // runs)
        for start in range(low, high, length):
            bins = min(length, high - start)
            out = np.empty((int(kept.sum()), runs, bins), dtype=np.complex128)
            centre, row = start - low + reach, 0
            for spectrum, counts in zip(spectra, used, strict=True):
                constant = 1 + (counts[0] if first else 0)
                out[row : row + constant] = spectrum[:constant, :, centre : centre + bins]
                row += constant
                for harmonic in harmonics[1:]:
                    many = counts[harmonic]
                    functions = spectrum[first : first + many]
                    up, down = centre - harmonic * shift, centre + harmonic * shift
                    below_it = functions[:, :, up : up + bins] * turns[harmonic]
                    above_it = functions[:, :, down : down + bins] * turns[harmonic].conj()
                    np.add(below_it, above_it, out=out[row : row + many])
                    sine = out[row + many : row + 2 * many]  # 1j times their difference
                    np.subtract(below_it.imag, above_it.imag, out=sine.real)
                    np.subtract(above_it.real, below_it.real, out=sine.imag)
                    row += 2 * many
            yield start - low, out

    def _transformed(self, kernel: Kernel, kept: Chosen, low: int, high: int) -> Iterator[tuple[int, ComplexArray]]:
        """Products with any features, each transformed."""
        runs, count = self.torque.shape
        columns = int(kept.sum())
        size = 16 * columns * runs * (high - low)
        if size > LARGEST:
            raise InputError(
                f"KernelRegression: {columns} regressors over {high - low} frequencies would take "
                f"{size / 2**30:.1f} GiB; give realizations of whole periods, fewer of them, or a longer length_decay"
            )
        slow = self._slow(kernel)
        index = np.arange(count) / self.rate
        periodic = np.stack([harmonic_features(phase + index, kernel.period, kernel.harmonics) for phase in self.phase])
        place, slowness = kernel.places
        out = np.empty((columns, runs, high - low), dtype=np.complex128)
        for row, (signal, column) in enumerate(np.argwhere(kept)):
            feature = periodic[:, :, place[column]] * slow[slowness[column]]
            out[row] = rfft(self.signals[signal] * feature)[:, low:high]
        out /= math.sqrt(count)
        yield 0, out

    def _slow(self, kernel: Kernel) -> Array:
        """Slow functions over each run, shape (function, run, time)."""
        if kernel.decay is None:
            return np.broadcast_to(1.0, (1, *self.torque.shape))
        clock = self.clock[:, None] + np.arange(self.torque.shape[1]) / self.rate
        return kernel.slow_features(clock.ravel()).reshape(-1, *clock.shape)


@lru_cache(maxsize=4)
def _half_cosines(samples: int, low: int, high: int) -> ComplexArray:
    """Spectra of the first half-cosines over so many samples; asked for again with each turn of a fit."""
    terms = np.stack([half_cosine_spectrum(term, samples, low, high) for term in range(EXTERNAL_TERMS)])
    terms *= 1 / math.sqrt(samples)
    terms.flags.writeable = False
    return terms


def lagged(ensemble: Ensemble, lag: float) -> Ensemble:
    """Ensemble whose angle has passed a first-order lag with this time constant in s, in each unbroken run.

    Within a run the lag remembers the realizations before. A run's first sample, that of its context, is taken for the
    end of a rest; see :func:`tvsysid.numerics.lowpass.low_pass`.
    """
    if lag == 0:
        return ensemble
    angle = np.empty_like(ensemble.angle)
    for realizations in ensemble.runs:
        passed = low_pass(_joined(ensemble, realizations, ensemble.context), lag, ensemble.sampling_rate)
        angle[realizations] = sliding_window_view(passed, angle.shape[1])[:: ensemble.samples]
    return replace(ensemble, angle=angle)


def _joined(ensemble: Ensemble, realizations: NDArray[np.int64], context: int) -> Array:
    """Angle of realizations that follow each other, with so much context at both ends."""
    start, stop = ensemble.core.start, ensemble.core.stop
    ends = ensemble.angle[realizations[0], start - context : start], ensemble.angle[realizations[-1], stop:]
    return np.concatenate([ends[0], ensemble.angle[realizations, start:stop].ravel(), ends[1][:context]])


class Record(NamedTuple):
    """A record in ``stacks`` of unbroken runs, from ``start`` to ``stop`` in s; its ``band`` in Hz is fitted."""

    stacks: list[Run]
    start: float
    stop: float
    rate: float
    band: tuple[float, float]

    @classmethod
    def of(cls, ensemble: Ensemble, band: tuple[float, float], order: int) -> Record:
        """With derivatives of the angle up to an order; raises if they, or the band, leave nothing."""
        rate, clocks = ensemble.sampling_rate, clocks_of(ensemble)
        runs = [Run.of(ensemble, joined, float(clocks[joined[0]]), order) for joined in ensemble.runs]
        runs = [run for run in runs if run.torque.shape[1] >= 2]
        if not runs or band[0] >= rate / 2:
            raise InputError(
                f"KernelRegression: nothing is left of realizations of {ensemble.samples} samples at "
                f"{rate:g} Hz after {HALF_WIDTH} at either end for the derivatives, within a band of "
                f"{band[0]:g} to {band[1]:g} Hz; give context, longer realizations or a lower band"
            )
        stop = max(run.clock.max() + run.torque.shape[1] / rate for run in runs)
        return cls(list(_stacked(runs)), min(run.clock.min() for run in runs), stop, rate, band)

    def kernel(self, period: float, l1: float, l2: float = math.inf) -> Kernel:
        """Features that matter over the record."""
        return Kernel.of(period, l1, l2, self.start, self.stop, self.rate)

    def beside(self, other: Record) -> Record:
        """Record with the signals of another after its own, as instruments."""
        pairs = zip(self.stacks, other.stacks, strict=True)
        return self._replace(stacks=[a._replace(signals=np.concatenate([a.signals, b.signals])) for a, b in pairs])

    def up_to(self, order: int) -> Record:
        """Record without the higher derivatives."""
        return self._replace(stacks=[run._replace(signals=run.signals[: order + 1]) for run in self.stacks])

    @property
    def scale(self) -> float:
        """Stiffness in N·m/rad of the data: so much of the impedance at 1 Hz, if it is taken as constant.

        1 N·m/deg for the paper's joint. Unlike the torque over the angle, it does not depend on the perturbation or the
        noise; at 1 Hz, a joint without stiffness has one too.
        """
        constant = Kernel(1.0, None, ((0, 0, 0),), np.zeros(1))
        orders = len(self.stacks[0].signals)
        found = fit(self.statistics(constant, np.ones((orders, 1), dtype=bool)), np.zeros(orders), self.weak_prior)
        modulus = abs(np.polynomial.polynomial.polyval(2j * np.pi, found.mean))
        least = 1e-6 * math.sqrt(self.power / self.powers[0])  # of a torque that does not answer at all
        return DEGREE / USUAL * max(float(modulus), least)

    @property
    def powers(self) -> Array:
        """Summed squares of the angle and its derivatives."""
        orders = range(len(self.stacks[0].signals))
        return np.array([sum(float(np.sum(run.signals[m] ** 2)) for run in self.stacks) for m in orders])

    @property
    def size(self) -> int:
        """Samples of the torque."""
        return sum(run.torque.size for run in self.stacks)

    @property
    def power(self) -> float:
        """Summed squares of the torque."""
        return sum(float(np.vdot(run.torque, run.torque)) for run in self.stacks)

    @property
    def weak_prior(self) -> float:
        """Prior precision of the external terms: one over the torque's mean square."""
        return self.size / (self.power or 1.0)

    def statistics(self, kernel: Kernel, kept: Chosen, weighting: Callable[[Array], Array] | None = None) -> Statistics:
        """Sums over real and imaginary parts of the frequencies in the band, of the features kept.

        ``weighting`` gives weights of frequencies in Hz. Each run has its own external terms; they are turned so that
        they are orthogonal in the band.
        """
        size, square, count = int(kept.sum()), 0.0, 0
        gram, cross = np.zeros((size, size), order="F"), np.zeros(size)
        mixed, shared, powers = [], [], []
        for run in self.stacks:
            low, high = run.bins(self.band)
            runs = len(run.torque)
            output, terms = run.output(low, high), run.external_terms(low, high)
            weights = None if weighting is None else weighting(run.frequencies(low, high))
            if weights is not None:
                output, terms = output * weights, terms * weights
            power, axes = np.linalg.eigh(terms.view(np.float64) @ terms.view(np.float64).T)
            terms = axes.T @ terms
            between = np.zeros((size, runs, EXTERNAL_TERMS))
            for first, products in run.in_band(kernel, kept, low, high):
                block = slice(first, first + products.shape[2])
                weighted = products if weights is None else products * weights[block]
                regressors, target, within = (
                    np.ascontiguousarray(values).view(np.float64)
                    for values in (weighted, output[:, block], terms[:, block])
                )
                flat = regressors.reshape(size, -1)
                gram = blas.dsyrk(1.0, flat.T, beta=1.0, c=gram, trans=1, lower=1, overwrite_c=1)
                cross += flat @ target.ravel()
                between += (regressors.reshape(-1, within.shape[1]) @ within.T).reshape(between.shape)
            mixed.append(between.reshape(size, -1))
            shared.append((output.view(np.float64) @ terms.view(np.float64).T).ravel())
            powers.append(np.tile(np.maximum(power, 0.0), runs))
            square += float(np.sum(np.abs(output) ** 2))
            count += 2 * output.size
        nuisance = np.concatenate(mixed, axis=1), np.concatenate(shared), np.concatenate(powers)
        return Statistics(gram, cross, square, count, *nuisance)


def _stacked(runs: list[Run]) -> Iterator[Run]:
    """Runs of one length together."""
    alike: dict[int, list[Run]] = {}
    for run in runs:
        alike.setdefault(run.torque.shape[1], []).append(run)
    for group in alike.values():
        for first in range(0, len(group), STACK):
            run, *others = group[first : first + STACK]
            if others:  # one by itself needs no copy
                signals, torque, _, phase, clock = zip(run, *others, strict=True)
                times = np.concatenate(phase), np.concatenate(clock)
                run = Run(np.concatenate(signals, axis=1), np.concatenate(torque), run.rate, *times)
            yield run


def clocks_of(ensemble: Ensemble) -> Array:
    """Onset in s of each realization on one clock, on which trials come one after the other."""
    assert ensemble.onsets is not None
    assert ensemble.trials is not None
    span = float(np.ptp(ensemble.onsets)) + ensemble.duration
    _, number = np.unique(ensemble.trials, return_inverse=True)
    return ensemble.onsets + number * span
