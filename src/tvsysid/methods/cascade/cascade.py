"""Identify intrinsic and reflex pathway of a joint in one fit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import attrs
import numpy as np

from tvsysid.dataset_layout import UNITS
from tvsysid.methods.cascade.columns import (
    DELAY,
    HIGHEST,
    HISTORY_S,
    IS_LOG,
    NEEDED_HISTORY_S,
    SHAPE_NAMES,
    THRESHOLD,
    intrinsic_filters,
    intrinsic_signals,
    muscle,
)
from tvsysid.methods.cascade.fit import Fit, posterior_of
from tvsysid.methods.cascade.method import TwoPathwayMethod
from tvsysid.methods.cascade.reflex_test import HARMONICS
from tvsysid.methods.cascade.search import Hyperparameters, Selection, fit_again, select
from tvsysid.methods.pathways import TwoPathwayModel
from tvsysid.models import IMPEDANCE, Diagnostics, Estimate, Model, StandardError
from tvsysid.numerics.bands import arc_length, mean_known
from tvsysid.numerics.stretch import FAST
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import at_least, optional, positive, text

MAX_STIFFNESS_GAP = 0.1  # share by which stiffness may differ from that of a second-order fit
ROUNDING = 1e-9  # share of the mean stiffness
MAX_THRESHOLD_ERROR = 0.1  # rad/s, a third of the prior's standard deviation
MAX_LOST = 0.01  # share of the torque that the limits of viscosity and gain may cost


@attrs.frozen
class JointCascade(TwoPathwayMethod):
    r"""Identify both pathways in one fit: a short intrinsic response and a stretch reflex.

    The intrinsic response h is to the angle. The reflex acts through a muscle.

    .. math:: y(t) = \sum_{|\tau| \le 40\,ms} h(t, \tau)\, \theta(t - \tau)\, \Delta t + r(t) + e(t)

    .. math:: \ddot r + 2 \zeta \omega\, \dot r + \omega^2\, r = \omega^2\, G(t)\, f(t - d), \qquad
              f = s \max(s\, \dot\theta - c, 0)

    Stiffness is the sum of h. The intrinsic torque is a weighted sum of the angle, its velocity,
    its acceleration and its differences of higher order. The coefficients of the first two and the
    gain G are Fourier series of the realization. The other coefficients are constant.

    Parameters
    ----------
    harmonics
        Number of harmonics of stiffness and viscosity over a realization; the reflex gain has 0.4
        times as many. All three change if the changes predict held-out realizations better
        (p < 0.05; of fewer than eight realizations, if the log evidence is larger by 1). 0 takes
        them as constant.
    delay
        d in s. None is 40 ms, or 10 ms from EMG to torque. From stretch, give no less than 40 ms:
        within the lags of the intrinsic response, the reflex would explain the torque of inertia.
    emg
        Channel that drives the muscle instead of the velocity, such as the envelope of the EMG.
        There is no threshold then.

    Notes
    -----
    Coefficients have Gaussian priors relative to the noise. The priors are wide for the constants
    of stiffness, viscosity and inertia, and :math:`\gamma h^{-\nu}` for the h-th harmonic. The
    differences share one size; the mean gain has its own. Sizes and decays are those of greatest
    evidence. The muscle's frequency and damping and the threshold c are found by Gauss-Newton
    steps. Each step solves for all coefficients, because a reflex that is fitted to the residual of
    an intrinsic fit has lost part of its torque.

    Samples are weighted by the noise's inverse covariance within a realization (or 2.56 s of it at
    100 Hz), from the residual of a first fit. Without these weights, slow voluntary torque could
    look like a change of stiffness, or hide one. Where held-out realizations are then predicted
    worse (by 2 % of the squares), whitening gives weight to a misfit of the model. The noise is
    then taken as nearly white.

    The velocity is that of the total angle, rectified at the rate at which it was recorded. Torque
    and regressors are deviations from their mean over realizations. The gain is that of the stretch
    as it arrives at the muscle. Viscosity and inertia are those of a second-order fit to the
    intrinsic response from 0.5 to 15 Hz.

    A test on held-out realizations (:func:`tvsysid.methods.cascade.reflex_test.reflex_test_of`)
    decides whether there is a reflex, and in which direction of stretch s. With fewer than eight
    realizations, none is shown. Where no reflex is detected, the model has none, and the band of
    ``reflex_gain`` says how large a gain the data allow, of a usual muscle without a threshold.
    EMG always drives a reflex.

    Viscosity, the reflex gain of stretch and their bands are never negative. Stiffness keeps one
    sign. Sizes and decays are found without these limits. A warning says so if the limits cost 1 %
    of the torque, or hold stiffness at 0.

    The threshold is 0 unless a threshold predicts held-out realizations better (p < 0.05).

    The bands count the noise's colour, the priors' pull, and that muscle and threshold are not
    known. At jumps, which a Fourier series rounds off, the truth lies outside.

    The diagnostics' ``details`` hold the shape with standard errors; ``direction``;
    ``reflex_detected`` and ``constant``, 1 or 0; the explained share of the torque in per cent
    (``vaf``, ``vaf_intrinsic``, ``vaf_reflex``; the last two need not add up), and that of held-out
    torque (``vaf_held_out``, by thirds of the realizations, in turn); ``stiffness_fitted``, the
    mean stiffness of the second-order fit.

    References
    ----------
    The two pathways: Kearney, Stein & Parameswaran 1997, IEEE Trans. Biomed. Eng. 44, 493-504.
    The fit is our own.

    Examples
    --------
    >>> import tvsysid as tv
    >>> tv.methods.parse("cascade:delay=0.05").delay
    0.05
    """

    harmonics: int = attrs.field(default=25, validator=at_least(0))
    delay: float | None = attrs.field(default=None, validator=optional(positive))
    emg: str | None = attrs.field(default=None, validator=optional(text))

    key = "cascade"
    title = "Joint fit of intrinsic and reflex pathways"
    assumptions = (
        "The intrinsic response lasts 40 ms to either side, the reflex to stretch comes later.",
        "The reflex answers the velocity of stretch beyond a threshold, through a muscle of second "
        "order.",
        "The movement is the same in all realizations, and periodic.",
    )
    differs = (
        "It excludes the torque of the reflex, which methods with one pathway include; it is a sum "
        "of harmonics of the period, which smooths a switch."
    )
    cites = ("kearney1997",)

    @property
    def time_invariant(self) -> bool:  # type: ignore[override]
        """Return whether the settings take the joint as constant."""
        return self.harmonics == 0

    def fit(self, ensemble: Ensemble) -> JointCascadeModel:
        """Return the model of an ensemble."""
        return joint_model(self.select(ensemble))

    def select(self, ensemble: Ensemble) -> Selection:
        """Return the fits of an ensemble from which its model is made."""
        return select(ensemble, self.harmonics, self.delay, self.emg)

    def refit(self, ensemble: Ensemble, model: Model) -> Model:
        """Fit only the coefficients to a part of the realizations, if the model shows a reflex."""
        if isinstance(model, JointCascadeModel) and model.diagnostics.details["reflex_detected"]:
            return joint_model(fit_again(ensemble, model.hyperparameters))
        return self.identify(ensemble)

    def _own_warnings(self, ensemble: Ensemble, model: Model) -> Iterator[str]:
        stiffness = np.abs(model.stiffness)
        lowest = int(np.nanargmin(stiffness))
        if stiffness[lowest] < ROUNDING * np.nanmean(stiffness):
            yield (
                f"the fit holds stiffness at 0 at {model.time[lowest]:.2f} s, because it would be "
                "of the wrong sign there: this model does not describe the joint there"
            )
        rate = ensemble.sampling_rate * ensemble.angle_as_recorded.shape[-1]
        if self.emg is None and rate < FAST:
            yield (
                f"the angle is there at {rate:g} Hz only, where the velocity of fast movements "
                "cannot be rectified: the reflex's gain and threshold are biased; give a recording "
                f"at {FAST:g} Hz or more and decimate it with "
                "tvsysid.preprocess.decimate, which keeps the angle as it was"
            )


@attrs.frozen(eq=False, repr=False, kw_only=True)
class JointCascadeModel(TwoPathwayModel):
    """Model of both pathways, whose intrinsic torque follows fast movements.

    The intrinsic torque is a sum of ``coefficients`` (time, signal) times the signals of
    :func:`tvsysid.methods.cascade.columns.intrinsic_signals`. It is that of the impulse response,
    but for movements that the decimated angle lacks. ``hyperparameters`` are those of the fit with
    the reflex whose gain is stated.
    """

    coefficients: Array
    hyperparameters: Hyperparameters

    def _pathways(self, ensemble: Ensemble) -> dict[str, Array]:
        signals = intrinsic_signals(ensemble)[..., ensemble.core]
        intrinsic = np.einsum("ts,srt->rt", self.coefficients, signals)
        if ensemble.mean_subtracted:
            intrinsic -= mean_known(intrinsic)
        return {"intrinsic": intrinsic, "reflex": self._reflex_torque(ensemble)}


def joint_model(selection: Selection) -> JointCascadeModel:
    """Return the model with the selected reflex if it is shown, else without one.

    The gain is stated in both.
    """
    fit, used = selection
    ensemble, data = used.data.ensemble, used.data
    drive = attrs.evolve(fit.drive, threshold=float(fit.shape[THRESHOLD]))
    rate = ensemble.sampling_rate
    lags, filters = intrinsic_filters(rate)
    known = np.full((ensemble.samples, 1), np.nan)
    known[data.times] = 1.0
    over_time = data.over_time(used.posterior.mean[: data.intrinsic_count])

    def estimate(fit: Fit, features: Array, sign: float, unit: str) -> Estimate:
        """Return a quantity where samples are fitted, at least 0 if its sign is positive."""
        count = len(fit.posterior.mean)
        covariance = fit.covariance[:count, :count]
        minimum = 0.0 if sign > 0 else -np.inf
        variance = np.einsum("tj,tj->t", features @ covariance, features)
        error = StandardError(
            np.sqrt(np.maximum(variance, 0.0)) * known[:, 0],
            fit.freedom,
            arc_length(features, covariance),
            minimum=minimum,
        )
        values = np.maximum(features @ fit.posterior.mean, minimum)
        return Estimate(values * known[:, 0], unit, error=error)

    impedance = zip(IMPEDANCE, used.quantities, used.signs, strict=False)
    estimates = {
        name: estimate(used, features, sign, UNITS[name]) for name, features, sign in impedance
    }
    estimates["reflex_gain"] = estimate(fit, fit.quantities[-1], fit.signs[-1], drive.gain_unit)
    response, reflex_lags = _reflex_response(selection)
    details = _details(selection)
    details["stiffness_fitted"] = float((over_time @ data.readout[0]).mean())
    return JointCascadeModel(
        sampling_rate=rate,
        time=ensemble.time,
        estimates=estimates,
        impulse_response=over_time @ filters * known * rate,
        lags=lags,
        reflex_response=response * known * rate,
        reflex_lags=reflex_lags,
        drive=drive,
        optional_lags=len(reflex_lags) - 1 - round(NEEDED_HISTORY_S * rate),
        coefficients=over_time * known,
        hyperparameters=Hyperparameters(
            data.harmonics, data.noise, drive, fit.shape, fit.parameters
        ),
        diagnostics=Diagnostics(
            used.posterior.effective,
            warnings=tuple(_warnings(selection, details, estimates)),
            details=details,
        ),
    ).with_details(ensemble)


def _reflex_response(selection: Selection) -> tuple[Array, Array]:
    """Return the weights (time, lag) of the reflex's drive, and the lags in s.

    The weights are zero if no reflex is detected.
    """
    fit, data, ensemble = selection.reflex, selection.reflex.data, selection.reflex.data.ensemble
    rate, delay = ensemble.sampling_rate, fit.shape[DELAY]
    lags = np.arange(round(HISTORY_S * rate) + 1) / rate
    arrivals = ensemble.time[:, None] - lags + delay
    gain = data.gain(arrivals.ravel() / ensemble.duration)
    response = (gain @ fit.posterior.mean[data.intrinsic_count :]).reshape(arrivals.shape)
    return response * muscle(fit.shape, len(lags), rate) * selection.shown, lags


def _details(selection: Selection) -> dict[str, float]:
    fit, used = selection
    values = np.where(IS_LOG, np.exp(fit.shape), fit.shape)
    errors = np.sqrt(np.diag(fit.covariance)[len(fit.posterior.mean) :])
    errors *= np.where(IS_LOG, values, 1.0)[: fit.free]
    names = *SHAPE_NAMES, *(f"{name}_error" for name in SHAPE_NAMES)
    return dict(zip(names, [*values.tolist(), *errors.tolist()], strict=False)) | {
        "reflex_detected": float(selection.shown),
        "constant": float(used.data.harmonics == 0),
        "vaf_held_out": 100 * (1 - used.left_share()),
    }


def _warnings(
    selection: Selection, details: Mapping[str, float], estimates: Mapping[str, Estimate]
) -> Iterator[str]:
    """Yield warnings of limits that the data contradict, and of what is not reliable."""
    used, fitted = selection.used, details["stiffness_fitted"]
    stiffness, gain = (estimates[name].values for name in ("stiffness", "reflex_gain"))
    mean, upper = float(np.nanmean(stiffness)), estimates["reflex_gain"].band()[1]
    unlimited = posterior_of(used.moments, used.spread)
    lost = used.posterior.penalized_residual - unlimited.penalized_residual
    yield from limit_warnings(lost / used.moments.square)
    if not selection.shown:
        yield (
            "no reflex is detected in these data: stiffness, viscosity and inertia are those of a "
            "joint without one, and reflex_gain with its band is what the data leave room for"
        )
        return
    threshold, error = used.shape[THRESHOLD], details.get("threshold_error", 0.0)
    if threshold == HIGHEST[THRESHOLD] or error > MAX_THRESHOLD_ERROR:
        yield (
            f"the reflex's threshold is uncertain ({threshold:.2g} ± {error:.2g} rad/s), as "
            "happens if all movements are equally fast; with another threshold, its gain differs"
        )
    if abs(fitted - mean) > MAX_STIFFNESS_GAP * abs(mean):
        yield (
            "the joint without its reflex is not of second order: the mean stiffness of cascade is "
            f"{mean:.1f} N·m/rad by its impulse response, and {fitted:.1f} by a second-order fit "
            "from 0.5 to 15 Hz, which gives viscosity and inertia; report the difference as an "
            "uncertainty"
        )
    changes = not details["constant"]
    if changes and np.nanmax(upper - gain) > np.nanmax(gain) - np.nanmin(gain):
        yield (
            "the reflex gain's change over time is not identified: its band is wider than its "
            "range; only its mean is"
        )


def reflex_torque(ensemble: Ensemble) -> Array:
    """Return the torque of the reflex in N·m, shape (realization, context + time + context).

    It is that of the fit with which checks look for a reflex, and 0 where it is unknown.
    """
    torque = JointCascade(HARMONICS).fit(ensemble).pathways(ensemble)["reflex"]
    return np.pad(np.nan_to_num(torque), ((0, 0), (ensemble.context, ensemble.context)))


def limit_warnings(lost: float) -> Iterator[str]:
    """Warn if the fit loses a share of the torque because quantities keep one sign."""
    if lost > MAX_LOST:
        yield (
            f"{100 * lost:.1f} % of the torque could be explained only by what no joint has: a "
            "negative viscosity or reflex gain, or a stiffness that changes its sign; possible "
            "causes: a wrong sign of the torque, an early torque, a closed loop, or realizations "
            "that differ"
        )
