"""Kernel-based regression (KBR)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft
from scipy.linalg import blas
from scipy.optimize import minimize
from scipy.signal import firwin

from tvsysid.errors import InputError
from tvsysid.impedance import derivative_filters
from tvsysid.methods.base import EXCITED_ABOVE, Method, check_positive, missing_edge, padded
from tvsysid.methods.evidence import Evidence
from tvsysid.methods.residuals import colour, residual
from tvsysid.models import Diagnostics, SecondOrderModel, Spread
from tvsysid.numerics.bands import arc_length
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate
from tvsysid.numerics.gaussian import Fit, Statistics, fit, log_evidence, of_columns, without_nuisance
from tvsysid.numerics.kernels import (
    TOLERANCE,
    DecayFeatures,
    harmonic_features,
    harmonic_variances,
    log_harmonic_variances,
)
from tvsysid.numerics.noise import power_in_band
from tvsysid.numerics.spectra import half_cosine_spectrum
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
"""Length of the decay, in lengths of the record, from which on the kernel is taken as strictly periodic."""
BLOCK = 2048
"""Frequencies whose regressors are held at once."""
STACK = 32
"""Runs of one length that are transformed together."""
VISIBLE = 0.03
"""Share of the noise that a feature's part of the torque must be able to reach to be fitted at all."""
GUESS = 1e-2
"""Share of the torque's power that the noise is taken to have at least, until it is known."""
EXTERNAL_TERMS = 5
"""Half-cosines over a run, the fastest of two cycles, that make up the smooth external term."""
ENDLESS = PRESETS["simulation"]["length_decay"]
"""Decay in s that stands for none."""
LENGTHS = np.geomspace(0.002, 30.0, 12)
"""Periodic lengths of which a tuned one is the best."""
DECAYS = (4.0, 2.0, 1.0, 0.5, 0.25, 0.125)
"""Decays that are tried, in lengths of the record."""
START = 1e3
"""Power of the torque that each coefficient makes, in noise variances, from which tuning sets out."""
LEEWAY = 100.0
"""Factor by which a decay may enlarge a prior variance."""
NOISES = 20
"""Steps of the noise variance at most, for settings that are given."""
MOST = 2000
"""Coefficients beyond which a decay is not tried, and settings that were given are not compared."""
CLEARLY = 5.0
"""Log marginal likelihood by which a decay must be worse for shorter ones not to be tried."""
FAINT = 1e-7
"""Share of the noise below which a feature's part of the torque does not count in the likelihood."""
LARGEST = 2**31
"""Bytes above which regressors, or their Gram matrix, are refused."""


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
        Prior variance about their means of stiffness, viscosity and inertia, or one number for all three, **angles
        counted in degrees**: (N·m/deg)², (N·m·s/deg)² and (N·m·s²/deg)². The paper gives one, without a unit. In
        radians its value of 4.5 would hold stiffness within 2 N·m/rad of a constant; in degrees it allows some
        120 N·m/rad, and gives figures like the paper's. This is a convention, not a reconstruction.
    band
        Lowest and highest frequency in Hz of the equation error that is fitted.

    Notes
    -----
    The kernel is used in a low-rank form: Fourier series with known variances times eigenfunctions of the decay
    (:mod:`tvsysid.numerics.kernels`), which makes the problem a ridge regression with some 110 unknowns. Where a run
    holds whole periods, a product with a harmonic is a shift in frequency, so that only the signals times the
    eigenfunctions are ever transformed.

    From a decay of 20 record lengths on, the kernel is taken as strictly periodic, as the paper's 120 000 s is meant.
    The kernel itself then falls by under 0.25 % over the record; but with gamma in degrees even that lets inertia
    drift freely, and the dense solution with the decay kept differs by up to 1 N·m/rad of stiffness for 20 s of data.

    The external term is a sum of five half-cosines over a run, with the torque's variance as prior variance each.

    What cannot reach a small share of the noise in the torque is left out (:data:`VISIBLE`), for each coefficient by
    its own signal: of a gamma that inertia and stiffness have in common, inertia needs some twice as many features. Of
    their coefficients the prior is all that is known. It changes stiffness by some 1e-3 N·m/rad.

    Its cost grows with the cube of the record where the decay is short against it: of 600 s at 30 s there are 3800
    coefficients, which take some 10 s.

    The noise variance is estimated from the residual, with the effective number of parameters taken off.

    The bands are those of the posterior, which takes the noise as white within the band, times a factor for its colour
    (:func:`tvsysid.numerics.noise.colour_factors`). The posterior counts what the prior smooths away only as far as the
    behaviour is as smooth as the kernel says: about a switch, the truth lies outside.
    """

    period: float | None = None
    length_periodic: float = PRESETS["simulation"]["length_periodic"]
    length_decay: float = PRESETS["simulation"]["length_decay"]
    gamma: float | tuple[float, float, float] = PRESETS["simulation"]["gamma"]
    band: tuple[float, float] = (0.0, 20.0)

    key: ClassVar[str] = "kbr"
    contiguous: ClassVar[bool] = True
    title: ClassVar[str] = "Kernel-based regression"
    assumptions: ClassVar[tuple[str, ...]] = (
        "Stiffness, viscosity and inertia change smoothly and nearly periodically, as the kernel says.",
        "Inertia, viscosity and stiffness are all there is (second order).",
        "The record is continuous; single realizations serve, more improve the estimate.",
    )

    def __post_init__(self) -> None:
        positive = {name: getattr(self, name) for name in ("length_periodic", "length_decay")}
        check_positive(self, **positive, **({} if self.period is None else {"period": self.period}))
        several = self.gamma if isinstance(self.gamma, tuple) else (self.gamma,) * 3
        if len(several) != 3:
            raise InputError(
                "KernelRegression: gamma must be one number, or three: of stiffness, viscosity and inertia; got "
                f"{self.gamma!r}"
            )
        for gamma in several:
            check_positive(self, gamma=gamma)
        try:
            low, high = (float(edge) for edge in self.band)
        except (TypeError, ValueError) as error:
            raise InputError(f"KernelRegression: band must be two frequencies in Hz, got {self.band!r}") from error
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
        period = self._period(ensemble)
        stacks, start, stop = self._stacks(ensemble)
        kernel = Kernel.of(period, self.length_periodic, self.length_decay, start, stop, ensemble.sampling_rate)
        fit, kept = self._fit(stacks, kernel, ensemble.sampling_rate)

        # Of coefficients that the data cannot see, the prior is all that is known.
        coefficients = np.zeros(kept.size)
        coefficients[kept.ravel()] = fit.mean
        covariance = np.diag(0.5 * np.outer(self._gammas, _inverse(kernel.precision)).ravel())
        covariance[np.ix_(kept.ravel(), kept.ravel())] = fit.covariance
        coefficients *= DEGREES
        covariance *= DEGREES**2
        # Where the derivatives lack samples at the ends of every run, nothing was identified.
        missing = missing_edge(HALF_WIDTH, ensemble) if all(len(run) == 1 for run in ensemble.runs) else 0
        clocks = _clocks(ensemble)
        distinct = _distinct(ensemble, kernel)
        impedance = np.zeros((ensemble.samples, 3))
        for realization in distinct:
            impedance += kernel.combined(*_times(ensemble, realization, clocks), coefficients) / len(distinct)

        def spread() -> Spread:
            features = np.mean([kernel(*_times(ensemble, r, clocks)) for r in distinct], axis=0)
            return _spread(ensemble, self.band, impedance, features, covariance, fit, missing)

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
            phase=_common_phase(ensemble, period),
            spread=spread,
            diagnostics=Diagnostics(
                fit.effective, details={"noise_variance": fit.noise_variance, "iterations": fit.iterations}
            ),
        )

    @property
    def _gammas(self) -> Array:
        return np.broadcast_to(np.asarray(self.gamma, dtype=np.float64), 3)

    def _period(self, ensemble: Ensemble) -> float:
        return ensemble.duration if self.period is None else self.period

    def _stacks(self, ensemble: Ensemble) -> tuple[list[_Run], float, float]:
        """Unbroken runs of the record, and its first and last time in s."""
        runs = [_Run.of(ensemble, realizations, clock) for realizations, clock in _runs_with_clock(ensemble)]
        runs = [run for run in runs if run.torque.shape[1] >= 2]
        if not runs or self.band[0] >= ensemble.sampling_rate / 2:
            raise InputError(
                f"KernelRegression: nothing is left of realizations of {ensemble.samples} samples at "
                f"{ensemble.sampling_rate:g} Hz after {HALF_WIDTH} at either end for the derivatives, within a band of "
                f"{self.band[0]:g} to {self.band[1]:g} Hz; give context, longer realizations or a lower band"
            )
        stop = max(run.clock.max() + run.torque.shape[1] / ensemble.sampling_rate for run in runs)
        return list(_stacked(runs)), min(run.clock.min() for run in runs), stop

    def _fit(self, stacks: list[_Run], kernel: Kernel, rate: float) -> tuple[Fit, NDArray[np.bool_]]:
        """Fit the coefficients that the data can see, and say which these are, shape (3, column)."""
        size = sum(run.torque.size for run in stacks)
        powers = _powers(stacks)
        power = sum(float(np.vdot(run.torque, run.torque)) for run in stacks)
        bins = max(1.0, size * min(self.band[1] / rate, 0.5))
        noise = GUESS * 0.5 * power / bins
        while True:
            kept = kernel.visible(self._gammas * powers, VISIBLE * noise)
            count = int(kept.sum())
            if 8 * count**2 > LARGEST:
                raise InputError(
                    f"KernelRegression: a decay of {self.length_decay:g} s over a record of "
                    f"{size / rate:g} s needs {count} coefficients, too many to solve for; give fewer realizations or "
                    "a longer length_decay"
                )
            precision = np.outer(1 / self._gammas, kernel.precision)[kept]
            found = fit(_statistics(stacks, kernel, kept, self.band, rate), precision, _weak(stacks))
            if found.noise_variance >= noise or kept.all():
                return found, kept
            noise = 0.5 * found.noise_variance

    def _evidence(self, ensemble: Ensemble, seed: int) -> Evidence:
        """Marginal likelihood: highest over l1 without decay, then with shorter and shorter decays.

        ``seed`` is not needed: all starts are fixed.
        """
        rate, period = ensemble.sampling_rate, self._period(ensemble)
        stacks, start, stop = self._stacks(ensemble)
        endless = Kernel.of(period, self.length_periodic, math.inf, start, stop, rate)
        about = self._fit(stacks, endless, rate)[0].noise_variance
        noise, powers = math.log(about), _powers(stacks)

        def likelihood_of(kernel: Kernel, gammas: Array) -> _Likelihood | None:
            kept = kernel.visible(gammas * powers, VISIBLE * about)
            return None if int(kept.sum()) > MOST else _Likelihood.of(stacks, kernel, kept, self.band, rate, about)

        own = Kernel.of(period, self.length_periodic, self.length_decay, start, stop, rate)
        given, before = likelihood_of(own, self._gammas), math.nan
        theta = np.array([math.log(self.length_periodic), *np.log(self._gammas), noise])
        if given is not None:
            theta[4], before = given.best_noise(theta)
        tried = [_Tried(self.length_decay, theta, before)]

        # No harmonic is shared by two lengths, but its variance: all lengths have one Gram matrix.
        kernel = Kernel.of(period, LENGTHS[0], math.inf, start, stop, rate)
        everything = np.ones((3, kernel.columns), dtype=bool)
        strict = _Likelihood.of(stacks, kernel, everything, self.band, rate, about)
        # Of each coefficient so much that the torque it makes is a thousand times the noise.
        loose = np.array([0.0, *(math.log(START) + noise - np.log(powers)), noise])
        near = loose
        for length in LENGTHS:
            climbs = [strict.climb(theta, length) for theta in ((loose,) if near is loose else (loose, near))]
            best = max(climbs, key=lambda climbed: climbed.value)
            near = best.theta
            tried.append(best)
        tried.append(strict.climb(max(tried[1:], key=lambda climbed: climbed.value).theta))

        for share in DECAYS:
            best = max(tried[1:], key=lambda climbed: climbed.value)
            decay = float(share * (stop - start))
            kernel = Kernel.of(period, math.exp(best.theta[0]), decay, start, stop, rate)
            likelihood = likelihood_of(kernel, LEEWAY * np.exp(best.theta[1:4])) if decay >= 2 * period else None
            if likelihood is None:
                break
            tried.append(likelihood.climb(best.theta, decay=decay, leeway=math.log(LEEWAY)))
            if tried[-1].value < best.value - CLEARLY:
                break
        values = np.array([each.value for each in tried])
        return Evidence(
            criterion="log marginal likelihood",
            unit="nat",
            better="higher",
            tried=(
                {name: getattr(self, name) for name in ("length_periodic", "length_decay", "gamma")},
                *(each.settings() for each in tried[1:]),
            ),
            values=values,
            standard_errors=np.full(len(values), math.nan),
            chosen=int(np.nanargmax(values)),
            axis="length_periodic",
            positions=np.exp([each.theta[0] for each in tried]),
            lines=(
                "as given",
                *(f"decay {each.decay:.3g} s" if each.decay < ENDLESS else "no decay" for each in tried[1:]),
            ),
        )

    def _needed_band(self, ensemble: Ensemble) -> tuple[float, float]:
        return self.band[1], max(self.band[0], EXCITED_ABOVE)

    def _doubts(self, ensemble: Ensemble) -> Iterator[str]:
        period = self._period(ensemble)
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
    phase
        Phase in s at which all realizations that it was identified from begin; NaN if they begin at different ones.
    """

    kernel: Kernel
    phase: float

    def impedance(self, ensemble: Ensemble) -> tuple[Array, Array, Array]:
        """Stiffness, viscosity and inertia at the ensemble's own times, (time,) or (realization, time)."""
        if self.kernel.decay is None and _common_phase(ensemble, self.kernel.period) == self.phase:
            return super().impedance(ensemble)
        clocks = _clocks(ensemble)
        values = np.stack(
            [self.kernel.combined(*_times(ensemble, r, clocks), self.coefficients) for r in range(len(ensemble))]
        )
        return values[..., 0], values[..., 1], values[..., 2]


