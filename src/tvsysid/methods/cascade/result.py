"""The model that is returned: estimates with bands, pathways, and what is to be said about them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import attrs
import numpy as np

from tvsysid.estimates import IMPEDANCE, UNITS, Estimate
from tvsysid.methods.cascade.bands import Covariance, covariance_of
from tvsysid.methods.cascade.choice import SETTLED, Candidate, Hyperparameters, Search
from tvsysid.methods.cascade.pathways import Drive, Measured, Stretch, TwoPathwayModel
from tvsysid.methods.cascade.regressors import intrinsic_filters, readout, unresolved
from tvsysid.methods.cascade.shape import LOGARITHMIC, TERMS, Found, Problem, place_of
from tvsysid.models import Diagnostics, Labelled
from tvsysid.signals import Array, Ensemble

APART = 0.1  # share by which the stiffness of that fit may differ from the response's sum
MAX_LOST = 0.01  # share of the torque that the limits of viscosity and gain may cost
UNKNOWN = 0.1  # rad/s of a threshold's standard error, a third of its prior's
FADED = 3e-3  # share of a muscle's response that is cut off


class Chosen(NamedTuple):
    """A reflex by name, whether it is ``shown``, and the solution with it, of the ``fits`` of a search."""

    search: Search
    fits: Mapping[str, Candidate]
    name: str
    shown: bool
    fit: Candidate
    emg: str | None


@attrs.frozen(eq=False, repr=False, kw_only=True)
class JointCascadeModel(TwoPathwayModel):
    """Both pathways, and what the torque of fast movements has beyond the impulse response.

    ``fast_response`` are viscosity and inertia (time, 2) for the velocity and acceleration that
    the decimated angle does not have (:func:`tvsysid.methods.cascade.regressors.unresolved`), if
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


def of_sign(values: Array, sign: float) -> Array:
    """Values with one sign, without what rounding leaves of the other."""
    return sign * np.maximum(sign * values, 0.0)


class Intrinsic(NamedTuple):
    """Weights (time, lag) of lagged angles, those of derivatives, and the mean stiffness of a second-order fit to them.

    The ``values`` (time,) of stiffness, viscosity and inertia, and the ``features`` (time,
    coefficient) that give them.
    """

    weights: Array
    fast: Array
    fitted_stiffness: float
    values: dict[str, Array]
    features: dict[str, Array]

    @classmethod
    def of(cls, problem: Problem, found: Found, lags: int, rate: float) -> Intrinsic:
        """Of a solution."""
        bases, filters = problem.data.bases, intrinsic_filters(lags, rate)
        coefficients = found.coefficients[: problem.own]
        ends = np.cumsum([functions.shape[1] for functions in bases])
        parts = np.split(coefficients, ends[:-1])
        over_time = [a @ c for a, c in zip(bases, parts, strict=True)]
        weights = np.asarray(sum(np.outer(a, f) for a, f in zip(over_time, filters, strict=True)))
        fitted, *rest = problem.data.features(readout(lags, rate))
        features = dict(zip(IMPEDANCE, (bases[0], *rest), strict=True))
        values = {name: each @ coefficients[: each.shape[1]] for name, each in features.items()}
        for name, sign in (("stiffness", np.sign(coefficients[0])), ("viscosity", 1.0)):
            values[name] = of_sign(values[name], sign)
        return cls(
            weights,
            np.stack(over_time[1:3], axis=1),
            float((fitted @ coefficients).mean()),
            values,
            features,
        )


