"""Ensemble spectral method (ESM)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal, NamedTuple

import attrs
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tvsysid.errors import InputError
from tvsysid.methods import shared
from tvsysid.methods.base import check_window, missing_edge, padded, whole_samples
from tvsysid.methods.responses import FrequencyResponseModel
from tvsysid.models import Diagnostics, Model, StandardError
from tvsysid.numerics.bands import mean_of
from tvsysid.numerics.differentiation import HALF_WIDTH, derivative_filters, differentiate
from tvsysid.numerics.moments import convolve_lags
from tvsysid.numerics.second_order import second_order_fit
from tvsysid.numerics.spectra import hann, short_time_spectra
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import one_of, positive

Stiffness = Literal["dc", "fit"]

MIN_REALIZATIONS = 10  # below which averaged spectra say little
MIN_REALIZATIONS_AT_REST = 2  # independent ones, to estimate the noise at 0 Hz
MAX_LEAKAGE = 0.1  # share of stiffness by which the response at 0 Hz may be lower; 0.07 on an ankle
# share of the strongest frequency's input power from which on a frequency counts as excited
EXCITED = 1e-6
TINY = float(np.finfo(np.float64).tiny)  # keeps the response finite where there is no input


@attrs.frozen
class EnsembleSpectral(shared.ReferenceMethod):
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
        ``"dc"``: real part at 0 Hz, as in the paper. Inertia leaks into it from the neighbouring
        frequencies. The bias is -2 to -3 N·m/rad on an ankle, and half of the stiffness near a
        lightly damped resonance, where there is a warning. Bands do not cover it. ``"fit"``: from
        the second-order fit that always gives viscosity and inertia. It has no such bias, and a
        smaller random error: 40 % (filtered noise) to 75 % (PRBS) of that of ``"dc"``.
    reference
        Channel that moves the joint from outside, for a joint in closed loop, as of
        :class:`ShortDataSegments`. Stiffness must then be ``"fit"``.

    Notes
    -----
    An even number of samples N is taken from t - N/2 to t + N/2 - 1. The Hann window peaks at t and
    vanishes at its first sample, so that the estimate is centred on t.

    The second-order fit does not use H, in which the window lowers inertia and viscosity (to 0.017
    or 0.018 kg·m² and 1.8 or 1.9 N·m·s/rad where 0.02 and 2.2 are true). It uses the cross-spectra
    of the same segments with the velocity and the acceleration, which are differentiated before
    they are windowed (``SegmentFit``). The diagnostics'
    ``second_order_agreement`` says how much of the torque that depends linearly on the angle the
    fit explains. Where the derivatives lack samples (12 to either side), segments are cut short.

    The bands of the fit count the noise's colour within a segment. The band of 0 Hz comes from the
    scatter over realizations, for noise of any colour or strength. Bands do not count what the
    window smooths.
    """

    window: float = attrs.field(default=0.30, validator=positive)
    stiffness: Stiffness = attrs.field(default="dc", validator=one_of(Stiffness))
    reference: str | None = None

    key = "esm"
    title = "Ensemble spectral method"
    assumptions = (
        "The movement is the same in all realizations.",
        "The joint is constant over a short window, which limits the fastest change that is seen "
        "and the resolution in frequency.",
    )
    differs = (
        "It is a mean over its window, the longest of those here, and takes stiffness at 0 Hz some "
        "2 to 3 N·m/rad too low: changes come out slower, extremes nearer the mean."
    )
    cites = ("vanderuit2021",)

    def __attrs_post_init__(self) -> None:
        if self.reference is not None and self.stiffness != "fit":
            raise InputError("EnsembleSpectral: with a reference, stiffness must be 'fit'")

    def _fit(self, ensemble: Ensemble, instrument: Ensemble) -> FrequencyResponseModel:
        length, rate = whole_samples(self.window, ensemble), ensemble.sampling_rate
        if length < 4:
            raise InputError(
                f"EnsembleSpectral: a window of {self.window:g} s has {length} samples at "
                f"{rate:g} Hz; give at least {4 / rate:g} s"
            )
        check_window(f"EnsembleSpectral: windows of {self.window:g} s", length, ensemble)
        before, after = length // 2, (length - 1) // 2
        missing = missing_edge(before, ensemble), missing_edge(after, ensemble)
        within = slice(
            ensemble.core.start + missing[0] - before, ensemble.core.stop - missing[1] + after
        )
        angle, torque = instrument.angle[:, within], instrument.torque[:, within]
        spectra = short_time_spectra(angle, torque, length)
        response = spectra.yu / np.maximum(spectra.uu, TINY)
        fit = SegmentFit.of(instrument, hann(length) ** 2, within)
        over_time = padded(fit.impedance, *missing)
        left, first = shared.second_order_residual(ensemble, over_time)
        details = {"second_order_agreement": shared.residual_agreement(instrument, left, first)}
        independent, warned = shared.independent_realizations(ensemble), ""
        at_rest = response[:, 0].real
        impedance = over_time.copy()
        if self.stiffness == "dc":
            warned = leakage(at_rest, fit.impedance[:, 0])
            impedance[:, 0] = padded(at_rest, *missing)

        def errors() -> dict[str, StandardError]:
            variances, freedom = fit.variances(instrument, left), np.full(3, fit.freedom)
            variances *= shared.noise_ratio(
                left, shared.second_order_residual(instrument, over_time)[0]
            )
            absent = ""
            if self.stiffness == "dc":
                variances[:, 0] = variance_at_rest(angle, torque, at_rest, independent)
                freedom[0] = max(independent - 1, 1)
                if independent < MIN_REALIZATIONS_AT_REST:
                    absent = (
                        "one independent realization tells nothing of the noise at 0 Hz; record "
                        "more, or set stiffness to 'fit'"
                    )
                    variances[:, 0] = np.nan
            values = padded(np.sqrt(variances), *missing)
            return shared.standard_errors(values, freedom, absent=absent)

        excited = spectra.uu > EXCITED * spectra.uu.max(axis=1, keepdims=True)
        powers = np.maximum(spectra.uu, TINY) * np.maximum(spectra.yy, TINY)
        coherence = np.clip(np.abs(spectra.yu) ** 2 / powers, 0.0, 1.0)
        return FrequencyResponseModel(
            sampling_rate=rate,
            time=ensemble.time,
            estimates=shared.impedance_estimates(impedance, errors),
            frequency_response=padded(response, *missing),
            frequencies=np.fft.rfftfreq(length, 1 / rate),
            coherence=padded(coherence, *missing),
            excited=padded(excited.astype(np.float64), *missing) > 0,
            segment=length,
            diagnostics=Diagnostics(
                float(length), warnings=(warned,) if warned else (), details=details
            ),
        )

    def _own_warnings(self, ensemble: Ensemble, model: Model) -> Iterator[str]:
        if len(ensemble) < MIN_REALIZATIONS:
            yield (
                f"spectra are averaged over only {len(ensemble)} realizations: the response is "
                "hardly determined; record more, or use kbr"
            )


