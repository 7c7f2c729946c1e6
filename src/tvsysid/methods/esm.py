"""Ensemble spectral method (ESM)."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Literal

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.methods import base, shared, tuning
from tvsysid.methods.responses import FrequencyResponseModel
from tvsysid.models import Diagnostics, Model
from tvsysid.numerics.bands import mean_of
from tvsysid.numerics.spectra import ShortTimeSpectra, power_share
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import one_of, positive

Stiffness = Literal["dc", "fit"]

MIN_REALIZATIONS = 10  # below which averaged spectra say little
MIN_REALIZATIONS_AT_REST = 2  # independent ones, below which nothing of the noise at 0 Hz is left
MAX_LEAKAGE = 0.1  # share of stiffness by which the response at 0 Hz may be lower; 0.07 on an ankle
# share of the angle's power in the band's upper half below which it counts as sampled too fast
OVERSAMPLED = 1e-6
# share of the strongest frequency's input power from which on a frequency counts as excited
EXCITED = 1e-6
# s, of which a tuned one is the best
WINDOWS = (0.12, 0.16, 0.20, 0.26, 0.30, 0.36, 0.44, 0.56, 0.70)
REFERENCE_LAG = 0.12  # s of the impulse response that tuning compares with
TINY = float(np.finfo(np.float64).tiny)  # keeps the response finite where there is no input


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
    which are differentiated before they are windowed (:mod:`tvsysid.methods.shared.segments`). The
    diagnostics' ``second_order_agreement`` says how much of the torque that depends linearly on the
    angle the fit explains. Where the derivatives lack samples (12 to either side), segments are cut
    short.

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
        "It is a mean over its window, the longest of those here, and takes stiffness at 0 Hz some "
        "2 to 3 N·m/rad too low: changes come out slower, extremes nearer the mean."
    )
    cites = ("vanderuit2021",)

    def __attrs_post_init__(self) -> None:
        if self.reference is not None and self.stiffness != "fit":
            raise InputError(
                "EnsembleSpectral: with a reference, stiffness must be 'fit' "
                f"(esm:stiffness=fit,reference={self.reference}); at 0 Hz it is biased, as the "
                "angle answers to what came before the window"
            )

    def _fit(self, ensemble: Ensemble, moved: Ensemble) -> FrequencyResponseModel:
        length, rate = base.whole_samples(self.window, ensemble), ensemble.sampling_rate
        if length < 4:
            raise InputError(
                f"EnsembleSpectral: a window of {self.window:g} s has {length} samples at "
                f"{rate:g} Hz; give at least {4 / rate:g} s"
            )
        base.check_window(f"EnsembleSpectral: windows of {self.window:g} s", length, ensemble)
        before, after = length // 2, (length - 1) // 2
        missing = base.missing_edge(before, ensemble), base.missing_edge(after, ensemble)
        within = slice(
            ensemble.core.start + missing[0] - before, ensemble.core.stop - missing[1] + after
        )
        products, power = shared.colour_products(moved), shared.hann(length) ** 2
        first = within.start + (len(products) - moved.angle.shape[1] + 1) // 2
        along = products[first : first + within.stop - within.start]
        z, angle, torque = (
            each[:, within] for each in (moved.angle, ensemble.angle, ensemble.torque)
        )
        spectra = shared.short_time_spectra(z, torque, length, along)
        response = spectra.yu / np.maximum(spectra.uu, TINY)
        realizations = shared.independent_realizations(ensemble)
        fit: shared.SegmentFit | shared.InstrumentalFit
        if self.reference is None:
            fit = shared.SegmentFit.of(ensemble, power, within)
        else:
            with_angle = shared.short_time_spectra(z, angle, length, along)
            response *= _angle_ratio(with_angle, realizations)
            fit = shared.instrumental_fit(ensemble, moved, power, within)
        impedance = base.padded(fit.impedance, *missing)
        left, start = shared.second_order_residual(ensemble, impedance)
        agreement = shared.residual_agreement(ensemble, moved, left, start)
        warned: tuple[str, ...] = ()
        errors: shared.Errors
        if isinstance(fit, shared.SegmentFit):
            at_rest = None
            if self.stiffness == "dc":
                stiffness = response[:, 0].real
                warned = _leaking(stiffness, fit.impedance[:, 0])
                impedance[:, 0] = base.padded(stiffness, *missing)
                at_rest = _variance_at_rest(angle, torque, stiffness, realizations)
            colour = shared.segment_colour(ensemble, power, left, products)
            errors = partial(segment_errors, fit, colour, at_rest, missing)
        else:
            values = base.padded(np.sqrt(fit.variances), *missing)
            errors = shared.standard_errors(values, max(1.0, realizations - 3.0))
        excited = spectra.uu > EXCITED * spectra.uu.max(axis=1, keepdims=True)
        excited &= np.isfinite(response)
        powers = np.maximum(spectra.uu, TINY) * np.maximum(spectra.yy, TINY)
        coherence = np.clip(np.abs(spectra.yu) ** 2 / powers, 0.0, 1.0)
        details = {"second_order_agreement": agreement}
        return (FrequencyResponseModel if self.reference is None else InstrumentalResponseModel)(
            sampling_rate=rate,
            time=ensemble.time,
            estimates=shared.impedance_estimates(impedance, errors),
            frequency_response=base.padded(response, *missing),
            frequencies=np.asarray(np.fft.rfftfreq(length, 1 / rate)),
            coherence=base.padded(coherence, *missing),
            excited=base.padded(excited.astype(np.float64), *missing) > 0,
            segment=length,
            diagnostics=Diagnostics(float(length), warnings=warned, details=details),
        )

    def _own_warnings(self, ensemble: Ensemble) -> Iterator[str]:
        rate = ensemble.sampling_rate
        some = ensemble.angle[:: max(1, len(ensemble) // 64)]
        if power_share(some, rate, rate / 4) < OVERSAMPLED:
            yield (
                f"the angle has hardly any power above {rate / 4:.4g} Hz: at {rate:g} Hz the "
                "response there is noise, and so is the prediction of torque; decimate to "
                f"{rate / 2:.4g} Hz"
            )
        if len(ensemble) < MIN_REALIZATIONS:
            yield (
                f"spectra are averaged over only {len(ensemble)} realizations: the response is "
                "hardly determined; record more, or use kbr"
            )

    def _open_loop_evidence(self, ensemble: Ensemble, seed: int) -> tuning.Evidence:
        return tuning.evidence_by_halves(self, ensemble, seed, {"window": WINDOWS}, REFERENCE_LAG)


class InstrumentalResponseModel(FrequencyResponseModel):
    """Frequency response by a reference: NaN where the reference does not move the angle.

    The model therefore predicts the torque by the second-order fit.
    """

    _pathways = Model._pathways


def _angle_ratio(spectra: ShortTimeSpectra, independent: int) -> NDArray[np.complex128]:
    """Return the predicted angle's power over its cross-spectrum with the angle.

    The shape is (time, frequency). The ratio is NaN where the two are no more coherent than
    independent signals are in 5 % of cases.
    """
    least = 1 - 0.05 ** (1 / max(independent - 1, 1))
    is_coherent = np.abs(spectra.yu) ** 2 > least * spectra.uu * spectra.yy
    return np.where(is_coherent, spectra.uu / np.where(is_coherent, spectra.yu, 1.0), np.nan)


def _leaking(at_rest: Array, fit: Array) -> tuple[str, ...]:
    """Return a warning if inertia leaks into 0 Hz, so that the response there is not stiffness."""
    low, level = (mean_of(each[np.isfinite(at_rest + fit)]) for each in (at_rest, fit))
    if not low < level - MAX_LEAKAGE * abs(level):
        return ()
    return (
        f"the response at 0 Hz is {low:.3g} N·m/rad on average, that of a second-order fit to all "
        f"frequencies {level:.3g}: inertia leaks into 0 Hz, as the angle moves mostly near a "
        "resonance; use esm:stiffness=fit",
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
    sums = shared.convolve_lags(angle, weights)
    left = shared.convolve_lags(torque, weights) - sums * stiffness
    squares = sums**2
    total = np.maximum(squares.sum(axis=0), TINY)
    with np.errstate(divide="ignore", invalid="ignore"):
        known = independent / len(angle) - squares / total
        variance = np.sum(squares * left**2 / known, axis=0) / total**2
    return np.where(np.isfinite(variance), variance, np.nan)


def segment_errors(
    fit: shared.SegmentFit,
    colour: shared.Colour,
    at_rest: Array | None,
    missing: tuple[int, int],
) -> dict[str, shared.StandardError]:
    """Return the standard errors of the second-order fit to segments, and at 0 Hz.

    ``at_rest`` is the variance of the response at 0 Hz (time,), if stiffness is read from it.
    ``missing`` is the number of times at either end without a segment.
    """
    variances, absent = fit.variances(colour), ""
    freedom = np.full(variances.shape, fit.freedom)
    if at_rest is not None:
        variances[:, 0], freedom[:, 0] = at_rest, max(fit.realizations - 1, 1)
        if fit.realizations < MIN_REALIZATIONS_AT_REST:
            absent = (
                "one independent realization tells nothing of the noise at 0 Hz; record more, or "
                "set stiffness to 'fit'"
            )
            variances[:, 0] = np.nan
    values, freedom = (base.padded(each, *missing) for each in (np.sqrt(variances), freedom))
    return shared.standard_errors(values, freedom, absent=absent)