def model(method: str, chosen: Chosen) -> JointCascadeModel:
    """Model of the reflex chosen if it is shown, else of none; the gain is stated in both."""
    ensemble, lags, fits = chosen.search.ensemble, chosen.search.lags, chosen.fits
    rate = ensemble.sampling_rate
    used = chosen.fit if chosen.shown else fits["none"]
    intrinsic = Intrinsic.of(used.problem, used.found, lags, rate)
    known = np.zeros(ensemble.samples, dtype=bool)
    known[used.problem.data.times] = True
    torques = used.problem.torques(used.found.shape, used.found.coefficients)
    sure = covariance_of(used.problem, used.found)
    reflex_sure = sure if chosen.shown else covariance_of(chosen.fit.problem, chosen.fit.found)
    estimates = {
        name: Estimate(
            np.where(known, values, np.nan),
            UNITS[name],
            error=sure.error(intrinsic.features[name], known, 0, name != "inertia"),
        )
        for name, values in intrinsic.values.items()
    }
    gain, basis = _gain(chosen, ensemble.time)
    unit = "N m/V" if chosen.emg else UNITS["reflex_gain"]
    error = reflex_sure.error(basis, known, chosen.fit.problem.own, one_sign=True)
    estimates["reflex_gain"] = Estimate(np.where(known, gain, np.nan), unit, error=error)
    response, reflex_lags = _reflex_response(chosen)
    details = _details(used, chosen, torques, reflex_sure) | {
        "stiffness_fitted": intrinsic.fitted_stiffness
    }
    nan = np.where(known, 1.0, np.nan)[:, None]
    return JointCascadeModel(
        method=method,
        sampling_rate=rate,
        time=ensemble.time,
        estimates=estimates,
        impulse_response=intrinsic.weights * nan * rate,
        lags=np.arange(-lags, lags + 1) / rate,
        reflex_response=response * nan * rate,
        reflex_lags=reflex_lags,
        drive=_drive(chosen),
        fast_response=intrinsic.fast,
        hyperparameters=Hyperparameters.of(chosen.name, chosen.fit),
        diagnostics=Diagnostics(
            used.found.solved.effective,
            warnings=tuple(_warnings(chosen, details, estimates)),
            details=details,
        ),
    )


def _drive(chosen: Chosen) -> Drive:
    if chosen.emg is not None:
        return Measured(chosen.emg)
    return Stretch(chosen.fit.found.shape.threshold, 1 if chosen.name == "positive" else -1)


def _gain(chosen: Chosen, time: Array) -> tuple[Array, Array]:
    """Reflex gain at times in s, and its basis."""
    problem = chosen.fit.problem
    assert problem.reflex is not None
    basis = problem.reflex.basis(time / problem.reflex.period)
    gain = basis @ chosen.fit.found.coefficients[problem.own :]
    return of_sign(gain, problem.positive[-1, problem.own]), basis


def _reflex_response(chosen: Chosen) -> tuple[Array, Array]:
    """Weights (time, lag) of what drives the reflex, and the lags in s.

    Zero where no reflex is shown.
    """
    ensemble, rate = chosen.search.ensemble, chosen.search.ensemble.sampling_rate
    shape = chosen.fit.found.shape
    longest = max(round(SETTLED * rate), ensemble.context) + 1
    muscle = shape.response(4 * longest, rate)
    late = np.flatnonzero(np.abs(np.cumsum(muscle[::-1])[::-1]) > FADED)[-1]
    first, stop = math.floor(shape.delay * rate + 1e-9), min(int(late) + 1, longest)
    lags = np.arange(first, max(stop, first + 1)) / rate
    if not chosen.shown:
        return np.zeros((ensemble.samples, 1)), lags[:1]
    muscle = muscle[first : first + len(lags)]
    # The gain is that at which the stretch arrives.
    arrival = ensemble.time[:, None] - lags + shape.delay
    gain = _gain(chosen, arrival.ravel())[0].reshape(arrival.shape)
    return gain * muscle / muscle.sum(), lags