def leakage(at_rest: Array, fit: Array) -> str:
    """Return a warning if inertia leaks into 0 Hz, so that the response there is not stiffness."""
    low, level = mean_of(at_rest), mean_of(fit)
    if not low < level - MAX_LEAKAGE * abs(level):
        return ""
    return (
        f"the response at 0 Hz is {low:.3g} N·m/rad on average, that of a second-order fit to all "
        f"frequencies {level:.3g}: inertia leaks into 0 Hz, as the angle moves mostly near a "
        "resonance; use esm:stiffness=fit"
    )


def variance_at_rest(angle: Array, torque: Array, stiffness: Array, independent: int) -> Array:
    r"""Return the variance of the 0-Hz response: a regression of windowed sums over realizations.

    .. math:: \mathrm{var} = \frac{\sum_r U_r^2 E_r^2 / (1 - h_r)}{(\sum_r U_r^2)^2}, \qquad
              E_r = Y_r - k U_r, \quad h_r = \frac{U_r^2}{\sum_s U_s^2} + \frac{R - R'}{R}

    with R' ``independent`` ones of R realizations. R' is one less where their mean was subtracted,
    because then an intercept was fitted too. The variances need not be equal: leakage makes the
    error larger in segments in which the angle moves (White 1980; MacKinnon & White 1985).
    """
    window = hann(angle.shape[1] - len(stiffness) + 1)
    weights = np.broadcast_to(window[::-1], (len(stiffness), len(window)))
    sums = convolve_lags(angle, weights)
    left = convolve_lags(torque, weights) - sums * stiffness
    squares = sums**2
    total = np.maximum(squares.sum(axis=0), TINY)
    with np.errstate(divide="ignore", invalid="ignore"):
        known = independent / len(angle) - squares / total
        variance = np.sum(squares * left**2 / known, axis=0) / total**2
    return np.where(np.isfinite(variance), variance, np.nan)


