"""Both pathways of a joint that changes, identified in turn: what the ensemble and the basis cascade share."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Literal, NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.estimates import UNITS
from tvsysid.methods.base import Method, whole_samples
from tvsysid.methods.cascade import hammerstein
from tvsysid.methods.cascade.pathways import (
    Drive,
    Measured,
    Stretch,
    TwoPathwayModel,
    rectified_velocities,
    velocity_of,
)
from tvsysid.models import ImpulseResponseModel
from tvsysid.numerics.bases import ChebyshevPolynomials, evaluate
from tvsysid.numerics.moments import convolve_lags, diagonal_moments, window_moments
from tvsysid.signals import Array, Ensemble

Nonlinearity = Literal["rectifier", "polynomial"]
Respond = Callable[
    [Array, Array], Array
]  # weights (time, lag) from drive (realization, lag + time) and what it drives

DEGREE = 5  # of the polynomial
TURNS = 30  # of either pathway, at most
GAIN = 1e-5  # share of the torque's power by which a turn must improve the fit
FEWEST = 3  # realizations with their past, below which there is nothing to average over


@attrs.frozen
class Reflex:
    """What is taken of the reflex: its response from the ``delay`` to the ``memory`` in s, and what drives it."""

    delay: float
    memory: float
    nonlinearity: Nonlinearity
    emg: str | None = None


class InTurn(Method):
    """A method that identifies both pathways in turn: what all of them are and need."""

    max_lag: float
    memory: float

    quantities: ClassVar[tuple[str, ...]] = ("reflex_gain",)
    pathway_names: ClassVar[tuple[str, ...]] = ("intrinsic", "reflex")
    uses_recorded_angle: ClassVar[bool] = True

    def skip(self, ensemble: Ensemble) -> str | None:
        """Where too few realizations have the reflex's memory before them."""
        return reason_to_skip(ensemble, self.max_lag, self.memory)


class _Turn(NamedTuple):
    explained: float
    intrinsic: ImpulseResponseModel
    coefficients: Array
    weights: Array


def check_from_zero(method: object, below: float, **settings: float) -> None:
    """Raise for a setting that is not a number from 0 to below another."""
    for name, value in settings.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value < below:
            raise InputError(
                f"{type(method).__name__}: {name} must be from 0 to below {below:g} s, got "
                f"{value!r}"
            )


def complete(ensemble: Ensemble, seconds: float) -> NDArray[np.bool_]:
    """Which realizations have so many seconds recorded before them."""
    past = hammerstein.past_of(ensemble, ensemble.angle[None], whole_samples(seconds, ensemble))
    return np.asarray(~np.isnan(past[0]).any(axis=1))


def reason_to_skip(ensemble: Ensemble, max_lag: float, memory: float) -> str | None:
    """Where too few realizations have recorded before them and after them what the pathways need."""
    count = int(complete(ensemble, memory).sum())
    if count >= min(FEWEST, len(ensemble)) and ensemble.context >= whole_samples(max_lag, ensemble):
        return None
    return (
        f"{count} of {len(ensemble)} realizations have {memory:g} s recorded before them, as long "
        "as the reflex's "
        f"response, and {max_lag:g} s after; cut with more context (--context), or shorten memory"
    )


