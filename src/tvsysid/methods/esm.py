"""Ensemble spectral method (ESM)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import Literal, NamedTuple

import attrs
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.methods import base, shared, tuning
from tvsysid.methods.responses import FrequencyResponseModel
from tvsysid.models import Diagnostics
from tvsysid.numerics.bands import mean_of
from tvsysid.numerics.spectra import ShortTimeSpectra
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import one_of, positive

Stiffness = Literal["dc", "fit"]

FEWEST = 10  # realizations below which averaged spectra say little
FEWEST_AT_REST = 2  # independent realizations below which those leave nothing of the noise at 0 Hz
MAX_LEAKAGE = 0.1  # share of stiffness by which the response at 0 Hz may be lower; 0.07 on an ankle
# share of the angle's power in the band's upper half below which it counts as sampled too fast
OVERSAMPLED = 1e-6
# share of the strongest frequency's input power from which on a frequency counts as excited
EXCITED = 1e-6
WINDOWS = (
    0.12,
    0.16,
    0.20,
    0.26,
    0.30,
    0.36,
    0.44,
    0.56,
    0.70,
)  # s, of which a tuned one is the best
REFERENCE_LAG = 0.12  # s of the impulse response that tuning compares with


@attrs.frozen
class EnsembleSpectral(shared.ByReference):
    r"""Estimate a frequency response at each time, from spectra averaged over realizations.

    .. math:: H(f, t) = \frac{\overline{S_{yu}(f, t)}}{\overline{S_{uu}(f, t)}}

    (equation 12 of van de Ruit et al. 2021). The spectra are those of short segments, Hann-windowed
    in angle and torque. Their mean is not subtracted, because stiffness is read from the component
    at 0 Hz.

    Parameters
    ----------
    window
        Duration of a segment in s, over which the joint is taken as constant.
    stiffness
        ``"dc"``: real part at 0 Hz, as in the paper. Leakage of the inertia's part from the
        neighbouring frequencies biases it by some -2 to -3 N·m/rad on an ankle, which no band of
        the random error covers; by half near a lightly damped resonance, which a warning says.
        ``"fit"``: from the second-order fit that viscosity and inertia always come from; it has no
        such bias, and 40 % (filtered noise) to 75 % (PRBS) of the random error.
    reference
        Channel with the disturbance that was applied, for a joint in closed loop, whose angle the
        noise of the torque moves too; ``stiffness="fit"``. The cross-spectra are then those with
        the angle that the reference predicts (:mod:`tvsysid.methods.shared.instrument`), in the
        response too, which is NaN at frequencies where the reference does not move the angle.
        Torque is predicted by the second-order fit.

    Notes
    -----
    An even number of samples N is taken from t - N/2 to t + N/2 - 1. The Hann window peaks at t and
    vanishes at its first sample, so that the estimate is centred on t.

    The second-order fit does not start from H, from which the window takes inertia and viscosity
    (fitted to H, they come out 0.017 to 0.018 kg·m² and 1.8 to 1.9 N·m·s/rad where 0.02 and 2.2 are
    true). It takes the cross-spectra of the same segments with the velocity and the acceleration,
    which are differentiated before they are windowed:

    .. math:: S_{y u^{(m)}}(f) = k\, S_{u u^{(m)}}(f) + b\, S_{\dot u u^{(m)}}(f)
              + I\, S_{\ddot u u^{(m)}}(f), \qquad m = 0, 1, 2

    which holds at every frequency without leakage, and solves them by least squares over all
    frequencies. The diagnostics' ``second_order_agreement`` says how much of the torque that
    depends linearly on the angle the fit explains. Where the derivatives lack samples (12 to
    either side), segments are cut short.

    The bands of the fit count the noise's colour within a segment; that of 0 Hz rests on the
    realizations alone, and needs no assumption on colour or strength. They do not count what the
    window smooths.
    """

    window: float = attrs.field(default=0.30, validator=positive)
    stiffness: Stiffness = attrs.field(default="dc", validator=one_of(Stiffness))
    reference: str | None = None

    key = "esm"
    title = "Ensemble spectral method"
    assumptions = (
        "Behaviour is the same in all realizations.",
        "The joint is constant over a short window, which limits the fastest change that is seen "
        "and the resolution in frequency.",
    )
    differs = (
        "It is a mean over its window, the longest of those here, and takes stiffness at 0 Hz "
        "some 2 to 3 N·m/rad"
        " too low: changes come out slower, extremes nearer the mean."
    )
    cites = ("vanderuit2021",)

    def __attrs_post_init__(self) -> None:
        if self.reference is not None and self.stiffness != "fit":
            raise InputError(
                "EnsembleSpectral: with a reference, stiffness must be 'fit' "
                "(esm:stiffness=fit,reference="
                f"{self.reference}); at 0 Hz it is biased, as the angle answers to what came "
                "before the window"
            )

    def fit(self, ensemble: Ensemble) -> FrequencyResponseModel:
        """Return the model of an ensemble."""
        length = base.whole_samples(self.window, ensemble)
        if length < 4:
            raise InputError(
                f"EnsembleSpectral: a window of {self.window:g} s has {length} samples at "
                f"{ensemble.sampling_rate:g} Hz; give at least {4 / ensemble.sampling_rate:g} s"
            )
        base.check_window(f"EnsembleSpectral: windows of {self.window:g} s", length, ensemble)
        before, after = length // 2, (length - 1) // 2
        missing = base.missing_edge(before, ensemble), base.missing_edge(after, ensemble)
        first = ensemble.context + missing[0] - before
        last = ensemble.context + ensemble.samples - missing[1] + after
        instrument = self.instrument(ensemble)
        products = shared.colour_products(ensemble)
        mirrored = (len(products) - ensemble.angle.shape[1] + 1) // 2
        angle, torque = ensemble.angle[:, first:last], ensemble.torque[:, first:last]
        moved = angle if instrument is None else instrument.moved.angle[:, first:last]
        along = products[first + mirrored : last + mirrored] if instrument is None else None
        spectra = shared.short_time_spectra(moved, torque, length, along)
        excited = (spectra.uu > EXCITED * spectra.uu.max(axis=1, keepdims=True)).astype(np.float64)
        # A frequency without any input has no response; the smallest number keeps it finite.
        input_power = np.maximum(spectra.uu, np.finfo(float).tiny)
        response: NDArray[np.complex128] = spectra.yu / input_power
        if instrument is not None:
            told = _told(
                shared.short_time_spectra(moved, angle, length),
                shared.independent_realizations(ensemble),
            )
            response, excited = response * told, excited * np.isfinite(told)
        powers = input_power * np.maximum(spectra.yy, np.finfo(float).tiny)
        coherence = np.clip(np.abs(spectra.yu) ** 2 / powers, 0.0, 1.0)
        frequencies = np.asarray(
            np.fft.rfftfreq(length, 1 / ensemble.sampling_rate), dtype=np.float64
        )
        power = shared.hann(length) ** 2
        errors: SegmentErrors | shared.WhereStrong
        warned: tuple[str, ...] = ()
        if instrument is None:
            segments, impedance, agreement = _segment_fit(ensemble, products, power, first, last)
            at_rest = None
            if self.stiffness == "dc":
                warned = _leaking(response[:, 0].real, impedance[:, 0])
                impedance[:, 0] = response[:, 0].real
                at_rest = _variance_at_rest(
                    angle, torque, impedance[:, 0], shared.independent_realizations(ensemble)
                )
            errors = SegmentErrors(segments, at_rest, missing, shared.counted(ensemble))
            impedance = base.padded(impedance, *missing)
        else:
            found = shared.segment_fit(ensemble, instrument.moved, power, first, last)
            impedance, values = (
                base.padded(each, *missing) for each in (found.impedance, np.sqrt(found.variances))
            )
            freedom = np.full(
                values.shape, max(1.0, shared.independent_realizations(ensemble) - 3.0)
            )
            errors = instrument.banded(shared.standard_errors(values, freedom))
            agreement = shared.second_order_agreement(ensemble, instrument.moved, impedance)
        stiffness, viscosity, inertia = impedance.T
        diagnostics = Diagnostics(
            float(length), warnings=warned, details={"second_order_agreement": agreement}
        )
        return (FrequencyResponseModel if instrument is None else InstrumentalResponseModel)(
            method=repr(self),
            sampling_rate=ensemble.sampling_rate,
            time=ensemble.time,
            estimates=shared.impedance_estimates(stiffness, viscosity, inertia, errors),
            frequency_response=base.padded(response, *missing),
            frequencies=frequencies,
            coherence=base.padded(coherence, *missing),
            excited=base.padded(excited, *missing) > 0,
            segment=length,
            diagnostics=diagnostics if instrument is None else instrument.seen(diagnostics),
        )

    def _own_warnings(self, ensemble: Ensemble) -> Iterator[str]:
        rate = ensemble.sampling_rate
        spectrum = shared.PowerSpectrum.of(ensemble.angle[:: max(1, len(ensemble) // 64)], rate)
        (fast,) = spectrum.shares((rate / 4, math.inf))
        if fast < OVERSAMPLED:
            yield (
                f"the angle has hardly any power above {rate / 4:.4g} Hz: at {rate:g} Hz the "
                "response there is noise, "
                f"and so is the prediction of torque; decimate to {rate / 2:.4g} Hz"
            )
        if len(ensemble) < FEWEST:
            yield (
                f"spectra are averaged over only {len(ensemble)} realizations: the response is "
                "hardly determined; "
                "record more, or use kbr"
            )

    def _open_loop_evidence(self, ensemble: Ensemble, seed: int) -> tuning.Evidence:
        return tuning.evidence_by_halves(self, ensemble, seed, {"window": WINDOWS}, REFERENCE_LAG)


@attrs.frozen(eq=False, repr=False, kw_only=True)
class InstrumentalResponseModel(FrequencyResponseModel):
    """Frequency response by a reference: NaN where the reference does not move the angle.

    The model therefore predicts the torque by the second-order fit.
    """

    def _pathways(self, ensemble: Ensemble) -> dict[str, Array]:
        impedance = self.stiffness, self.viscosity, self.inertia
        return {"intrinsic": np.asarray(sum(map(np.multiply, impedance, ensemble.derivatives())))}


class Segments(NamedTuple):
    r"""Second-order fit to segments, from moments of angle, velocity, acceleration and torque.

    With :math:`u^{(m)}` the angle's derivatives, taken before the window, the segments obey

    .. math:: S_{y u^{(m)}}(f) = k S_{u u^{(m)}}(f) + b S_{\dot u u^{(m)}}(f)
              + I S_{\ddot u u^{(m)}}(f)

    at every frequency, without leakage. Least squares sum over frequency. By Parseval's theorem,
    this is a sum over samples with the squared window as weights.

    ``moments`` (sample, 4, 4), summed over realizations, are 0 at the samples at either end
    (``edges``) where the derivatives lack samples, so that segments are cut short; ``power`` is
    the squared window (sample,). ``realizations`` is the number of independent ones.
    """

    moments: Array
    edges: tuple[int, int]
    power: Array
    realizations: int
    colour: shared.Colour

    def variances(self) -> Array:
        """Return the variances (time, 3) of stiffness, viscosity and inertia."""
        sums, fourth = (window_sums(self.moments, self.power**n) for n in (1, 2))
        fourth = fourth[:, :3, :3]
        impedance, inverse = shared.second_order_fit(sums[:, :3, :3], sums[:, :3, 3])
        known = np.pad(np.ones(len(self.moments) - sum(self.edges)), self.edges)
        weight = self.realizations * sliding_window_view(known, len(self.power)) @ self.power
        fitted = np.einsum("tmk,tkm->t", inverse, fourth)
        left = np.maximum(sums[:, 3, 3] - np.einsum("tm,tm->t", impedance, sums[:, :3, 3]), 0.0)
        noise = np.where(
            weight > fitted, left / np.where(weight > fitted, weight - fitted, 1.0), np.nan
        )
        white = noise[:, None] * np.diagonal(inverse @ fourth @ inverse, axis1=1, axis2=2)
        overlap = _overlap(self.power, len(self.colour.covariance))
        _, factors = self.colour.noise_and_factors(overlap / overlap[0])
        return np.asarray(factors * white)

    @property
    def freedom(self) -> float:
        """Return the degrees of freedom of the variances."""
        return float(self.realizations * self.power.sum() ** 2 / np.sum(self.power**2) - 3)


def _segment_fit(
    ensemble: Ensemble, products: Array, power: Array, begin: int, end: int
) -> tuple[Segments, Array, float]:
    """Fit segments from one sample to another, which count the context.

    Return the segments, their impedance (time, 3) and its agreement in per cent.
    """
    rate, centre, samples = ensemble.sampling_rate, len(power) // 2, ensemble.angle.shape[1]
    reach = shared.HALF_WIDTH
    first, last = max(reach, begin), min(samples - reach, end)  # where the derivatives are known
    signals = (
        *shared.differentiate(ensemble.angle[:, first - reach : last + reach], rate),
        ensemble.torque[:, first:last],
    )
    moments = np.zeros((end - begin, 4, 4))
    for a, b in itertools.combinations_with_replacement(range(4), 2):
        moments[first - begin : last - begin, a, b] = np.einsum("rt,rt->t", signals[a], signals[b])
        moments[:, b, a] = moments[:, a, b]
    sums = window_sums(moments, power)
    impedance, _ = shared.second_order_fit(sums[:, :3, :3], sums[:, :3, 3])

    # What the fit leaves at the segments' centres, as far as the derivatives are known there.
    start, stop = max(first, begin + centre), min(last, begin + centre + len(impedance))
    at_centre = impedance[start - begin - centre : stop - begin - centre].T
    angle, velocity, acceleration, torque = (
        signal[:, start - first : stop - first] for signal in signals
    )
    fit = angle * at_centre[0]
    fit += velocity * at_centre[1]
    fit += acceleration * at_centre[2]
    left = torque - fit
    filters = shared.derivative_filters(reach, rate)
    longest = shared.colour_lags(ensemble)
    colour = shared.Colour.of(
        ensemble, left, _taken(power, len(ensemble), longest + 1), filters, products
    )
    covariance = shared.angle_covariance(ensemble, products, 2 * min(centre, longest))
    # The response itself would not do for a comparison, because leakage takes more from it than
    # higher dynamics.
    agreement = shared.agreement_of(fit, left, angle, covariance)
    edges = first - begin, end - last
    return (
        Segments(moments, edges, power, shared.independent_realizations(ensemble), colour),
        impedance,
        agreement,
    )


def _told(spectra: ShortTimeSpectra, independent: int) -> NDArray[np.complex128]:
    """Return the predicted angle's power over its cross-spectrum with the angle.

    The shape is (time, frequency). The ratio is NaN where the two are no more coherent than
    independent signals are in 5 % of cases.
    """
    least = 1 - 0.05 ** (1 / max(independent - 1, 1))
    told = np.abs(spectra.yu) ** 2 > least * spectra.uu * spectra.yy
    return np.where(told, spectra.uu / np.where(told, spectra.yu, 1.0), np.nan)


def window_sums(moments: Array, weights: Array) -> Array:
    """Return weighted sums (time, 4, 4) of moments (sample, 4, 4) over each segment."""
    return np.asarray(sliding_window_view(moments, len(weights), axis=0) @ weights)


def _overlap(power: Array, lags: int) -> Array:
    """Return the sum over a segment of the products of lagged weights, shape (lag,)."""
    products = np.correlate(power, power, mode="full")[len(power) - 1 :][:lags]
    return np.pad(products, (0, lags - len(products)))


def _taken(power: Array, count: int, lags: int) -> Array:
    """Return the share (lag,) of the noise's autocovariance that the fit of a segment explains.

    The fit has three regressors, and the segment is weighted.
    """
    centre = len(power) // 2
    own = np.pad(power[centre:], (0, max(0, lags - len(power) + centre)))[:lags]
    total = float(power.sum())
    return 3 / count * (2 * own / total - _overlap(power, lags) / total**2)


def _leaking(at_rest: Array, fit: Array) -> tuple[str, ...]:
    """Return a warning if inertia leaks into 0 Hz, so that the response there is not stiffness."""
    low, level = (mean_of(each[np.isfinite(at_rest + fit)]) for each in (at_rest, fit))
    if not low < level - MAX_LEAKAGE * abs(level):
        return ()
    return (
        f"the response at 0 Hz is {low:.3g} N·m/rad on average, that of a second-order fit to all "
        "frequencies "
        f"{level:.3g}: inertia leaks into 0 Hz, as the angle moves mostly near a resonance; use "
        "esm:stiffness=fit",
    )


def _variance_at_rest(angle: Array, torque: Array, stiffness: Array, independent: int) -> Array:
    r"""Return the variance of the 0-Hz response: a regression of windowed sums over realizations.

    .. math:: \mathrm{var} = \frac{\sum_r U_r^2 E_r^2 / (1 - h_r)}{(\sum_r U_r^2)^2}, \qquad
              E_r = Y_r - k U_r, \quad h_r = \frac{U_r^2}{\sum_s U_s^2} + \frac{R - R'}{R}

    with R' ``independent`` ones of R realizations. R' is one less where their mean was subtracted,
    because then an intercept was fitted too. The variances need not be equal: leakage makes the
    error larger in segments in which the angle moves (White 1980; MacKinnon & White 1985).
    """
    window = shared.hann(angle.shape[1] - len(stiffness) + 1)
    weights = np.broadcast_to(window[::-1], (len(stiffness), len(window)))
    sums, answers = shared.convolve_lags(angle, weights), shared.convolve_lags(torque, weights)
    squares = sums * sums
    total = np.maximum(squares.sum(axis=0), np.finfo(float).tiny)
    # In place: what takes time here is memory.
    sums *= stiffness
    answers -= sums
    answers *= answers
    answers *= squares
    squares /= total
    np.subtract(independent / len(angle), squares, out=squares)
    with np.errstate(divide="ignore", invalid="ignore"):
        answers /= squares
        variance = np.sum(answers, axis=0) / total**2
    return np.where(np.isfinite(variance), variance, np.nan)


@attrs.frozen(eq=False)
class SegmentErrors:
    """Standard errors of the second-order fit to segments, and at 0 Hz.

    ``at_rest`` is the variance of the response at 0 Hz (time,), if stiffness is read from it.
    ``missing`` is the number of times at either end without a segment. ``counted`` describes the
    number of realizations in words.
    """

    segments: Segments
    at_rest: Array | None
    missing: tuple[int, int]
    counted: str

    def standard_errors(self) -> dict[str, shared.StandardError]:
        """Return the standard errors by quantity."""
        variances = self.segments.variances()
        freedom, absent = np.full(variances.shape, self.segments.freedom), ""
        if self.at_rest is not None:
            realizations = self.segments.realizations
            variances[:, 0], freedom[:, 0] = self.at_rest, max(realizations - 1, 1)
            if realizations < FEWEST_AT_REST:
                absent = (
                    f"{self.counted} tell nothing of the noise at 0 Hz: there is one number of "
                    "each; record more, or "
                    "set stiffness to 'fit'"
                )
                variances[:, 0] = np.nan
        values, freedom = (
            base.padded(each, *self.missing) for each in (np.sqrt(variances), freedom)
        )
        return shared.standard_errors(values, freedom, absent=absent)