class SegmentFit(NamedTuple):
    r"""Second-order fit to a short segment about each time.

    With :math:`u^{(m)}` the angle's derivatives, taken before the window, segments obey

    .. math:: S_{y u^{(m)}}(f) = k S_{u u^{(m)}}(f) + b S_{\dot u u^{(m)}}(f)
              + I S_{\ddot u u^{(m)}}(f), \qquad m = 0, 1, 2

    at every frequency, without leakage. Least squares sum over frequency. By Parseval's theorem,
    this is a sum over samples with the squared window as weights.

    ``impedance`` has shape (time, 3), ``inverse`` (time, 3, 3) is that of the regressors' moments.
    ``moments`` (sample, 4, 4) of angle, velocity, acceleration and torque are sums over
    realizations. They are 0 where the derivatives lack samples, and ``known`` (sample,) is 0 there,
    elsewhere the number of independent realizations. ``power`` (sample,) is the squared window.
    """

    impedance: Array
    inverse: Array
    moments: Array
    known: Array
    power: Array

    @classmethod
    def of(cls, ensemble: Ensemble, power: Array, within: slice) -> SegmentFit:
        """Fit segments within samples that count the context."""
        begin, end = within.start, within.stop
        first, last = max(HALF_WIDTH, begin), min(ensemble.angle.shape[1] - HALF_WIDTH, end)
        derivatives = differentiate(
            ensemble.angle[:, first - HALF_WIDTH : last + HALF_WIDTH], ensemble.sampling_rate
        )
        signals = np.concatenate([derivatives, ensemble.torque[None, :, first:last]])
        by_sample = np.ascontiguousarray(signals.transpose(2, 0, 1))
        moments, known = np.zeros((end - begin, 4, 4)), np.zeros(end - begin)
        moments[first - begin : last - begin] = by_sample @ by_sample.transpose(0, 2, 1)
        known[first - begin : last - begin] = shared.independent_realizations(ensemble)
        sums = window_sums(moments, power)
        return cls(*second_order_fit(sums[:, :3, :3], sums[:, :3, 3]), moments, known, power)

    def variances(self, ensemble: Ensemble, left: Array) -> Array:
        """Return the variances (time, 3) of stiffness, viscosity and inertia.

        ``left`` (realization, time) is the residual of the fit.
        """
        sums, fourth = (window_sums(self.moments, self.power**n) for n in (1, 2))
        fourth, inverse = fourth[:, :3, :3], self.inverse
        freedom = window_sums(self.known, self.power)
        freedom -= np.einsum("tmk,tkm->t", inverse, fourth)
        fitted = np.einsum("tm,tm->t", self.impedance, sums[:, :3, 3])
        rest = np.maximum(sums[:, 3, 3] - fitted, 0.0)
        noise = rest / np.where(freedom > 0, freedom, np.nan)
        white = noise[:, None] * np.diagonal(inverse @ fourth @ inverse, axis1=1, axis2=2)
        # The fit explains a share of the noise's autocovariance: it has three regressors, and
        # segments are weighted.
        lags, total = shared.colour_lags(ensemble) + 1, float(self.power.sum())
        own = np.pad(self.power[len(self.power) // 2 :], (0, lags))[:lags]
        overlap = np.correlate(np.pad(self.power, (0, lags)), self.power)[:lags]
        absorbed = 3 / len(ensemble) * (2 * own / total - overlap / total**2)
        filters = derivative_filters(HALF_WIDTH, ensemble.sampling_rate)
        _, factors = shared.noise_colour(ensemble, left, absorbed, filters, overlap / overlap[0])
        return factors * white

    @property
    def freedom(self) -> float:
        """Return the degrees of freedom of the variances."""
        realizations = self.known.max()
        return float(realizations * self.power.sum() ** 2 / np.sum(self.power**2) - 3)


def window_sums(values: Array, weights: Array) -> Array:
    """Return weighted sums (time, …) of values (sample, …) over each segment."""
    return sliding_window_view(values, len(weights), axis=0) @ weights