@dataclass(frozen=True, eq=False)
class Kernel:
    """Features of the locally periodic kernel: products of a harmonic of the period and a slow function of time.

    Parameters
    ----------
    period
        In s.
    decay
        The slow functions beside the constant; None where the kernel is strictly periodic.
    products
        Harmonic, part (0 for cosine, 1 for sine) and slow function of each column. The first column is the constant
        without prior.
    precision
        Prior precision of each column for gamma = 1, shape (column,); 0 for the first.
    """

    period: float
    decay: DecayFeatures | None
    products: tuple[tuple[int, int, int], ...]
    precision: Array

    def __post_init__(self) -> None:
        self.precision.flags.writeable = False

    @classmethod
    def of(cls, period: float, l1: float, l2: float, first: float, last: float, rate: float) -> Kernel:
        """Features that matter over the record, from its first to its last time in s."""
        variances = harmonic_variances(l1)
        # Harmonics beyond the Nyquist frequency would be aliases of slower ones.
        variances = variances[: max(1, math.ceil(period * rate / 2))]
        parts = [(harmonic, part) for harmonic in range(len(variances)) for part in ((0, 1) if harmonic else (0,))]
        if l2 >= STRICT * (last - first):
            # Of the constant one column is enough: that without prior.
            products = [(harmonic, part, 0) for harmonic, part in parts]
            return cls(period, None, tuple(products), np.array([0.0, *(1 / variances[h] for h, _ in parts[1:])]))
        decay = DecayFeatures(first, last, l2)
        products = [
            (harmonic, part, 1 + slow)
            for harmonic, part in parts
            for slow, share in enumerate(decay.variances)
            if variances[harmonic] * share > TOLERANCE
        ]
        precision = [0.0, *(1 / variances[harmonic] for harmonic, _, _ in products)]
        return cls(period, decay, ((0, 0, 0), *products), np.array(precision))

    @property
    def columns(self) -> int:
        """Features of each coefficient."""
        return len(self.products)

    @cached_property
    def harmonics(self) -> int:
        """Highest harmonic of the period."""
        return max(harmonic for harmonic, _, _ in self.products)

    def slow_features(self, clock: Array) -> Array:
        """Constant and slow functions at times of the record in s, shape (function, time)."""
        constant = np.ones((1, len(clock)))
        return constant if self.decay is None else np.concatenate([constant, self.decay(clock).T])

    def visible(self, power: Array, noise: float) -> NDArray[np.bool_]:
        """Features whose part of the torque may reach a share of the noise, shape (signal, column).

        Parameters
        ----------
        power
            Prior variance of each signal's coefficient times the signal's summed squares, shape (signal,).
        noise
            That share, as a sum of squares.
        """
        with np.errstate(divide="ignore"):
            return np.asarray(np.outer(power, 1 / self.precision) >= noise)

    def __call__(self, phase: Array, clock: Array) -> Array:
        """Features at times in s: of the periodic behaviour, and of the record; shape (time, column)."""
        periodic = harmonic_features(phase, self.period, self.harmonics)
        slow = self.slow_features(clock)
        place, slowness = self._places
        return np.asarray(periodic[:, place] * slow[slowness].T)

    def combined(self, phase: Array, clock: Array, coefficients: Array) -> Array:
        """Sums of features times coefficients (signal x column), without the features; shape (time, signal)."""
        weights = np.zeros((2 * self.harmonics + 1, 3, 1 if self.decay is None else 1 + len(self.decay.variances)))
        place, slowness = self._places
        weights[place, :, slowness] = coefficients.reshape(3, self.columns).T
        of_harmonics = np.tensordot(self.slow_features(clock), weights, axes=(0, 2))  # (time, harmonic, signal)
        return np.asarray(np.einsum("th,thm->tm", harmonic_features(phase, self.period, self.harmonics), of_harmonics))

    @cached_property
    def _places(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Column of :func:`harmonic_features` and row of :meth:`slow_features` that make each feature."""
        harmonic, part, slowness = np.array(self.products).T
        return np.maximum(0, 2 * harmonic - 1 + part), slowness


class _Run(NamedTuple):
    """Unbroken stretches of record of one length: angle and its derivatives (in degrees), torque, and when they were.

    ``signals`` (order, run, time), ``torque`` (run, time), ``phase`` and ``clock`` (run,) in s of the first samples.
    """

    signals: Array
    torque: Array
    phase: Array
    clock: Array

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
            signals = differentiate(joined(ensemble.angle), ensemble.sampling_rate)
            signals *= DEGREES
        shift = lost / ensemble.sampling_rate
        onset = float(ensemble.onsets[realizations[0]])
        return cls(signals[:, None], torque[None], np.array([onset + shift]), np.array([clock + shift]))

    def bins(self, band: tuple[float, float], rate: float) -> tuple[int, int]:
        """First frequency in the band, and the one after the last."""
        count = self.torque.shape[1]
        low = math.ceil(band[0] * count / rate - 1e-9)
        return low, min(math.floor(band[1] * count / rate + 1e-9), count // 2) + 1

    def in_band(self, kernel: Kernel, kept: NDArray[np.bool_], low: int, high: int, rate: float) -> Iterator[_Block]:
        """Fourier coefficients of the regressors kept, shape (column, run, bin), in blocks of frequencies.

        In blocks, so that memory does not grow with the record times the columns.
        """
        count = self.torque.shape[1]
        periods = count / rate / kernel.period
        shift = round(periods)
        whole = abs(periods - shift) < 1e-9 * periods and high - 1 + kernel.harmonics * shift <= count // 2
        yield from (self._shifted if whole else self._transformed)(kernel, kept, low, high, rate)

    def _shifted(self, kernel: Kernel, kept: NDArray[np.bool_], low: int, high: int, rate: float) -> Iterator[_Block]:
        """Products with harmonics as shifts in frequency: exact where the run holds whole periods."""
        runs, count = self.torque.shape
        shift = round(count / rate / kernel.period)
        reach = kernel.harmonics * shift
        below = max(0, reach - low)
        slow = self._slow(kernel, rate)
        used = _slow_used(kernel, kept)
        root = 1 / math.sqrt(count)

        def reaching(x: Array) -> ComplexArray:
            """Spectra from bin low - reach to high + reach."""
            spectrum = rfft(x)
            ends = spectrum[..., below:0:-1].conj(), spectrum[..., max(0, low - reach) : high + reach]
            return np.asarray(np.concatenate(ends, axis=-1) * root, dtype=np.complex128)

        # The constant, which comes first, needs no product.
        spectra = [
            np.concatenate([reaching(signal)[None], reaching(signal * slow[1 : 1 + most])])
            if most
            else reaching(signal)[None]
            for signal, most in zip(self.signals, used.max(axis=1), strict=True)
        ]  # (slow function, run, bin) of each signal
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
                    functions = slice(first, first + counts[harmonic])
                    many = counts[harmonic]
                    up, down = centre - harmonic * shift, centre + harmonic * shift
                    below_it = spectrum[functions, :, up : up + bins] * turns[harmonic]
                    above_it = spectrum[functions, :, down : down + bins] * turns[harmonic].conj()
                    np.add(below_it, above_it, out=out[row : row + many])
                    sine = out[row + many : row + 2 * many]
                    np.subtract(above_it, below_it, out=sine)
                    sine *= 1j
                    row += 2 * many
            yield _Block(start - low, out)

    def _transformed(
        self, kernel: Kernel, kept: NDArray[np.bool_], low: int, high: int, rate: float
    ) -> Iterator[_Block]:
        """Products with any features, each transformed."""
        runs, count = self.torque.shape
        columns = int(kept.sum())
        size = 16 * columns * runs * (high - low)
        if size > LARGEST:
            raise InputError(
                f"KernelRegression: {columns} regressors over {high - low} frequencies would take "
                f"{size / 2**30:.1f} GiB; give realizations of whole periods, fewer of them, or a longer length_decay"
            )
        slow = self._slow(kernel, rate)
        index = np.arange(count) / rate
        periodic = np.stack([harmonic_features(phase + index, kernel.period, kernel.harmonics) for phase in self.phase])
        out, row = np.empty((columns, runs, high - low), dtype=np.complex128), 0
        for signal, mask in zip(self.signals, kept, strict=True):
            for column in np.flatnonzero(mask):
                harmonic, part, slowness = kernel.products[column]
                feature = periodic[:, :, max(0, 2 * harmonic - 1 + part)] * slow[slowness]
                out[row] = rfft(signal * feature)[:, low:high]
                row += 1
        out /= math.sqrt(count)
        yield _Block(0, out)

    def _slow(self, kernel: Kernel, rate: float) -> Array:
        """Slow functions over each run, shape (function, run, time)."""
        clock = self.clock[:, None] + np.arange(self.torque.shape[1]) / rate
        return kernel.slow_features(clock.ravel()).reshape(-1, *clock.shape)


class _Block(NamedTuple):
    """Regressors (column, run, bin) at some frequencies, the first of which is ``first`` in the band."""

    first: int
    regressors: ComplexArray


def _slow_used(kernel: Kernel, kept: NDArray[np.bool_]) -> NDArray[np.int64]:
    """How many slow functions are kept of each harmonic, shape (signal, harmonic); the one without prior not counted.

    They are the first ones, since their variances descend.
    """
    used = np.zeros((3, kernel.harmonics + 1), dtype=np.int64)
    for column, (harmonic, part, _) in enumerate(kernel.products[1:], start=1):
        if part == 0:
            used[:, harmonic] += kept[:, column]
    return used


def _statistics(
    stacks: list[_Run], kernel: Kernel, kept: NDArray[np.bool_], band: tuple[float, float], rate: float
) -> Statistics:
    """Sums over real and imaginary parts of the frequencies in the band.

    Each run has its own external terms; they are turned so that they are orthogonal in the band.
    """
    size, square, count = int(kept.sum()), 0.0, 0
    gram, cross = np.zeros((size, size), order="F"), np.zeros(size)
    mixed, shared, powers = [], [], []
    for run in stacks:
        low, high = run.bins(band, rate)
        runs, samples = run.torque.shape
        root = 1 / math.sqrt(samples)
        terms = np.stack([half_cosine_spectrum(term, samples, low, high) for term in range(EXTERNAL_TERMS)]) * root
        power, axes = np.linalg.eigh(terms.view(np.float64) @ terms.view(np.float64).T)
        terms = axes.T @ terms
        output = np.ascontiguousarray(rfft(run.torque)[:, low:high]) * root
        between = np.zeros((size, runs, EXTERNAL_TERMS))
        for first, products in run.in_band(kernel, kept, low, high, rate):
            block = slice(first, first + products.shape[2])
            regressors, target, within = (
                np.ascontiguousarray(values).view(np.float64)
                for values in (products, output[:, block], terms[:, block])
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
    return Statistics(
        gram, cross, square, count, np.concatenate(mixed, axis=1), np.concatenate(shared), np.concatenate(powers)
    )


def _stacked(runs: list[_Run]) -> Iterator[_Run]:
    """Runs of one length together."""
    alike: dict[int, list[_Run]] = {}
    for run in runs:
        alike.setdefault(run.torque.shape[1], []).append(run)
    for group in alike.values():
        for first in range(0, len(group), STACK):
            signals, torque, phase, clock = zip(*group[first : first + STACK], strict=True)
            yield _Run(
                np.concatenate(signals, axis=1), np.concatenate(torque), np.concatenate(phase), np.concatenate(clock)
            )


def _powers(stacks: list[_Run]) -> Array:
    """Summed squares of angle, velocity and acceleration."""
    return np.array([sum(float(np.sum(run.signals[order] ** 2)) for run in stacks) for order in range(3)])


def _weak(stacks: list[_Run]) -> float:
    """Prior precision of the external terms: one over the torque's mean square."""
    power = sum(float(np.vdot(run.torque, run.torque)) for run in stacks)
    return sum(run.torque.size for run in stacks) / (power or 1.0)


class _Tried(NamedTuple):
    """A decay, the logs of l1, three gammas and the noise variance, and their log marginal likelihood."""

    decay: float
    theta: Array
    value: float

    def settings(self) -> dict[str, Any]:
        length, decay, *gammas = (
            float(f"{number:.4g}") for number in (*np.exp(self.theta[:1]), self.decay, *np.exp(self.theta[1:4]))
        )
        return {"length_periodic": length, "length_decay": decay, "gamma": tuple(gammas)}


class _Likelihood(NamedTuple):
    """Log marginal likelihood as a function of the logs of l1, three gammas and the noise variance.

    ``coefficient`` and ``harmonic`` of each column, and which are ``fixed``, that is without prior.
    """

    statistics: Statistics
    coefficient: NDArray[np.int64]
    harmonic: NDArray[np.int64]
    fixed: NDArray[np.bool_]

    @classmethod
    def of(
        cls,
        stacks: list[_Run],
        kernel: Kernel,
        kept: NDArray[np.bool_],
        band: tuple[float, float],
        rate: float,
        noise: float,
    ) -> _Likelihood:
        """With the external terms eliminated for about this noise variance."""
        coefficient, column = np.nonzero(kept)
        harmonic = np.array([harmonic for harmonic, _, _ in kernel.products])[column]
        statistics = without_nuisance(_statistics(stacks, kernel, kept, band, rate), _weak(stacks), noise)
        return cls(statistics, coefficient, harmonic, column == 0)

    def __call__(self, theta: Array) -> tuple[float, Array]:
        """Log marginal likelihood, and its derivatives."""
        logs, slopes = log_harmonic_variances(math.exp(theta[0]), int(self.harmonic.max()))
        variances = np.where(self.fixed, 0.0, theta[1 + self.coefficient] + logs[self.harmonic])
        with np.errstate(divide="ignore"):
            strength = variances + np.log(np.diag(self.statistics.gram)) - theta[4]
        seen = self.fixed | (strength > math.log(FAINT))
        precision = np.where(self.fixed, 0.0, np.exp(-np.where(seen, variances, 0.0)))[seen]
        found = log_evidence(of_columns(self.statistics, seen), precision, 1.0, math.exp(theta[4]))
        by_gamma = np.bincount(self.coefficient[seen], found.by_variances, minlength=3)
        by_length = float(found.by_variances @ slopes[self.harmonic[seen]])
        return found.value, np.array([by_length, *by_gamma, found.by_noise])

    def best_noise(self, theta: Array) -> tuple[float, float]:
        """Log of the noise variance that suits the other settings best, and the log marginal likelihood."""
        place = theta.copy()
        for _ in range(NOISES):
            value, slope = self(place)
            # The likelihood of a log variance curves like that of so many numbers.
            step = slope[4] / (0.5 * self.statistics.number)
            if abs(step) < 1e-4:
                break
            place[4] += step
        return float(place[4]), value

    def climb(
        self, theta: Array, length: float | None = None, decay: float = ENDLESS, leeway: float = math.inf
    ) -> _Tried:
        """Highest likelihood near a start; at one l1, if that is given, and with gammas no larger than by a leeway."""
        lengths = np.log([LENGTHS[0], LENGTHS[-1]] if length is None else [length, length])
        start = np.concatenate([[np.clip(theta[0], *lengths)], theta[1:]])
        bounds = [tuple(lengths), *((gamma - 50, gamma + min(leeway, 15)) for gamma in theta[1:4]), (None, None)]

        def descent(place: Array) -> tuple[float, Array]:
            value, slope = self(place)
            return -value, -slope

        found = minimize(descent, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"ftol": 1e-9})
        return _Tried(decay, found.x, -float(found.fun))


