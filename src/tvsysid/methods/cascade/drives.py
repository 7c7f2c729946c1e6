"""Compute the signals that drive a reflex, with their past, and build the cascade model."""

from __future__ import annotations

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid.dataset_layout import UNITS
from tvsysid.methods.cascade.pathways import (
    Drive,
    Stretch,
    TwoPathwayModel,
    history,
    rectified_velocities,
    velocity_of,
)
from tvsysid.methods.responses import ImpulseResponseModel
from tvsysid.models import Estimate, StandardError
from tvsysid.numerics.bands import mean_known
from tvsysid.numerics.bases import chebyshev_of
from tvsysid.numerics.hammerstein import Rows, parallel_cascade
from tvsysid.numerics.stretch import decimated
from tvsysid.signals import Array, Ensemble

CURVE = 101  # velocities at which a polynomial is written down
NO_BAND = "the method's authors state none for two pathways that are identified in turn"


@attrs.frozen
class VelocityPolynomial:
    """Polynomial of the total angle's velocity, which is 0 where the velocity is.

    ``coefficients`` are those of Chebyshev polynomials from degree 1 on. ``limits`` in rad/s are
    mapped to -1 and 1; beyond them the polynomial keeps its value.
    """

    coefficients: tuple[float, ...]
    limits: tuple[float, float]

    def __call__(self, ensemble: Ensemble) -> Array:
        """Return the polynomial at the recorded rate, decimated as the torque was."""
        velocity, ratio = velocity_of(ensemble)
        return decimated(self.value(velocity), ratio)

    def value(self, velocity: Array) -> Array:
        """Return the polynomial at a velocity in rad/s, of any shape."""
        degrees = degrees_of(velocity, self.limits, len(self.coefficients))
        return np.asarray(degrees @ np.array(self.coefficients))

    def curve(self) -> tuple[Array, Array]:
        """Return velocities in rad/s within the limits, and the polynomial at each."""
        velocity = np.linspace(*self.limits, CURVE)
        return velocity, self.value(velocity)


def degrees_of(velocity: Array, limits: tuple[float, float], degree: int) -> Array:
    """Return Chebyshev polynomials of degree 1 on, less their values at rest: (..., degree)."""
    degrees = chebyshev_of(velocity, limits, degree + 1)
    degrees -= chebyshev_of(np.zeros(1), limits, degree + 1)[0]
    return degrees[..., 1:]


@attrs.frozen(eq=False)
class Candidate:
    """Signals (signal, realization, context + time + context) whose weighted sum drives a reflex.

    ``start`` are the initial weights. A single signal has a ``drive``; several signals are
    polynomials of a velocity within ``limits``.
    """

    signals: Array
    start: Array
    drive: Drive | None = None
    limits: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def of_drive(cls, ensemble: Ensemble, drive: Drive) -> Candidate:
        """Return a candidate with one signal."""
        return cls(drive(ensemble)[None], np.ones(1), drive)

    @classmethod
    def polynomial(cls, ensemble: Ensemble, degree: int) -> Candidate:
        """Return decimated polynomials of the velocity, without initial weights."""
        velocity, ratio = velocity_of(ensemble)
        limits = float(velocity.min()), float(velocity.max())
        degrees = np.moveaxis(degrees_of(velocity, limits, degree), -1, 0)
        return cls(
            np.stack([decimated(each, ratio) for each in degrees]), np.zeros(degree), None, limits
        )

    def towards(self, target: Array) -> Candidate:
        """Return a candidate whose initial weighted sum is the least-squares fit to a signal."""
        columns = self.signals.reshape(len(self.signals), -1).T
        start = np.asarray(np.linalg.lstsq(columns, target.ravel(), rcond=None)[0])
        return attrs.evolve(self, start=start)

    def scaled(self, ensemble: Ensemble, weights: Array) -> tuple[Drive, float, int]:
        """Return the drive with a slope of 1 for stretch, its slope before, and its direction.

        A polynomial is fitted by least squares with an offset and a slope for either direction,
        as it rounds the corner of a rectifier. The steeper direction is that of stretch.
        """
        if self.drive is not None:
            return self.drive, 1.0, getattr(self.drive, "direction", 0)
        columns = rectified_velocities(ensemble).reshape(2, -1).T
        target = np.tensordot(weights, self.signals, 1).ravel()
        centred = columns - columns.mean(axis=0)
        slopes = np.linalg.lstsq(centred, target - target.mean(), rcond=None)[0]
        steeper = int(np.argmax(np.abs(slopes)))
        slope = float(slopes[steeper])
        drive = VelocityPolynomial(tuple((weights / slope).tolist()), self.limits)
        return drive, slope, (1, -1)[steeper]


