"""Kernel-based regression (KBR)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft
from scipy.linalg import lapack

from tvsysid.errors import InputError
from tvsysid.methods.base import EXCITED_ABOVE, Method, check_positive, missing_edge, padded
from tvsysid.models import Diagnostics, SecondOrderModel
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate
from tvsysid.numerics.kernels import TOLERANCE, DecayFeatures, harmonic_features, harmonic_variances
from tvsysid.signals import Ensemble

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Preset = Literal["simulation", "experiment"]

PRESETS: dict[str, dict[str, float]] = {
    "simulation": {"length_periodic": math.exp(-2), "length_decay": 120_000.0, "gamma": 4.5},
    "experiment": {"length_periodic": math.exp(-1), "length_decay": 30.0, "gamma": 13.8},
}
"""The paper's settings for its simulated (section 3.2.5) and its experimental study (section 4.2)."""

DEGREES = math.degrees(1.0)
STRICT = 20.0
"""Length of the decay, in lengths of the record, from which on it is under 0.25 % and the kernel strictly periodic."""
EXTERNAL_TERMS = 5
"""Half-cosines over a run, the fastest of two cycles, that make up the smooth external term."""
LARGEST = 2**31
"""Bytes of regressors above which a decay that is short for the record is refused."""


@dataclass(frozen=True)
class KernelRegression(Method):
    r"""Impedance whose change in time is smooth and nearly periodic, fitted in the frequency domain.

    .. math:: y(t) = b_0(t)\,\theta + b_1(t)\,\dot\theta + b_2(t)\,\ddot\theta - f_{ext}(t), \qquad
              b_m = \bar b_m + \tilde b_m, \quad \tilde b_m \sim GP(0, K)

    .. math:: \min_{b} \sum_{k} \frac{|E(k)|^2}{\hat\sigma_E^2} + \sum_m \tilde b_m^T K^{-1} \tilde b_m, \qquad
              K(t, t') = \gamma\, e^{-\sin^2(\pi (t - t') / p) / l_1}\, e^{-(t - t')^2 / l_2^2}

    (equations 13 to 17 of van de Ruit et al. 2021, with Na = 0 and Nb = 2; Cavallo et al. 2020, Lataire et al.
    2017). E is the Fourier transform of the equation error over each unbroken run of realizations, divided by the root
    of its number of samples.

    Parameters
    ----------
    period
        Period p of the behaviour in s; None takes the duration of a realization.
    length_periodic
        l1: smoothness within a period; larger is smoother. It has no unit, although the paper prints seconds.
    length_decay
        l2 in s: time over which periods come to differ.
    gamma
        Prior variance of each coefficient about its mean, **angles counted in degrees**: (N·m/deg)², (N·m·s/deg)²
        and (N·m·s²/deg)². The paper gives no unit. In radians its value of 4.5 would hold stiffness within 2 N·m/rad of a
        constant; in degrees it allows some 120 N·m/rad, and gives figures like the paper's. This is a convention, not a
        reconstruction.
    band
        Lowest and highest frequency in Hz of the equation error that is fitted.

    Notes
    -----
    The kernel is used in a low-rank form: Fourier series with known variances times eigenfunctions of the decay
    (:mod:`tvsysid.numerics.kernels`), which makes the problem a ridge regression with some 80 unknowns. If the decay is
    long against the record, and a run holds whole periods, a product with a harmonic is a shift in frequency, so
    that the four signals are all that is ever transformed.

    The external term is a sum of five half-cosines over a run, with the torque's variance as prior variance each.

    The noise variance is estimated from the residual, with the effective number of parameters taken off, and the fit
    repeated until it stands.
    """

    period: float | None = None
    length_periodic: float = PRESETS["simulation"]["length_periodic"]
    length_decay: float = PRESETS["simulation"]["length_decay"]
    gamma: float = PRESETS["simulation"]["gamma"]
    band: tuple[float, float] = (0.0, 20.0)

    key: ClassVar[str] = "kbr"
    title: ClassVar[str] = "Kernel-based regression"
    assumptions: ClassVar[tuple[str, ...]] = (
        "Stiffness, viscosity and inertia change smoothly and nearly periodically, as the kernel says.",
        "Inertia, viscosity and stiffness are all there is (second order).",
        "The record is continuous; single realizations serve, more improve the estimate.",
    )

    def __post_init__(self) -> None:
        positive = {name: getattr(self, name) for name in ("length_periodic", "length_decay", "gamma")}
        check_positive(self, **positive, **({} if self.period is None else {"period": self.period}))
        try:
            low, high = (float(edge) for edge in self.band)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"KernelRegression: band must be two frequencies in Hz, got {self.band!r}"
            ) from error
        if not 0 <= low < high < math.inf:
            raise InputError(f"KernelRegression: band must rise from 0 Hz or more, got {self.band!r}")

    @classmethod
    def preset(cls, name: Preset, **settings: Any) -> Self:
        """Return the paper's settings for the ``"simulation"`` (the default) or the ``"experiment"``.

        Parameters
        ----------
        name
            Which.
        **settings
            Settings that differ.
        """
        if name not in PRESETS:
            listed = ", ".join(repr(known) for known in PRESETS)
            raise InputError(f"KernelRegression: preset must be one of {listed}; got {name!r}")
        return cls(**(PRESETS[name] | settings))

    def _identify(self, ensemble: Ensemble) -> KernelModel:
        period = ensemble.duration if self.period is None else self.period
        runs = [_Run.of(ensemble, realizations, clock) for realizations, clock in _runs_with_clock(ensemble)]
        runs = [run for run in runs if len(run.torque) >= 2]
        if not runs or self.band[0] >= ensemble.sampling_rate / 2:
            raise InputError(
                f"KernelRegression: nothing is left of realizations of {ensemble.samples} samples at "
                f"{ensemble.sampling_rate:g} Hz after {HALF_WIDTH} at either end for the derivatives, within a band of "
                f"{self.band[0]:g} to {self.band[1]:g} Hz; give context, longer realizations or a lower band"
            )
        first = min(run.clock for run in runs)
        last = max(run.clock + len(run.torque) / ensemble.sampling_rate for run in runs)
        kernel = Kernel.of(period, self.length_periodic, self.length_decay, first, last, ensemble.sampling_rate)

        size = 3 * kernel.columns + EXTERNAL_TERMS * len(runs)
        gram, cross, square, bins = np.zeros((size, size)), np.zeros(size), 0.0, 0
        for number, run in enumerate(runs):
            regressors, output = run.in_band(kernel, self.band, ensemble.sampling_rate)
            used = np.r_[: 3 * kernel.columns, 3 * kernel.columns + EXTERNAL_TERMS * number + np.arange(EXTERNAL_TERMS)]
            gram[np.ix_(used, used)] += regressors @ regressors.T
            cross[used] += regressors @ output
            square += float(output @ output)
            bins += len(output) // 2
        power = float(np.mean(np.concatenate([run.torque for run in runs]) ** 2))
        precision = np.concatenate(
            [np.tile(kernel.precision / self.gamma, 3), np.full(EXTERNAL_TERMS * len(runs), 1 / (power or 1.0))]
        )
        fit = _fit(gram, cross, square, bins, precision)

        unit = DEGREES
        coefficients = fit.mean[: 3 * kernel.columns] * unit
        covariance = fit.covariance[: 3 * kernel.columns, : 3 * kernel.columns] * unit**2
        # Where the derivatives lack samples at the ends of every run, nothing was identified.
        missing = missing_edge(HALF_WIDTH, ensemble) if all(run.realizations == 1 for run in runs) else 0
        features = np.mean([kernel(*_times(ensemble, r)) for r in _distinct(ensemble, kernel)], axis=0)
        impedance = features @ coefficients.reshape(3, kernel.columns).T
        inner = padded(impedance[missing : len(impedance) - missing], missing)
        labels = tuple(f"{name} {j}" for name in ("stiffness", "viscosity", "inertia") for j in range(kernel.columns))
        return KernelModel(
            method=repr(self),
            sampling_rate=ensemble.sampling_rate,
            time=ensemble.time,
            stiffness=inner[:, 0],
            viscosity=inner[:, 1],
            inertia=inner[:, 2],
            coefficients=coefficients,
            covariance=covariance,
            labels=labels,
            kernel=kernel,
            diagnostics=Diagnostics(
                fit.effective, details={"noise_variance": fit.noise_variance, "iterations": fit.iterations}
            ),
        )

    def _needed_band(self, ensemble: Ensemble) -> tuple[float, float]:
        return self.band[1], max(self.band[0], EXCITED_ABOVE)

    def _doubts(self, ensemble: Ensemble) -> Iterator[str]:
        period = ensemble.duration if self.period is None else self.period
        if abs(ensemble.duration / period - round(ensemble.duration / period)) > 1e-6:
            yield (
                f"a realization of {ensemble.duration:g} s is not a whole number of periods of {period:g} s: the "
                "stiffness over a realization is a mean over different phases of the behaviour"
            )


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class KernelModel(SecondOrderModel):
    """Impedance as a function of time that holds at any time.

    ``stiffness``, ``viscosity`` and ``inertia`` are means over the realizations that it was identified from. A
    prediction uses the impedance at the time of each realization.

    Parameters
    ----------
    kernel
        Features of time that the coefficients multiply.
    """

    kernel: Kernel

    def impedance(self, ensemble: Ensemble) -> tuple[Array, Array, Array]:
        """Stiffness, viscosity and inertia at the ensemble's own times, (time,) or (realization, time)."""
        if self.kernel.decay is None:
            return super().impedance(ensemble)
        clocks = _clocks(ensemble)
        coefficients = self.coefficients.reshape(3, self.kernel.columns).T
        features = [self.kernel(*_times(ensemble, r, clocks)) for r in range(len(ensemble))]
        values = np.stack([feature @ coefficients for feature in features])
        return values[..., 0], values[..., 1], values[..., 2]


