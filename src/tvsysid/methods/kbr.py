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
from scipy.signal import firwin

from tvsysid.errors import InputError
from tvsysid.impedance import derivative_filters
from tvsysid.methods.base import EXCITED_ABOVE, Method, check_positive, missing_edge, padded
from tvsysid.methods.residuals import colour, residual
from tvsysid.models import Diagnostics, SecondOrderModel, Spread
from tvsysid.numerics.bands import arc_length
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate
from tvsysid.numerics.kernels import TOLERANCE, DecayFeatures, harmonic_features, harmonic_variances
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
BLOCK = 6144
"""Frequencies whose regressors are held at once."""
STACK = 128
"""Runs of one length that are transformed together."""
EXTERNAL_TERMS = 5
"""Half-cosines over a run, the fastest of two cycles, that make up the smooth external term."""
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
        Prior variance of each coefficient about its mean, **angles counted in degrees**: (N·m/deg)², (N·m·s/deg)²
        and (N·m·s²/deg)². The paper gives no unit. In radians its value of 4.5 would hold stiffness within 2 N·m/rad
        of a constant; in degrees it allows some 120 N·m/rad, and gives figures like the paper's. This is a
        convention, not a reconstruction.
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

    Its cost grows with the square of the record where the decay is short against it: 600 s at 30 s take some 20 s.

    The noise variance is estimated from the residual, with the effective number of parameters taken off, and the fit
    repeated until it stands.

    The bands are those of the posterior, which takes the noise as white within the band, times a factor for its colour
    (:func:`tvsysid.numerics.noise.colour_factors`). The posterior counts what the prior smooths away only as far as the
    behaviour is as smooth as the kernel says: about a switch, the truth lies outside.
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
        period = ensemble.duration if self.period is None else self.period
        runs = [_Run.of(ensemble, realizations, clock) for realizations, clock in _runs_with_clock(ensemble)]
        runs = [run for run in runs if run.torque.shape[1] >= 2]
        if not runs or self.band[0] >= ensemble.sampling_rate / 2:
            raise InputError(
                f"KernelRegression: nothing is left of realizations of {ensemble.samples} samples at "
                f"{ensemble.sampling_rate:g} Hz after {HALF_WIDTH} at either end for the derivatives, within a band of "
                f"{self.band[0]:g} to {self.band[1]:g} Hz; give context, longer realizations or a lower band"
            )
        start = min(run.clock for run in runs)
        stop = max(run.clock + run.torque.shape[1] / ensemble.sampling_rate for run in runs)
        kernel = Kernel.of(period, self.length_periodic, self.length_decay, start, stop, ensemble.sampling_rate)

        size = 3 * kernel.columns
        if 8 * size**2 > LARGEST:
            raise InputError(
                f"KernelRegression: a decay of {self.length_decay:g} s over a record of {stop - start:g} s needs "
                f"{size} coefficients, too many to solve for; give fewer realizations or a longer length_decay"
            )
        gram, cross, square, bins = np.zeros((size, size)), np.zeros(size), 0.0, 0
        externals = []
        for run in _stacked(runs, kernel):
            external = _External.none(size, len(run.torque))
            for regressors, terms, output in run.in_band(kernel, self.band, ensemble.sampling_rate):
                flat = regressors.reshape(size, -1)
                gram += flat @ flat.T
                cross += flat @ output.ravel()
                square += float(np.sum(output * output))
                bins += output.size // 2
                external = external.with_bins(regressors, terms, output)
            externals.append(external)
        power = sum(float(np.vdot(run.torque, run.torque)) for run in runs) / sum(run.torque.size for run in runs)
        precision = np.tile(kernel.precision / self.gamma, 3)
        fit = _fit(gram, cross, square, bins, precision, externals, 1 / (power or 1.0))

        unit = DEGREES
        coefficients, covariance = fit.mean * unit, fit.covariance * unit**2
        # Where the derivatives lack samples at the ends of every run, nothing was identified.
        missing = missing_edge(HALF_WIDTH, ensemble) if all(len(run) == 1 for run in ensemble.runs) else 0
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
            phase=_common_phase(ensemble, period),
            spread=_spread(ensemble, self.band, impedance, features, fit, missing),
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
        coefficients = self.coefficients.reshape(3, self.kernel.columns).T
        features = [self.kernel(*_times(ensemble, r, clocks)) for r in range(len(ensemble))]
        values = np.stack([feature @ coefficients for feature in features])
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

    @property
    def harmonics(self) -> int:
        """Highest harmonic of the period."""
        return max(harmonic for harmonic, _, _ in self.products)

    def slow_features(self, clock: Array) -> Array:
        """Constant and slow functions at times of the record in s, shape (function, time)."""
        constant = np.ones((1, len(clock)))
        return constant if self.decay is None else np.concatenate([constant, self.decay(clock).T])

    def __call__(self, phase: Array, clock: Array) -> Array:
        """Features at times in s: of the periodic behaviour, and of the record; shape (time, column)."""
        periodic = harmonic_features(phase, self.period, self.harmonics)
        slow = self.slow_features(clock)
        place = [max(0, 2 * harmonic - 1 + part) for harmonic, part, _ in self.products]
        return np.asarray(periodic[:, place] * slow[[slowness for _, _, slowness in self.products]].T)


