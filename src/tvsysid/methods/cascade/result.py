"""Build the model of the joint fit: estimates with bands, pathways, diagnostics and warnings."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import attrs
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tvsysid.dataset_layout import UNITS, Labelled
from tvsysid.methods.cascade.columns import intrinsic_filters, muscle, readout, unresolved
from tvsysid.methods.cascade.fit import DELAY, HIGHEST, IS_LOG, LOWEST, NUMBERS, THRESHOLD, Fit
from tvsysid.methods.cascade.pathways import PATHWAYS, TwoPathwayModel, explained_shares
from tvsysid.methods.cascade.search import DIRECTIONS, Hyperparameters, Selection
from tvsysid.models import IMPEDANCE, Diagnostics, Estimate, StandardError
from tvsysid.numerics.bands import arc_length
from tvsysid.signals import Array, Ensemble

MAX_STIFFNESS_GAP = 0.1  # share by which stiffness may differ from that of a second-order fit
MAX_LOST = 0.01  # share of the torque that the limits of viscosity and gain may cost
MAX_THRESHOLD_ERROR = 0.1  # rad/s, a third of the prior's standard deviation
CUT_SHARE = 3e-3  # share of a muscle's response that is cut off
MAX_REFLEX_LAG_S = 0.45  # if the context is not longer


@attrs.frozen(eq=False, repr=False, kw_only=True)
class JointCascadeModel(TwoPathwayModel):
    """Model of both pathways, with the torque of fast movements beyond the impulse response.

    ``fast_response`` (time, 2) is the viscosity and inertia for the velocity and acceleration
    that the decimated angle lacks (:func:`tvsysid.methods.cascade.columns.unresolved`), if
    the ensemble keeps the angle as recorded. ``hyperparameters`` are those of the fit with the
    reflex whose gain is stated.
    """

    fast_response: Array
    hyperparameters: Hyperparameters

    def _pathways(self, ensemble: Ensemble) -> dict[str, Array]:
        found = super()._pathways(ensemble)
        fast = unresolved(ensemble.angle_as_recorded, len(self.lags) // 2, self.sampling_rate)
        further = np.einsum("td,drt->rt", self.fast_response, fast[..., ensemble.core])
        if ensemble.mean_subtracted:
            further -= further.mean(axis=0)
        return found | {"intrinsic": found["intrinsic"] + further}

    def _identified(self) -> tuple[Labelled, Labelled]:
        variables, coordinates = super()._identified()
        variables["fast_response"] = (("time", "derivative"), self.fast_response)
        return variables, coordinates | {"derivative": (("derivative",), [1, 2])}


class OneSignError(StandardError):
    """Standard error of an estimate of one sign. Its band has the same sign."""

    def limits(
        self, values: Array, level: float, simultaneous: bool = False
    ) -> tuple[Array, Array]:
        """See :meth:`tvsysid.Estimate.band`."""
        lower, upper = super().limits(values, level, simultaneous)
        if np.nanmin(values) < 0:
            return lower, np.minimum(upper, 0.0)
        return np.maximum(lower, 0.0), upper


def model(method: str, selection: Selection) -> JointCascadeModel:
    """Return the model with the selected reflex if it is shown, else without one.

    The gain is stated in both.
    """
    search, fits, name, shown, fit = selection
    ensemble, lags, rate = search.ensemble, search.lags, search.ensemble.sampling_rate
    used = fit if shown else fits["none"]
    data, mean = used.data, used.posterior.mean
    weights = np.eye(1, len(data.starts)), readout(lags, rate)[1:]
    features = [data.features(each) for each in np.concatenate(weights)]
    signs = float(np.sign(mean[0])), 1.0, None
    estimates = {
        quantity: _estimate(used, UNITS[quantity], each, sign)
        for quantity, each, sign in zip(IMPEDANCE, features, signs, strict=True)
    }
    gain = data.gain(ensemble.time / data.period)
    unit = "N m/V" if search.emg else UNITS["reflex_gain"]
    estimates["reflex_gain"] = _estimate(fit, unit, gain, _gain_sign(fit), data.own)
    known = estimates["stiffness"].values[:, None] * 0 + 1  # NaN where no sample is fitted
    response, reflex_lags = _reflex_response(selection)
    over_time = data.over_time(mean[: data.own])
    details = _details(selection, used)
    details["stiffness_fitted"] = float((over_time @ readout(lags, rate)[0]).mean())
    texts = _warnings(selection, details, float(over_time[data.times, 0].mean()))
    return JointCascadeModel(
        method=method,
        sampling_rate=rate,
        time=ensemble.time,
        estimates=estimates,
        impulse_response=over_time @ intrinsic_filters(lags, rate) * known * rate,
        lags=np.arange(-lags, lags + 1) / rate,
        reflex_response=response * known * rate,
        reflex_lags=reflex_lags,
        drive=search.drive(name, float(fit.shape[THRESHOLD])),
        fast_response=over_time[:, 1:3],
        hyperparameters=Hyperparameters(name, data.varies, data.noise, fit.shape, fit.parameters),
        diagnostics=Diagnostics(used.posterior.effective, warnings=tuple(texts), details=details),
    )


def _estimate(fit: Fit, unit: str, features: Array, sign: float | None, start: int = 0) -> Estimate:
    """Return weighted sums of the coefficients from ``start`` on, where samples are fitted.

    ``features`` (time, coefficient) are the weights. Values of the other sign are rounding.
    """
    columns = slice(start, start + features.shape[1])
    known = np.full(len(features), np.nan)
    known[fit.data.times] = 1.0
    values, covariance = features @ fit.posterior.mean[columns], fit.covariance[columns, columns]
    variance = np.einsum("tj,tj->t", features @ covariance, features)
    error = (StandardError if sign is None else OneSignError)(
        np.sqrt(np.maximum(variance, 0.0)) * known,
        np.array(fit.freedom),
        arc_length(features, covariance),
    )
    values = values if sign is None else sign * np.maximum(sign * values, 0.0)
    return Estimate(values * known, unit, error=error)


def _gain_sign(fit: Fit) -> float:
    assert fit.positive is not None
    return float(fit.positive[-1, fit.data.own])


def _reflex_response(selection: Selection) -> tuple[Array, Array]:
    """Return the weights (time, lag) of the reflex's drive, and the lags in s.

    The weights are zero if no reflex is shown.
    """
    ensemble, fit, data = selection.search.ensemble, selection.fit, selection.fit.data
    max_lags = max(round(MAX_REFLEX_LAG_S * data.rate), ensemble.context) + 1
    weights = muscle(fit.shape, 4 * max_lags, data.rate)
    last = np.flatnonzero(np.abs(np.cumsum(weights[::-1])[::-1]) > CUT_SHARE)[-1]
    first = math.floor(fit.shape[DELAY] * data.rate + 1e-9)
    lags = np.arange(first, max(min(int(last) + 1, max_lags), first + 1)) / data.rate
    if not selection.shown:
        return np.zeros((ensemble.samples, 1)), lags[:1]
    weights = weights[first : first + len(lags)]
    # The gain is that at which the stretch arrives.
    steps = np.arange(1 - len(lags), ensemble.samples) / data.rate
    gain = data.gain((steps - lags[0] + fit.shape[DELAY]) / data.period)
    sign, arriving = _gain_sign(fit), gain @ fit.posterior.mean[data.own :]
    windows = sliding_window_view(sign * np.maximum(sign * arriving, 0.0), len(lags))
    return windows[:, ::-1] * weights / weights.sum(), lags


def _details(selection: Selection, used: Fit) -> dict[str, float]:
    _, fits, name, shown, fit = selection
    values = np.where(IS_LOG, np.exp(fit.shape), fit.shape)
    errors = np.sqrt(np.diag(fit.covariance)[len(fit.posterior.mean) :])
    errors *= np.where(IS_LOG, values, 1.0)[fit.free]
    details = {"reflex_shown": float(shown), "constant": float(not used.data.varies)}
    details |= dict(zip(NUMBERS, values.tolist(), strict=True))
    details |= {f"{NUMBERS[n]}_error": float(e) for n, e in zip(fit.free, errors, strict=True)}
    if name in DIRECTIONS:
        details["direction"] = float(DIRECTIONS[name])
    else:
        del details["threshold"]
    torques = used.regression.torques(used.posterior.mean)
    details |= explained_shares(used.data.torque, dict(zip(PATHWAYS, torques, strict=True)))
    if fits:  # else it is a part of the realizations that is fitted again
        details["vaf_held_out"] = 100 * used.share()
    evidence = {**fits, name: fit} if shown else fits
    return details | {f"evidence_{each}": float(evidence[each].objective) for each in evidence}


def _warnings(selection: Selection, details: Mapping[str, float], mean: float) -> Iterator[str]:
    """Yield reasons to doubt the reflex, or a ``mean`` stiffness."""
    fit, fitted = selection.fit, details["stiffness_fitted"]
    if not selection.shown:
        yield (
            "no reflex is shown by these data: stiffness, viscosity and inertia are those of a "
            "joint without one, and reflex_gain with its band is what the data leave room for"
        )
        return
    if DELAY in fit.free and fit.shape[DELAY] in (LOWEST[DELAY], HIGHEST[DELAY]):
        yield (
            f"the delay ran into its bound of {1e3 * fit.shape[DELAY]:.3g} ms: it is not "
            "identified; fix it (delay=0.04)"
        )
    threshold, error = fit.shape[THRESHOLD], details.get("threshold_error", 0.0)
    if threshold == HIGHEST[THRESHOLD] or error > MAX_THRESHOLD_ERROR:
        yield (
            f"the threshold is hardly identified ({threshold:.2g} ± {error:.2g} rad/s), as where "
            "all movements are equally fast: the reflex's gain rises and falls with it"
        )
    if abs(fitted - mean) > MAX_STIFFNESS_GAP * abs(mean):
        yield (
            "the intrinsic response is not that of a second-order joint: its sum gives a mean "
            f"stiffness of {mean:.1f} N·m/rad, a second-order fit from 0.5 to 15 Hz {fitted:.1f}; "
            "take the difference as an uncertainty, and viscosity and inertia as those of that fit"
        )
    unlimited = attrs.evolve(fit, positive=None).posterior
    square = fit.regression.moments.square
    yield from contradicted((fit.posterior.left - unlimited.left) / square)


def contradicted(lost: float) -> Iterator[str]:
    """Warn if the fit loses a share of the torque because quantities keep one sign."""
    if lost > MAX_LOST:
        yield (
            "a negative viscosity or reflex gain, or a stiffness of both signs, would explain "
            f"{100 * lost:.1f} % more of the torque, but no joint has these: the torque may be "
            "early, or move the angle, or the realizations differ in more than the perturbation"
        )
