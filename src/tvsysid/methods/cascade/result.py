"""Build the model of the joint fit: estimates with bands, pathways, diagnostics and warnings."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import attrs
import numpy as np

from tvsysid.dataset_layout import UNITS, Labelled
from tvsysid.methods.cascade.columns import intrinsic_filters, readout, unresolved
from tvsysid.methods.cascade.pathways import PATHWAYS, TwoPathwayModel, explained_shares
from tvsysid.methods.cascade.problem import Solution
from tvsysid.methods.cascade.search import DIRECTIONS, Chosen, Hyperparameters
from tvsysid.methods.cascade.shape import LOGARITHMIC, Terms
from tvsysid.models import IMPEDANCE, Diagnostics, Estimate, StandardError
from tvsysid.numerics.bands import arc_length
from tvsysid.numerics.gaussian import solve
from tvsysid.numerics.noise import autocorrelation
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
    the ensemble keeps the angle as recorded. ``hyperparameters`` are those of the solution with
    the reflex whose gain is stated.
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


def model(method: str, chosen: Chosen) -> JointCascadeModel:
    """Return the model with the chosen reflex if it is shown, else without one.

    The gain is stated in both.
    """
    ensemble, lags = chosen.search.ensemble, chosen.search.lags
    used = chosen.fit if chosen.shown else chosen.fits["none"]
    data, rate = used.problem.data, ensemble.sampling_rate
    known = np.full(ensemble.samples, np.nan)
    known[data.times] = 1.0
    covariance = covariance_of(used)
    gain_covariance = covariance if chosen.shown else covariance_of(chosen.fit)

    coefficients = used.coefficients[: used.problem.own]
    fitted, *rest = data.features(readout(lags, rate))
    estimates = {}
    for name, features in zip(IMPEDANCE, (data.bases[0], *rest), strict=True):
        sign = {"stiffness": np.sign(coefficients[0]), "viscosity": 1.0}.get(name)
        own = coefficients[: features.shape[1]]
        error = covariance.error(features, known, 0, sign is not None)
        estimates[name] = Estimate(of_sign(features @ own, sign) * known, UNITS[name], error=error)
    gain, functions = _gain(chosen, ensemble.time)
    unit = "N m/V" if chosen.search.emg else UNITS["reflex_gain"]
    error = gain_covariance.error(functions, known, chosen.fit.problem.own, True)
    estimates["reflex_gain"] = Estimate(gain * known, unit, error=error)

    response, reflex_lags = _reflex_response(chosen)
    details = _details(used, chosen, gain_covariance)
    details["stiffness_fitted"] = float((fitted @ coefficients).mean())
    over_time = data.over_time(coefficients)
    return JointCascadeModel(
        method=method,
        sampling_rate=rate,
        time=ensemble.time,
        estimates=estimates,
        impulse_response=over_time @ intrinsic_filters(lags, rate) * known[:, None] * rate,
        lags=np.arange(-lags, lags + 1) / rate,
        reflex_response=response * known[:, None] * rate,
        reflex_lags=reflex_lags,
        drive=chosen.search.drive(chosen.name, chosen.fit.shape.threshold),
        fast_response=over_time[:, 1:3],
        hyperparameters=Hyperparameters(
            chosen.name, data.varies, data.noise, chosen.fit.shape, chosen.fit.parameters
        ),
        diagnostics=Diagnostics(
            used.ridge.posterior.effective,
            warnings=tuple(_warnings(chosen, details, estimates)),
            details=details,
        ),
    )


def of_sign(values: Array, sign: float | None) -> Array:
    """Return values of one sign; values of the other sign, from rounding, become 0."""
    return values if sign is None else sign * np.maximum(sign * values, 0.0)


def _gain(chosen: Chosen, time: Array) -> tuple[Array, Array]:
    """Return the reflex gain at times in s, and its functions of time."""
    problem = chosen.fit.problem
    assert problem.reflex is not None
    functions = problem.reflex.basis(time / problem.reflex.period)
    gain = functions @ chosen.fit.coefficients[problem.own :]
    return of_sign(gain, problem.positive[-1, problem.own]), functions


def _reflex_response(chosen: Chosen) -> tuple[Array, Array]:
    """Return the weights (time, lag) of the reflex's drive, and the lags in s.

    The weights are zero if no reflex is shown.
    """
    ensemble, rate = chosen.search.ensemble, chosen.search.ensemble.sampling_rate
    shape = chosen.fit.shape
    max_lags = max(round(MAX_REFLEX_LAG_S * rate), ensemble.context) + 1
    muscle = shape.response(4 * max_lags, rate)
    last = np.flatnonzero(np.abs(np.cumsum(muscle[::-1])[::-1]) > CUT_SHARE)[-1]
    first = math.floor(shape.delay * rate + 1e-9)
    lags = np.arange(first, max(min(int(last) + 1, max_lags), first + 1)) / rate
    if not chosen.shown:
        return np.zeros((ensemble.samples, 1)), lags[:1]
    muscle = muscle[first : first + len(lags)]
    # The gain is that at which the stretch arrives.
    arrival = ensemble.time[:, None] - lags + shape.delay
    gain = _gain(chosen, arrival.ravel())[0].reshape(arrival.shape)
    return gain * muscle / muscle.sum(), lags


def _details(used: Solution, chosen: Chosen, covariance: Covariance) -> dict[str, float]:
    shape, free, torque = chosen.fit.shape, chosen.fit.problem.free, used.problem.data.torque
    errors = dict(zip(free, np.sqrt(np.diag(covariance.matrix)[-len(free) :]), strict=False))
    details = {"reflex_shown": float(chosen.shown), "constant": float(not used.problem.data.varies)}
    if not chosen.search.emg:
        details["direction"] = float(DIRECTIONS[chosen.name])
    for name, value in shape._asdict().items():
        if name == "threshold" and chosen.search.emg:
            continue
        details[name] = value
        if name in errors:
            unit = value if name in LOGARITHMIC else 1.0
            details[f"{name}_error"] = float(errors[name]) * unit
    details |= explained_shares(torque, dict(zip(PATHWAYS, used.torques(), strict=True)))
    if chosen.fits:  # else it is a part of the realizations that is fitted again
        details["vaf_held_out"] = 100 * used.share()
    fits = {**chosen.fits, **({chosen.name: chosen.fit} if chosen.shown else {})}
    return details | {f"evidence_{name}": float(fit.objective) for name, fit in fits.items()}


def _warnings(
    chosen: Chosen, details: Mapping[str, float], estimates: Mapping[str, Estimate]
) -> Iterator[str]:
    if not chosen.shown:
        yield (
            "no reflex is shown by these data: stiffness, viscosity and inertia are those of a "
            "joint without one, and reflex_gain with its band is what the data leave room for"
        )
        return
    shape, free = chosen.fit.shape, chosen.fit.problem.free
    bounds, position = Terms.of(free), shape.position(free)
    at_bound = dict(zip(free, (position == bounds.low) | (position == bounds.high), strict=True))
    if at_bound.get("delay"):
        yield (
            f"the delay ran into its bound of {1e3 * shape.delay:.3g} ms: it is not identified; "
            "fix it (delay=0.04)"
        )
    if at_bound.get("threshold") and shape.threshold > 0:
        yield (
            f"the threshold ran into its bound of {shape.threshold:g} rad/s: it is not identified, "
            "nor is the reflex's gain"
        )
    elif details.get("threshold_error", 0.0) > MAX_THRESHOLD_ERROR:
        yield (
            f"the threshold is hardly identified ({shape.threshold:.2g} ± "
            f"{details['threshold_error']:.2g} rad/s), as where all movements are equally fast: "
            "the reflex's gain rises and falls with it"
        )
    mean = float(np.nanmean(estimates["stiffness"].values))
    yield from not_of_second_order(mean, details["stiffness_fitted"])
    yield from contradicted(chosen.fit.ridge.lost)
    yield from doubtful_gain(estimates["reflex_gain"], bool(details["constant"]))


def doubtful_gain(gain: Estimate, constant: bool) -> Iterator[str]:
    """Warn if the band of the reflex gain is wider than its change over time."""
    known = gain.values[np.isfinite(gain.values)]
    error = gain.standard_error
    assert error is not None
    if not constant and 1.96 * np.nanmax(error.values) > np.ptp(known):
        yield (
            "the reflex gain's change over time is not identified: its band is wider than its "
            "range; only its mean is"
        )


def not_of_second_order(mean: float, fitted: float) -> Iterator[str]:
    """Warn if the mean stiffness of the response differs from that of a second-order fit."""
    if abs(fitted - mean) > MAX_STIFFNESS_GAP * abs(mean):
        yield (
            "the intrinsic response is not that of a second-order joint: its sum gives a mean "
            f"stiffness of {mean:.1f} N·m/rad, a second-order fit from 0.5 to 15 Hz {fitted:.1f}; "
            "take the difference as an uncertainty, and viscosity and inertia as those of that fit"
        )


def contradicted(lost: float) -> Iterator[str]:
    """Warn if the fit loses a share of the torque because quantities keep one sign."""
    if lost > MAX_LOST:
        yield (
            "a negative viscosity or reflex gain, or a stiffness of both signs, would explain "
            f"{100 * lost:.1f} % more of the torque, but no joint has these: the torque may be "
            "early, or move the angle, or the realizations differ in more than the perturbation"
        )


class OneSignError(StandardError):
    """Standard error of an estimate of one sign. Its band has the same sign."""

    def limits(
        self, values: Array, level: float, simultaneous: bool = False
    ) -> tuple[Array, Array]:
        """See :meth:`tvsysid.Estimate.band`."""
        lower, upper = super().limits(values, level, simultaneous)
        return (
            (lower, np.minimum(upper, 0.0))
            if np.nanmin(values) < 0
            else (np.maximum(lower, 0.0), upper)
        )


class Covariance(NamedTuple):
    """Covariance of the columns' coefficients, followed by the free numbers of the shape.

    ``freedom`` is the number of degrees of freedom of the noise variance.
    """

    matrix: Array
    freedom: float

    def error(self, features: Array, known: Array, start: int, one_sign: bool) -> StandardError:
        """Return the standard error of weighted sums of the coefficients from ``start`` on.

        ``features`` (time, coefficient) are the weights. ``known`` is 1, or NaN where the error is.
        """
        columns = slice(start, start + features.shape[1])
        covariance = self.matrix[columns, columns]
        variance = np.einsum("tj,tj->t", features @ covariance, features)
        kind = OneSignError if one_sign else StandardError
        return kind(
            np.sqrt(np.maximum(variance, 0.0)) * known,
            np.array(self.freedom),
            arc_length(features, covariance),
        )


def covariance_of(found: Solution) -> Covariance:
    r"""Return the sandwich covariance of a solution's coefficients.

    .. math:: H^{-1} \left(\Phi^T Q \Sigma Q \Phi + \sigma^4 P^{-1}\right) H^{-1}, \qquad
              H = \Phi^T Q \Phi + \sigma^2 P^{-1}

    The derivatives by the shape are among the columns. P is the prior's covariance, Q the weights
    of the samples, and :math:`\Sigma` the noise's autocovariance within a realization, from what
    is left.
    """
    data, left, precision = found.problem.data, found.left, found.precision()
    freedom = max(1.0, data.number - found.ridge.posterior.effective - len(found.problem.free))
    inverse = solve(found.moments_with_slopes(data, found.moments), precision).covariance
    true = data.weighted(data.noise, autocorrelation(left, 0.0))
    moments = attrs.evolve(found.problem, data=true).moments(found.shape)
    coloured = found.moments_with_slopes(true, moments).gram
    matrix = (
        float(np.sum(left**2)) / freedom * inverse @ coloured @ inverse
        + found.ridge.noise_variance * (inverse * precision) @ inverse
    )
    return Covariance(matrix, freedom)