def _details(
    used: Candidate, chosen: Chosen, torques: tuple[Array, Array], sure: Covariance
) -> dict[str, float]:
    shape, free = chosen.fit.found.shape, chosen.fit.problem.free
    errors = np.sqrt(np.diag(sure.matrix)[len(sure.matrix) - len(free) :])
    torque = used.problem.data.torque

    def explained(part: Array) -> float:
        return 100 * (1 - float(np.sum((torque - part) ** 2)) / float(np.sum(torque**2)))

    details: dict[str, float] = {
        "reflex_shown": float(chosen.shown),
        "constant": float(not used.problem.data.varies),
    }
    if not chosen.emg:
        details["direction"] = 1.0 if chosen.name == "positive" else -1.0
    for name, value in shape._asdict().items():
        if name == "threshold" and chosen.emg:
            continue
        details[name] = value
        if name in free:
            error = float(errors[free.index(name)])
            details[f"{name}_error"] = error * value if name in LOGARITHMIC else error
    details["vaf"], details["vaf_intrinsic"] = (
        explained(torques[0] + torques[1]),
        explained(torques[0]),
    )
    details["vaf_reflex"] = explained(torques[1])
    details["vaf_held_out"] = 100 * used.share()
    for name, fit in (
        dict(chosen.fits) | ({chosen.name: chosen.fit} if chosen.shown else {})
    ).items():
        details[f"evidence_{name}"] = float(fit.found.objective)
    return details


def _warnings(
    chosen: Chosen, details: Mapping[str, float], estimates: Mapping[str, Estimate]
) -> Iterator[str]:
    if not chosen.shown:
        yield (
            "no reflex is shown by these data: stiffness, viscosity and inertia are those of a "
            "joint without one, and "
            "reflex_gain with its band is what the data leave room for"
        )
        return
    shape, free = chosen.fit.found.shape, chosen.fit.problem.free
    place = dict(zip(free, place_of(shape, free), strict=True))
    if "delay" in free and place["delay"] in (TERMS["delay"].low, TERMS["delay"].high):
        yield (
            f"the delay ran into its bound of {1e3 * shape.delay:.3g} ms: it is not identified; "
            "fix it (delay=0.04)"
        )
    if "threshold" in free and place["threshold"] >= TERMS["threshold"].high:
        yield (
            f"the threshold ran into its bound of {shape.threshold:g} rad/s: it is not "
            "identified, nor is the reflex's "
            "gain"
        )
    elif details.get("threshold_error", 0.0) > UNKNOWN:
        yield (
            f"the threshold is hardly identified ({shape.threshold:.2g} ± "
            f"{details['threshold_error']:.2g} rad/s), as "
            "where all movements are equally fast: the reflex's gain rises and falls with it"
        )
    mean = float(np.nanmean(estimates["stiffness"].values))
    yield from not_of_second_order(mean, details["stiffness_fitted"])
    yield from contradicted(chosen.fit.found.solved.lost)
    yield from doubtful_gain(estimates["reflex_gain"], bool(details["constant"]))


def doubtful_gain(gain: Estimate, constant: bool) -> Iterator[str]:
    """Warn where a reflex gain's band is wider than its change over time."""
    known = gain.values[np.isfinite(gain.values)]
    error = gain.standard_error
    assert error is not None
    if not constant and 1.96 * np.nanmax(error.values) > np.ptp(known):
        yield (
            "the reflex gain's change over time is not identified: its band is wider than its "
            "range; only its mean is"
        )


def not_of_second_order(mean: float, fitted: float) -> Iterator[str]:
    """Warn where a response's sum, the mean stiffness, differs from that of a second-order fit."""
    if abs(fitted - mean) > APART * abs(mean):
        yield (
            "the intrinsic response is not that of a second-order joint: its sum gives a mean "
            f"stiffness of {mean:.1f} "
            f"N·m/rad, a second-order fit from 0.5 to 15 Hz {fitted:.1f}; take the difference as "
            "an uncertainty, and "
            "viscosity and inertia as those of that fit"
        )


def contradicted(lost: float) -> Iterator[str]:
    """Warn where a share of the torque is lost because quantities are of one sign."""
    if lost > MAX_LOST:
        yield (
            "a negative viscosity or reflex gain, or a stiffness of both signs, would explain "
            f"{100 * lost:.1f} % more "
            "of the torque, but no joint has these: the torque may be early, or move the angle, "
            "or the realizations "
            "differ in more than the perturbation"
        )