def identify_in_turn(
    method: str,
    ensemble: Ensemble,
    reflex: Reflex,
    max_lag: float,
    intrinsic: Method,
    respond: Respond,
    directions: Array | None = None,
) -> TwoPathwayModel:
    """Identify the intrinsic pathway from the torque less the reflex's, the reflex from the torque less the intrinsic.

    The one by a method for one pathway, the other by ``respond``, and again until the torque
    explained hardly grows. A polynomial's coefficients are those of least squares on the answers
    to its terms, after each response. With slow ``directions`` (time, direction), what both
    leave is fitted by these in each realization, and taken out in the next turn. Realizations
    whose past is not recorded are left out.
    """
    lags, first, before = (
        whole_samples(each, ensemble) for each in (max_lag, reflex.delay, reflex.memory)
    )
    drives, start, direction = _drives(ensemble, reflex, lags, before)
    past = hammerstein.past_of(ensemble, drives, before)[:, :, : before - first + ensemble.samples]
    known = complete(ensemble, reflex.memory)
    past, part = past[:, known], _with_context(ensemble.select(known), lags)
    torque = part.torque[:, part.core]
    power, answer, slow, coefficients = (
        float(np.sum(torque**2)),
        np.zeros_like(torque),
        np.zeros_like(torque),
        start,
    )
    best: _Turn | None = None
    for turn in range(1, TURNS + 1):
        less = part.torque.copy()
        less[:, part.core] -= answer + slow
        found = intrinsic._identify(attrs.evolve(part, torque=less))
        assert isinstance(found, ImpulseResponseModel)
        beyond = torque - found.predict(part)
        left = beyond - slow
        weights = respond(np.tensordot(coefficients, past, 1), left)
        if len(start) > 1:
            answers = np.stack([convolve_lags(each, weights).ravel() for each in past])
            solved = np.linalg.solve(answers @ answers.T, answers @ left.ravel())
            coefficients = np.asarray(solved / np.linalg.norm(solved))
            weights = respond(np.tensordot(coefficients, past, 1), left)
        answer = convolve_lags(np.tensordot(coefficients, past, 1), weights)
        if directions is not None:
            slow = (beyond - answer) @ directions @ directions.T
        explained = 1 - float(np.sum((beyond - answer - slow) ** 2)) / power
        if best is not None and explained < best.explained + GAIN:
            break
        best = _Turn(explained, found, coefficients, weights)
    assert best is not None
    drive, slope, direction = _drive(ensemble, reflex, drives, best.coefficients, direction)
    diagnostics = best.intrinsic.diagnostics
    details = {**diagnostics.details, "turns": float(turn), "direction": float(direction)}
    if directions is not None:
        details["vaf_with_slow"] = 100 * best.explained
    plain = attrs.evolve(
        best.intrinsic, method=method, diagnostics=attrs.evolve(diagnostics, details=details)
    )
    unit = "N m/V" if reflex.emg else UNITS["reflex_gain"]
    return hammerstein.cascade_model(plain, ensemble, best.weights * slope, drive, first, unit)


def response_moments(drive: Array, output: Array) -> tuple[Array, Array]:
    """Means over realizations of products of lagged drives (time, lag, lag), and of these with the output (time, lag).

    Of a drive (realization, lag + time) and an output (realization, time), from lag 0 on.
    """
    reach = drive.shape[1] - output.shape[1]
    return window_moments(drive, drive, reach, 0)[:, ::-1, ::-1], diagonal_moments(
        output, drive, reach
    )[:, ::-1]


def slow_directions(order: int, samples: int) -> Array:
    """Orthonormal polynomials up to this order over a realization: (time, polynomial)."""
    return np.linalg.qr(evaluate(ChebyshevPolynomials(order + 1), samples))[0]


def _with_context(ensemble: Ensemble, samples: int) -> Ensemble:
    """Ensemble with no more context: the reflex's torque there is not known, and must not enter a window."""
    spare = ensemble.context - samples
    angle, torque = (
        each[:, spare : each.shape[1] - spare] for each in (ensemble.angle, ensemble.torque)
    )
    return attrs.evolve(
        ensemble, angle=angle, torque=torque, channels={}, recorded_angle=None, context=samples
    )


def _drives(ensemble: Ensemble, reflex: Reflex, lags: int, before: int) -> tuple[Array, Array, int]:
    """Signals of which the drive is a sum, the coefficients to begin with, and the direction of stretch."""
    if reflex.emg is not None:
        return ensemble.signal(reflex.emg)[None], np.ones(1), 0
    direction = hammerstein.direction_of_stretch(ensemble, lags, max(before, 2 * lags))
    rectified = Stretch(direction=direction)(ensemble)
    if reflex.nonlinearity == "rectifier":
        return rectified[None], np.ones(1), direction
    drives, _ = hammerstein.polynomial_drives(ensemble, DEGREE)
    start = np.linalg.lstsq(drives.reshape(DEGREE, -1).T, rectified.ravel(), rcond=None)[0]
    return drives, np.asarray(start), direction


def _drive(
    ensemble: Ensemble, reflex: Reflex, drives: Array, coefficients: Array, direction: int
) -> tuple[Drive, float, int]:
    """Drive whose slope for stretch is 1, the slope that was taken out of it, and the direction of stretch."""
    if reflex.emg is not None:
        return Measured(reflex.emg), 1.0, direction
    if reflex.nonlinearity == "rectifier":
        return Stretch(direction=direction), 1.0, direction
    slope, direction = hammerstein.slope_of_stretch(
        np.tensordot(coefficients, drives, 1), rectified_velocities(ensemble)
    )
    limits = hammerstein.limits_of(velocity_of(ensemble)[0])
    return (
        hammerstein.VelocityPolynomial(tuple((coefficients / slope).tolist()), limits),
        slope,
        direction,
    )