@dataclass(frozen=True, eq=False)
class Kernel:
    """Features of the locally periodic kernel: a constant without prior, harmonics, times decay if there is one.

    Parameters
    ----------
    period
        In s.
    harmonics
        How many.
    decay
        Features of the decay; None where the kernel is strictly periodic.
    precision
        Prior precision of each column for gamma = 1, shape (column,).
    kept
        Which products of harmonic and decay features are columns, beside the first constant.
    """

    period: float
    harmonics: int
    decay: DecayFeatures | None
    precision: Array
    kept: NDArray[np.bool_]

    @classmethod
    def of(cls, period: float, l1: float, l2: float, first: float, last: float, rate: float) -> Kernel:
        """Features that matter over the record, from its first to its last time in s."""
        variances = harmonic_variances(l1)
        # Harmonics beyond the Nyquist frequency would be aliases of slower ones.
        variances = variances[: max(1, math.ceil(period * rate / 2))]
        each = np.concatenate([variances[:1], np.repeat(variances[1:], 2)])
        if l2 >= STRICT * (last - first):
            # The kernel's own constant adds nothing to the one without prior.
            kept = np.arange(len(each)) > 0
            return cls(period, len(variances) - 1, None, np.concatenate([[0.0], 1 / each[1:]]), kept)
        decay = DecayFeatures(first, last, l2)
        share = np.outer(each, decay.variances / decay.variances.sum()).ravel()
        kept = share > TOLERANCE
        spread = np.repeat(each, len(decay.variances))[kept]
        return cls(period, len(variances) - 1, decay, np.concatenate([[0.0], 1 / spread]), kept)

    @property
    def columns(self) -> int:
        """Features of each coefficient."""
        return len(self.precision)

    def __call__(self, phase: Array, clock: Array) -> Array:
        """Features at times in s: of the periodic behaviour, and of the record; shape (time, column)."""
        periodic = harmonic_features(phase, self.period, self.harmonics)
        if self.decay is None:
            return periodic
        products = (periodic[:, :, None] * self.decay(clock)[:, None, :]).reshape(len(phase), -1)
        return np.concatenate([np.ones((len(phase), 1)), products[:, self.kept]], axis=1)