def _inverse(precision: Array) -> Array:
    """1 / precision, and 0 where there is none."""
    return np.where(precision > 0, 1 / np.where(precision > 0, precision, 1.0), 0.0)


def _spread(
    ensemble: Ensemble,
    band: tuple[float, float],
    impedance: Array,
    features: Array,
    covariance: Array,
    fit: Fit,
    missing: int,
) -> Spread:
    """Random error of the impedance (time, 3) from the posterior, corrected for the noise's colour.

    The posterior takes the noise as white, as strong as it is in the mean over the band that was fitted.
    """
    filters = derivative_filters(HALF_WIDTH, ensemble.sampling_rate)
    edge = missing_edge(HALF_WIDTH, ensemble)
    inner = slice(edge, len(impedance) - edge)
    left = residual(ensemble, impedance[inner] @ filters, HALF_WIDTH)
    filters = _in_band(filters, band, ensemble.sampling_rate)
    tint = colour(ensemble, left, fit.effective / left.size, filters)
    edges = (min(frequency / ensemble.sampling_rate, 0.5) for frequency in band)
    factors = tint.factors(filters) / max(power_in_band(tint.noise, *edges), LEAST_POWER)
    columns = features.shape[1]
    parts = [slice(first, first + columns) for first in range(0, 3 * columns, columns)]
    covariances = [covariance[part, part] for part in parts]
    variances = [np.einsum("tj,jk,tk->t", features, one, features, optimize=True) for one in covariances]
    deviation = np.sqrt(np.maximum(factors[:, None] * np.stack(variances), 0.0))
    deviation[:, :missing] = deviation[:, len(impedance) - missing :] = np.nan
    arcs = [arc_length(features, one) for one in covariances]
    return Spread(deviation, np.full(deviation.shape, np.inf), (arcs[0], arcs[1], arcs[2]))


LEAST_POWER = 1e-3
"""Share of white noise's power in the band below which the noise's correlation is too coarse to tell."""


def _in_band(filters: Array, band: tuple[float, float], rate: float) -> Array:
    """Filters followed by one that passes the band."""
    low, high = band
    edges = [edge for edge in (low, high) if 0 < edge < rate / 2]
    if not edges:
        return filters
    passing = firwin(2 * HALF_WIDTH + 1, edges, fs=rate, pass_zero=low == 0)
    return np.stack([np.convolve(row, passing) for row in filters])


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


def _common_phase(ensemble: Ensemble, period: float) -> float:
    """Phase in s at which every realization begins; NaN if they begin at different ones."""
    assert ensemble.onsets is not None
    phases = np.round(ensemble.onsets % period, 9) % period
    return float(phases[0]) if np.ptp(phases) < 1e-9 else math.nan


def _distinct(ensemble: Ensemble, kernel: Kernel) -> range | list[int]:
    """Realizations whose features differ: one where all begin at the same phase of a strictly periodic kernel."""
    same = kernel.decay is None and not math.isnan(_common_phase(ensemble, kernel.period))
    return [0] if same else range(len(ensemble))
