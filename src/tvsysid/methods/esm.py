"""Ensemble spectral method (ESM)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.estimates import impedance_estimates, standard_errors
from tvsysid.impedance import derivative_filters, second_order_fit
from tvsysid.methods.base import (
    EXCITED_ABOVE,
    Method,
    check_choice,
    check_positive,
    check_window,
    missing_edge,
    padded,
    whole_samples,
)
from tvsysid.methods.shared.residuals import (
    LONGEST_COLOUR,
    Colour,
    agreement_of,
    colour,
    counted,
    independent_realizations,
)
from tvsysid.methods.tuning.evidence import Evidence
from tvsysid.methods.tuning.halves import evidence_by_halves
from tvsysid.models import Diagnostics, FrequencyResponseModel
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate
from tvsysid.numerics.moments import convolve_lags
from tvsysid.numerics.spectra import hann, power_share, short_time_spectra
from tvsysid.signals import Ensemble

Array = NDArray[np.float64]
Stiffness = Literal["dc", "fit"]

FEWEST = 10
"""Realizations below which averaged spectra say little."""
FEWEST_AT_REST = 2
"""Independent realizations below which those leave nothing of the noise at 0 Hz."""
OVERSAMPLED = 1e-6
"""Share of the angle's power in the upper half of the band below which it counts as sampled too fast."""
EXCITED = 1e-6
"""Share of the strongest frequency's input power from which on a frequency counts as excited."""

WINDOWS = (0.12, 0.16, 0.20, 0.26, 0.30, 0.36, 0.44, 0.56, 0.70)
"""Windows in s of which a tuned one is the best."""
REFERENCE_LAG = 0.12
"""Lags in s of the impulse response that tuning compares with."""