def rectifiers(ensemble: Ensemble) -> list[Candidate]:
    """Return the velocity of stretch, rectified, for either direction."""
    return [Candidate.of_drive(ensemble, Stretch(direction=direction)) for direction in (1, -1)]


def past_of(ensemble: Ensemble, signals: Array, before: int) -> Array:
    """Return signals with their past (signal, realization, before + time).

    Their mean over realizations is subtracted where the ensemble's is.
    """
    past = np.stack([history(ensemble, each, before) for each in signals])
    return (
        np.stack([each - mean_known(each) for each in past]) if ensemble.mean_subtracted else past
    )


def rows_with_history(ensemble: Ensemble, signals: Array, lags: int, before: int) -> list[Rows]:
    """Return signals (1 + signal, realization, before + time) and torque with their known past.

    The first signal is the angle ``lags`` samples ahead, with at most 2 ``lags`` samples before.
    Realizations whose past begins at the same time are together.
    """
    past = past_of(ensemble, signals, before)
    short = max(0, lags - ensemble.context)
    missing: NDArray[np.int64] = np.isnan(past[0]).sum(axis=1)  # it lies before all else
    missing, last = np.maximum(missing, short), ensemble.samples - short
    found = []
    for first in np.unique(missing[missing < last]):
        rows = np.flatnonzero(missing == first)
        columns = ensemble.context + lags + np.arange(first - before, last)
        angle = np.where(columns >= 0, ensemble.angle[np.ix_(rows, np.maximum(columns, 0))], 0.0)
        together = np.concatenate([angle[None], past[:, rows, first : before + last]])
        times = slice(ensemble.context + first, ensemble.context + last)
        found.append((together, ensemble.torque[rows, times]))
    return found


def rectifier_of_constant(ensemble: Ensemble, lags: int, before: int) -> Candidate:
    """Return the rectified velocity that explains more of the torque of a constant joint."""

    def explained(candidate: Candidate) -> float:
        rows = rows_with_history(ensemble, candidate.signals, lags, before)
        return parallel_cascade(rows, lags, candidate.start, "rectifier").explained

    return max(rectifiers(ensemble), key=explained)


def cascade_model(
    plain: ImpulseResponseModel,
    ensemble: Ensemble,
    reflex: Array,
    drive: Drive,
    first: int = 0,
    unit: str = UNITS["reflex_gain"],
) -> TwoPathwayModel:
    """Return a model of the intrinsic pathway with a reflex of weights (time, lag) beside it.

    The lags begin with ``first``. The gain is the area under the reflex's response. No estimate
    has a band.
    """
    rate, none = ensemble.sampling_rate, StandardError.none(ensemble.samples, NO_BAND)
    known = {name: attrs.evolve(each, error=none) for name, each in plain.estimates.items()}
    model = TwoPathwayModel(
        **{item.name: getattr(plain, item.name) for item in attrs.fields(type(plain))}
        | {"estimates": {**known, "reflex_gain": Estimate(reflex.sum(axis=1), unit, error=none)}},
        reflex_response=reflex * rate,
        reflex_lags=(first + np.arange(reflex.shape[1])) / rate,
        drive=drive,
    )
    return with_shares(model, ensemble)


def with_shares(model: TwoPathwayModel, ensemble: Ensemble) -> TwoPathwayModel:
    """Return the model with the shares of the torque that it and its pathways explain, in %."""
    torque, parts = ensemble.torque[:, ensemble.core], model.pathways(ensemble)
    whole = parts["intrinsic"] + parts["reflex"]
    known = np.isfinite(whole)
    power = float(np.sum(torque[known] ** 2))
    explained = {"vaf": whole} | {f"vaf_{name}": part for name, part in parts.items()}
    shares = {
        name: 100 * (1 - float(np.sum((torque - part)[known] ** 2)) / power)
        for name, part in explained.items()
    }
    details = {**model.diagnostics.details, **shares}
    return attrs.evolve(model, diagnostics=attrs.evolve(model.diagnostics, details=details))