class _Fit(NamedTuple):
    mean: Array
    covariance: Array
    noise_variance: float
    effective: float
    iterations: int


def _fit(gram: Array, cross: Array, square: float, bins: int, precision: Array) -> _Fit:
    r"""Minimise :math:`|E|^2 / \sigma^2 + c^T P c`, the noise variance being that of the complex residual.

    ``gram``, ``cross`` and ``square`` are sums over real and imaginary parts of the bins.
    """
    scale = 1 / np.sqrt(np.where(np.diag(gram) > 0, np.diag(gram), 1.0))
    gram, cross, precision = gram * np.outer(scale, scale), cross * scale, precision * scale**2
    floor = 1e-14 * square / bins
    noise, iteration = max(square / bins * 1e-3, floor), 0
    for iteration in range(1, 31):
        system = gram + np.diag(noise * precision)
        factor, failed = lapack.dpotrf(system, lower=1)
        if failed:  # columns without power, or alike to rounding
            factor, _ = lapack.dpotrf(system + 1e-11 * np.eye(len(system)), lower=1)
        mean = lapack.dpotrs(factor, cross, lower=1)[0]
        inverse = lapack.dpotri(factor, lower=1)[0]
        lower = np.tril(inverse, -1)
        inverse = lower + lower.T + np.diag(np.diag(inverse))
        effective = float(np.sum(inverse * gram))
        residual = max(square - 2 * float(mean @ cross) + float(mean @ gram @ mean), 0.0)
        before, noise = noise, max(2 * residual / max(2 * bins - effective, 1.0), floor)
        if abs(noise - before) <= 1e-6 * noise:
            break
    return _Fit(mean * scale, noise * inverse * np.outer(scale, scale), noise, effective, iteration)