class _Fit(NamedTuple):
    mean: Array
    covariance: Array
    noise_variance: float
    effective: float
    iterations: int


class _External(NamedTuple):
    """What is needed of the external terms of a few runs of one length: each run has its own.

    ``gram`` (term, term), with the regressors ``mixed`` (column, run, term), with the output ``cross`` (run, term).
    """

    gram: Array
    mixed: Array
    cross: Array

    @classmethod
    def none(cls, columns: int, runs: int) -> _External:
        """No frequencies yet."""
        terms = EXTERNAL_TERMS
        return cls(np.zeros((terms, terms)), np.zeros((columns, runs, terms)), np.zeros((runs, terms)))

    def with_bins(self, regressors: Array, terms: Array, output: Array) -> _External:
        """With more frequencies: regressors (column, run, bin), external terms (term, bin), output (run, bin)."""
        return _External(self.gram + terms @ terms.T, self.mixed + regressors @ terms.T, self.cross + output @ terms.T)


def _fit(
    gram: Array, cross: Array, square: float, bins: int, precision: Array, externals: list[_External], weak: float
) -> _Fit:
    r"""Minimise :math:`|E|^2 / \sigma^2 + c^T P c`, the noise variance being that of the complex residual.

    ``gram``, ``cross`` and ``square`` are sums over real and imaginary parts of the bins, ``weak`` is the precision of
    the external terms. These are eliminated run by run, so that effort grows with the number of runs only. The cost
    is the negative log of a posterior density (of a complex normal E) without the usual halves, so that the
    covariance has one.
    """
    scale = 1 / np.sqrt(np.where(np.diag(gram) > 0, np.diag(gram), 1.0))
    gram, cross, precision = gram * np.outer(scale, scale), cross * scale, precision * scale**2
    mixed = [(external.mixed * scale[:, None, None]).reshape(len(scale), -1) for external in externals]
    floor = 1e-14 * square / bins
    noise, iteration = max(square / bins * 1e-3, floor), 0
    for iteration in range(1, 31):
        system, right = gram + np.diag(noise * precision), cross
        inverses, shares = [], []  # (external gram + prior)^-1, and what of the regressors it explains: mixed @ inverse
        for external, between in zip(externals, mixed, strict=True):
            inverses.append(np.linalg.inv(external.gram + noise * weak * np.eye(EXTERNAL_TERMS)))
            shares.append((between.reshape(-1, EXTERNAL_TERMS) @ inverses[-1]).reshape(between.shape))
            system = system - shares[-1] @ between.T
            right = right - shares[-1] @ external.cross.ravel()
        factor, failed = lapack.dpotrf(system, lower=1)
        if failed:  # columns without power, or alike to rounding
            factor, _ = lapack.dpotrf(system + 1e-11 * np.eye(len(system)), lower=1)
        mean = lapack.dpotrs(factor, right, lower=1)[0]
        lower = np.tril(lapack.dpotri(factor, lower=1)[0])
        covariance = lower + np.tril(lower, -1).T
        effective = len(mean) - noise * float(precision @ np.diag(covariance))
        residual = square - 2 * float(mean @ cross) + float(mean @ gram @ mean)
        for external, between, inverse, share in zip(externals, mixed, inverses, shares, strict=True):
            explained = (mean @ between).reshape(external.cross.shape)
            terms = (external.cross - explained) @ inverse
            residual += float(np.sum(terms * (2 * explained - 2 * external.cross + terms @ external.gram)))
            spread = len(terms) * float(np.trace(inverse)) + float(np.sum(covariance * (share @ share.T)))
            effective += terms.size - noise * weak * spread
        before, noise = noise, max(2 * max(residual, 0.0) / max(2 * bins - effective, 1.0), floor)
        if abs(noise - before) <= 1e-6 * noise:
            break
    return _Fit(mean * scale, 0.5 * noise * covariance * np.outer(scale, scale), noise, effective, iteration)