@dataclass(frozen=True)
class EnsembleSpectral(Method):
    r"""A frequency response at each time, from spectra of short segments averaged over realizations.

    .. math:: H(f, t) = \frac{\overline{S_{yu}(f, t)}}{\overline{S_{uu}(f, t)}}

    (equation 12 of van de Ruit et al. 2021). Segments are Hann-windowed, in angle and torque; their mean is not
    subtracted, for that would take away the very component from which stiffness is read.

    Parameters
    ----------
    window
        Duration of a segment in s, over which the joint is taken as constant.
    stiffness
        ``"dc"``: real part at 0 Hz, as in the paper. Leakage of the inertia's part from the neighbouring frequencies
        biases it by some -2 to -3 N·m/rad, which no band of the random error covers. ``"fit"``: from the second-order
        fit that viscosity and inertia always come from; it has no such bias, and 40 % (filtered noise) to 75 % (PRBS)
        of the random error.

    Notes
    -----
    An even number of samples N is taken from t - N/2 to t + N/2 - 1, under a Hann window that peaks at t and vanishes
    at its first sample, so that the estimate is centred on t.

    The second-order fit does not start from H, from which the window takes inertia and viscosity (fitted to H, they
    come out 0.017 to 0.018 kg·m² and 1.8 to 1.9 N·m·s/rad where 0.02 and 2.2 are true). It takes the cross-spectra of
    the same segments with the velocity and the acceleration, which are differentiated before they are windowed:

    .. math:: S_{y u^{(m)}}(f) = k\, S_{u u^{(m)}}(f) + b\, S_{\dot u u^{(m)}}(f) + I\, S_{\ddot u u^{(m)}}(f), \qquad
              m = 0, 1, 2

    which holds at every frequency without leakage, and solves them by least squares over all frequencies. The
    diagnostics' ``second_order_agreement`` says how much of the torque that answers to the angle the fit explains.
    Where the derivatives lack samples (12 to either side), segments are cut short.

    The bands of the fit count the noise's colour within a segment; that of 0 Hz rests on the realizations alone, and
    needs no assumption on colour or strength. They do not count what the window smooths.
    """

    window: float = 0.30
    stiffness: Stiffness = "dc"

    key: ClassVar[str] = "esm"
    title: ClassVar[str] = "Ensemble spectral method"
    assumptions: ClassVar[tuple[str, ...]] = (
        "Behaviour is the same in all realizations.",
        "The joint is constant over a short window, which limits the fastest change that is seen "
        "and the resolution in frequency.",
    )

    def __post_init__(self) -> None:
        check_positive(self, window=self.window)
        check_choice(self, "stiffness", Stiffness)

    def _identify(self, ensemble: Ensemble) -> FrequencyResponseModel:
        length = whole_samples(self.window, ensemble)
        if length < 4:
            raise InputError(
                f"EnsembleSpectral: a window of {self.window:g} s has {length} samples at "
                f"{ensemble.sampling_rate:g} Hz; give at least {4 / ensemble.sampling_rate:g} s"
            )
        check_window(f"EnsembleSpectral: windows of {self.window:g} s", length, ensemble)
        before, after = length // 2, (length - 1) // 2
        missing = missing_edge(before, ensemble), missing_edge(after, ensemble)
        first = ensemble.context + missing[0] - before
        last = ensemble.context + ensemble.samples - missing[1] + after
        angle, torque = ensemble.angle[:, first:last], ensemble.torque[:, first:last]
        spectra = short_time_spectra(angle, torque, length)
        excited = (spectra.uu > EXCITED * spectra.uu.max(axis=1, keepdims=True)).astype(np.float64)
        # A frequency without any input has no response; the smallest number keeps it finite.
        input_power = np.maximum(spectra.uu, np.finfo(float).tiny)
        response: NDArray[np.complex128] = spectra.yu / input_power
        powers = input_power * np.maximum(spectra.yy, np.finfo(float).tiny)
        coherence = np.clip(np.abs(spectra.yu) ** 2 / powers, 0.0, 1.0)
        frequencies = np.asarray(np.fft.rfftfreq(length, 1 / ensemble.sampling_rate), dtype=np.float64)
        fit = _segment_fit(ensemble, hann(length) ** 2, missing, (first, last))
        impedance, variance, freedom = fit.impedance, fit.variance, fit.freedom
        absent = ""
        if self.stiffness == "dc":
            impedance, variance, freedom = impedance.copy(), variance.copy(), freedom.copy()
            impedance[:, 0] = response[:, 0].real
            independent = independent_realizations(ensemble)
            variance[:, 0] = _variance_at_rest(angle, torque, hann(length), impedance[:, 0], independent)
            freedom[:, 0] = max(independent - 1, 1)
            if independent < FEWEST_AT_REST:
                absent = (
                    f"{counted(ensemble)} tell nothing of the noise at 0 Hz: there is one number of each; record more, "
                    "or set stiffness to 'fit'"
                )
                variance[:, 0] = np.nan
        stiffness, viscosity, inertia = padded(impedance, *missing).T
        errors = standard_errors(padded(np.sqrt(variance), *missing), padded(freedom, *missing), absent=absent)
        details = {"second_order_agreement": fit.agreement}
        return FrequencyResponseModel(
            method=repr(self),
            sampling_rate=ensemble.sampling_rate,
            time=ensemble.time,
            estimates=impedance_estimates(stiffness, viscosity, inertia, errors),
            frequency_response=padded(response, *missing),
            frequencies=frequencies,
            coherence=padded(coherence, *missing),
            excited=padded(excited, *missing) > 0,
            segment=length,
            diagnostics=Diagnostics(float(length), details=details),
        )

    def _doubts(self, ensemble: Ensemble) -> Iterator[str]:
        rate = ensemble.sampling_rate
        if power_share(ensemble.angle[:: max(1, len(ensemble) // 64)], rate, rate / 4, math.inf) < OVERSAMPLED:
            yield (
                f"the angle has hardly any power above {rate / 4:.4g} Hz: at {rate:g} Hz the response there is noise, "
                "and so is the prediction of torque; decimate first, to 100 Hz for instance"
            )
        if len(ensemble) < FEWEST:
            yield (
                f"spectra are averaged over only {len(ensemble)} realizations: the response is hardly determined; "
                "record more, or use kbr"
            )

    def _evidence(self, ensemble: Ensemble, seed: int) -> Evidence:
        return evidence_by_halves(self, ensemble, seed, {"window": WINDOWS}, REFERENCE_LAG)

    def _needed_band(self, ensemble: Ensemble) -> tuple[float, float]:
        return 1 / self.window, EXCITED_ABOVE


class _Fit(NamedTuple):
    """Second-order fit: ``impedance``, ``variance`` and ``freedom`` (time, 3); its ``agreement`` in per cent."""

    impedance: Array
    variance: Array
    freedom: Array
    agreement: float


def _segment_fit(ensemble: Ensemble, power: Array, missing: tuple[int, int], reach: tuple[int, int]) -> _Fit:
    r"""Stiffness, viscosity and inertia from the segments' cross-spectra with angle, velocity and acceleration.

    With :math:`u^{(m)}` the angle's derivatives, taken before the window, the segments obey
    :math:`S_{y u^{(m)}}(f) = k S_{u u^{(m)}}(f) + b S_{\dot u u^{(m)}}(f) + I S_{\ddot u u^{(m)}}(f)` at every
    frequency, without leakage. Least squares sum over frequency; by Parseval's theorem that is a sum over samples
    with the squared window as weights.

    Parameters
    ----------
    ensemble
        Realizations.
    power
        Squared window, shape (sample,).
    missing
        Times at either end of a realization without segment.
    reach
        First sample of the first segment, and the one after the last segment's last, context counted.
    """
    first, last = max(0, reach[0] - HALF_WIDTH), min(ensemble.angle.shape[1], reach[1] + HALF_WIDTH)
    signals = differentiate(ensemble.angle[:, first:last], ensemble.sampling_rate)
    torque = ensemble.torque[:, first + HALF_WIDTH : last - HALF_WIDTH]
    # Where the derivatives lack samples, segments are cut short.
    edges = first + HALF_WIDTH - reach[0], reach[1] - (last - HALF_WIDTH)
    length, count = len(power), len(ensemble)
    times = reach[1] - reach[0] - length + 1
    both = np.concatenate([signals, torque[None]])
    pairs = [(a, b) for a in range(4) for b in range(a + 1)]
    products = np.array([np.einsum("rt,rt->t", both[a], both[b]) for a, b in pairs])
    segments = sliding_window_view(np.pad(products, ((0, 0), edges)), length, axis=1)
    sums, fourth = np.empty((times, 4, 4)), np.empty((times, 4, 4))
    for (a, b), values in zip(pairs, segments @ np.stack([power, power**2], axis=1), strict=True):
        for total, column in ((sums, 0), (fourth, 1)):
            total[:, a, b] = total[:, b, a] = values[:, column]

    impedance, inverse = second_order_fit(sums[:, :3, :3], sums[:, :3, 3])
    explained = np.einsum("tm,tm->t", impedance, sums[:, :3, 3])
    independent = independent_realizations(ensemble)
    weight = independent * sliding_window_view(np.pad(np.ones(torque.shape[1]), edges), length) @ power
    fitted = np.einsum("tmk,tkm->t", inverse, fourth[:, :3, :3])
    left_over = np.maximum(sums[:, 3, 3] - explained, 0.0)
    noise = np.where(weight > fitted, left_over / np.where(weight > fitted, weight - fitted, 1.0), np.nan)
    white = noise[:, None] * np.diagonal(inverse @ fourth[:, :3, :3] @ inverse, axis1=1, axis2=2)

    # What the fit leaves at the segments' centres, as far as the derivatives are known there.
    centre = length // 2
    begin, end = max(0, edges[0] - centre), min(times, torque.shape[1] + edges[0] - centre)
    known = slice(begin + centre - edges[0], end + centre - edges[0])
    fit = np.einsum("tm,mrt->rt", impedance[begin:end], signals[:, :, known])
    remainder = torque[:, known] - fit
    filters = derivative_filters(HALF_WIDTH, ensemble.sampling_rate)
    tint = colour(ensemble, remainder, _taken(power, count, ensemble.sampling_rate), filters)
    overlap = _overlap(power, len(tint.noise))
    factors = Colour(tint.noise * overlap / overlap[0], tint.regressors).factors()
    freedom = np.full(white.shape, independent * power.sum() ** 2 / overlap[0] - 3)
    lags = min(centre, round(LONGEST_COLOUR * ensemble.sampling_rate))
    # The response itself would not do for a comparison, because leakage takes more from it than higher dynamics.
    shared = agreement_of(fit, remainder, signals[0, :, known], ensemble.angle, lags)
    return _Fit(impedance, factors * white, freedom, shared)


def _overlap(power: Array, lags: int) -> Array:
    """Sum over a segment of the products of weights that lie so many samples apart, shape (lag,)."""
    products = np.correlate(power, power, mode="full")[len(power) - 1 :][:lags]
    return np.pad(products, (0, lags - len(products)))


def _taken(power: Array, count: int, sampling_rate: float) -> Array:
    """Share of the noise's autocovariance that fits of three regressors to weighted segments take, at each lag."""
    lags = round(LONGEST_COLOUR * sampling_rate) + 1
    centre = len(power) // 2
    own = np.pad(power[centre:], (0, max(0, lags - len(power) + centre)))[:lags]
    total = float(power.sum())
    return 3 / count * (2 * own / total - _overlap(power, lags) / total**2)


def _variance_at_rest(angle: Array, torque: Array, window: Array, stiffness: Array, independent: int) -> Array:
    r"""Variance of the 0-Hz response: a regression over realizations of one windowed sum on another.

    .. math:: \mathrm{var} = \frac{\sum_r U_r^2 E_r^2 / (1 - h_r)}{(\sum_r U_r^2)^2}, \qquad
              E_r = Y_r - k U_r, \quad h_r = \frac{U_r^2}{\sum_s U_s^2} + \frac{R - R'}{R}

    with R' ``independent`` ones of R realizations: one less where their mean was subtracted, for then an intercept was
    fitted too. It needs no equal variances: leakage makes the error larger in segments in which the angle moves
    (White 1980; MacKinnon & White 1985).
    """
    weights = np.broadcast_to(window[::-1], (angle.shape[1] - len(window) + 1, len(window)))
    sums, answers = convolve_lags(angle, weights), convolve_lags(torque, weights)
    squares = sums**2
    total = np.maximum(squares.sum(axis=0), np.finfo(float).tiny)
    left = answers - stiffness * sums
    leverage = squares / total + 1 - independent / len(angle)
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = np.sum(squares * left**2 / (1 - leverage), axis=0) / total**2
    return np.where(np.isfinite(spread), spread, np.nan)