class _Run(NamedTuple):
    """An unbroken stretch of record: angle and its derivatives (in degrees), torque, and when it was."""

    signals: Array
    torque: Array
    phase: float
    clock: float
    realizations: int

    @classmethod
    def of(cls, ensemble: Ensemble, realizations: NDArray[np.int64], clock: float) -> _Run:
        """Join realizations that follow each other; the derivatives use the context at both ends, or lose samples."""
        assert ensemble.onsets is not None
        used = min(ensemble.context, HALF_WIDTH)
        start, stop = ensemble.core.start, ensemble.core.stop

        def joined(x: Array) -> Array:
            ends = x[realizations[0], start - used : start], x[realizations[-1], stop : stop + used]
            return np.concatenate([ends[0], x[realizations, start:stop].ravel(), ends[1]])

        lost = HALF_WIDTH - used
        torque = ensemble.torque[realizations, start:stop].ravel()
        torque = torque[lost : len(torque) - lost]
        signals = np.zeros((3, 0))
        if len(torque):
            signals = differentiate(joined(ensemble.angle), ensemble.sampling_rate) * DEGREES
        shift = lost / ensemble.sampling_rate
        onset = float(ensemble.onsets[realizations[0]])
        return cls(signals, torque, onset + shift, clock + shift, len(realizations))

    def in_band(self, kernel: Kernel, band: tuple[float, float], rate: float) -> tuple[Array, Array]:
        """Regressors (column, bin) and output (bin,): Fourier coefficients in the band, real and imaginary parts."""
        count = len(self.torque)
        low = math.ceil(band[0] * count / rate - 1e-9)
        high = min(math.floor(band[1] * count / rate + 1e-9), count // 2) + 1
        root = 1 / math.sqrt(count)
        columns = 3 * kernel.columns
        regressors = np.empty((columns + EXTERNAL_TERMS, high - low), dtype=np.complex128)
        periods = count / rate / kernel.period
        shift = round(periods)
        if kernel.decay is None and abs(periods - shift) < 1e-9 * periods and (
            high - 1 + kernel.harmonics * shift <= count // 2
        ):
            self._shifted(regressors[:columns], kernel, low, shift)
        else:
            self._transformed(regressors[:columns], kernel, low, rate)
        time = (np.arange(count) + 0.5) / count
        for term in range(EXTERNAL_TERMS):
            regressors[columns + term] = rfft(np.cos(np.pi * term * time))[low:high]
        regressors *= root
        output = rfft(self.torque)[low:high] * root
        return regressors.view(np.float64), output.view(np.float64)

    def _shifted(self, out: ComplexArray, kernel: Kernel, low: int, shift: int) -> None:
        """Products with harmonics as shifts in frequency: exact where the run holds whole periods."""
        bins = out.shape[1]
        reach = kernel.harmonics * shift
        for order, signal in enumerate(self.signals):
            spectrum = rfft(signal)
            below = max(0, reach - low)
            wide = np.concatenate([spectrum[below:0:-1].conj(), spectrum[max(0, low - reach) : low + bins + reach]])
            rows = out[order * kernel.columns : (order + 1) * kernel.columns]
            rows[0] = wide[reach : reach + bins]
            for harmonic in range(1, kernel.harmonics + 1):
                turn = 0.5 * np.exp(2j * np.pi * harmonic * self.phase / kernel.period)
                up = turn * wide[reach - harmonic * shift :][:bins]
                down = np.conj(turn) * wide[reach + harmonic * shift :][:bins]
                np.add(up, down, out=rows[2 * harmonic - 1])
                np.subtract(up, down, out=rows[2 * harmonic])
                rows[2 * harmonic] *= -1j

    def _transformed(self, out: ComplexArray, kernel: Kernel, low: int, rate: float) -> None:
        """Products with any features, each transformed."""
        if out.nbytes > LARGEST:
            raise InputError(
                f"KernelRegression: {out.shape[0]} regressors over {out.shape[1]} frequencies would take "
                f"{out.nbytes / 2**30:.1f} GiB; give fewer realizations, a longer length_decay or a larger "
                "length_periodic"
            )
        index = np.arange(len(self.torque)) / rate
        features = kernel(self.phase + index, self.clock + index)
        for column, feature in enumerate(features.T):
            for order, signal in enumerate(self.signals):
                transformed = rfft(signal * feature)
                out[order * kernel.columns + column] = transformed[low : low + out.shape[1]]


def _clocks(ensemble: Ensemble) -> Array:
    """Onset in s of each realization on one clock, on which trials come one after the other."""
    assert ensemble.onsets is not None
    assert ensemble.trials is not None
    span = float(np.ptp(ensemble.onsets)) + ensemble.duration
    _, number = np.unique(ensemble.trials, return_inverse=True)
    return ensemble.onsets + number * span


def _runs_with_clock(ensemble: Ensemble) -> Iterator[tuple[NDArray[np.int64], float]]:
    clocks = _clocks(ensemble)
    for realizations in ensemble.runs:
        yield realizations, float(clocks[realizations[0]])


def _times(ensemble: Ensemble, realization: int, clocks: Array | None = None) -> tuple[Array, Array]:
    """Times of a realization's samples: since the trial's time 0, and on the record's clock."""
    assert ensemble.onsets is not None
    clocks = _clocks(ensemble) if clocks is None else clocks
    return ensemble.onsets[realization] + ensemble.time, clocks[realization] + ensemble.time


def _distinct(ensemble: Ensemble, kernel: Kernel) -> range | list[int]:
    """Realizations whose features differ: one where all begin at the same phase of a strictly periodic kernel."""
    assert ensemble.onsets is not None
    turns = ensemble.onsets / kernel.period
    same = kernel.decay is None and np.ptp(turns - np.round(turns)) < 1e-9
    return [0] if same else range(len(ensemble))