class _Run(NamedTuple):
    """Unbroken stretches of record of one length: angle and its derivatives (in degrees), torque, and when they were.

    ``signals`` (order, run, time), ``torque`` (run, time), ``phase`` and ``clock`` in s of the first sample (of the
    first run, if the kernel makes no difference between them).
    """

    signals: Array
    torque: Array
    phase: float
    clock: float

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
        return cls(signals[:, None], torque[None], onset + shift, clock + shift)

    def in_band(self, kernel: Kernel, band: tuple[float, float], rate: float) -> Iterator[tuple[Array, ...]]:
        """Fourier coefficients in the band, real and imaginary parts.

        Regressors (column, run, bin), external terms (term, bin) and output (run, bin), in blocks of frequencies, so
        that memory does not grow with the record times the columns.
        """
        count = self.torque.shape[1]
        low = math.ceil(band[0] * count / rate - 1e-9)
        high = min(math.floor(band[1] * count / rate + 1e-9), count // 2) + 1
        root = 1 / math.sqrt(count)
        external = root * np.stack([half_cosine_spectrum(term, count, low, high) for term in range(EXTERNAL_TERMS)])
        output = root * rfft(self.torque)[:, low:high]
        periods = count / rate / kernel.period
        shift = round(periods)
        whole = abs(periods - shift) < 1e-9 * periods and high - 1 + kernel.harmonics * shift <= count // 2
        blocks = self._shifted if whole else self._transformed
        for start, products in blocks(kernel, low, high, rate):
            block = slice(start - low, start - low + products.shape[2])
            np.multiply(products, root, out=products)
            yield tuple(
                np.ascontiguousarray(values).view(np.float64)
                for values in (products, external[:, block], output[:, block])
            )

    def _shifted(self, kernel: Kernel, low: int, high: int, rate: float) -> Iterator[tuple[int, ComplexArray]]:
        """Products with harmonics as shifts in frequency: exact where the run holds whole periods."""
        runs, count = self.torque.shape
        shift = round(count / rate / kernel.period)
        reach = kernel.harmonics * shift
        # The constant, which comes first, needs no product.
        slow = () if kernel.decay is None else kernel.slow_features(self.clock + np.arange(count) / rate)[1:]
        below = max(0, reach - low)

        def reaching(x: Array) -> ComplexArray:
            """Spectrum from bin low - reach to high + reach."""
            spectrum = rfft(x)
            ends = spectrum[:, below:0:-1].conj(), spectrum[:, max(0, low - reach) : high + reach]
            return np.concatenate(ends, axis=1)

        spectra = [[reaching(signal), *(reaching(signal * feature) for feature in slow)] for signal in self.signals]
        turns = 0.5 * np.exp(2j * np.pi * np.arange(kernel.harmonics + 1) * self.phase / kernel.period)
        length = max(1, BLOCK // runs)
        for start in range(low, high, length):
            bins = min(length, high - start)
            out = np.empty((3 * kernel.columns, runs, bins), dtype=np.complex128)
            centre = start - low + reach
            for order, of_signal in enumerate(spectra):
                for column, (harmonic, part, slowness) in enumerate(kernel.products):
                    row, spectrum = out[order * kernel.columns + column], of_signal[slowness]
                    if harmonic == 0:
                        row[:] = spectrum[:, centre : centre + bins]
                        continue
                    first, second = centre - harmonic * shift, centre + harmonic * shift
                    up = turns[harmonic] * spectrum[:, first : first + bins]
                    down = turns[harmonic].conj() * spectrum[:, second : second + bins]
                    if part == 0:
                        np.add(up, down, out=row)
                    else:
                        np.subtract(down, up, out=row)
                        row *= 1j
            yield start, out

    def _transformed(self, kernel: Kernel, low: int, high: int, rate: float) -> Iterator[tuple[int, ComplexArray]]:
        """Products with any features, each transformed."""
        runs, count = self.torque.shape
        columns = 3 * kernel.columns
        size = 16 * columns * runs * (high - low)
        if size > LARGEST:
            raise InputError(
                f"KernelRegression: {columns} regressors over {high - low} frequencies would take "
                f"{size / 2**30:.1f} GiB; give realizations of whole periods, fewer of them, or a longer length_decay"
            )
        index = np.arange(count) / rate
        features = kernel(self.phase + index, self.clock + index)
        out = np.empty((columns, runs, high - low), dtype=np.complex128)
        for column, feature in enumerate(features.T):
            for order, signal in enumerate(self.signals):
                out[order * kernel.columns + column] = rfft(signal * feature)[:, low:high]
        yield low, out


def _stacked(runs: list[_Run], kernel: Kernel) -> Iterator[_Run]:
    """Runs of one length and phase together, where the kernel makes no other difference between them."""
    if kernel.decay is not None:
        yield from runs
        return
    alike: dict[tuple[int, float], list[_Run]] = {}
    for run in runs:
        phase = round(run.phase % kernel.period, 9) % kernel.period
        alike.setdefault((run.torque.shape[1], phase), []).append(run)
    for group in alike.values():
        for first in range(0, len(group), STACK):
            part = group[first : first + STACK]
            signals, torque = zip(*((run.signals, run.torque) for run in part), strict=True)
            yield part[0]._replace(signals=np.concatenate(signals, axis=1), torque=np.concatenate(torque))


def _spread(
    ensemble: Ensemble,
    band: tuple[float, float],
    impedance: Array,
    features: Array,
    fit: _Fit,
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
    covariances = [fit.covariance[part, part] * DEGREES**2 for part in parts]
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
