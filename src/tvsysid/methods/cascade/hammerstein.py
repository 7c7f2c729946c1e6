"""A reflex as a static function of the velocity and a response to it: what the cascades share."""

from __future__ import annotations

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid.estimates import UNITS, Estimate, StandardError
from tvsysid.methods.cascade.pathways import (
    Drive,
    TwoPathwayModel,
    history,
    rectified_velocities,
    velocity_of,
)
from tvsysid.models import ImpulseResponseModel
from tvsysid.numerics.bands import mean_known
from tvsysid.numerics.bases import chebyshev_of
from tvsysid.numerics.hammerstein import Rows, parallel_cascade
from tvsysid.numerics.stretch import decimated
from tvsysid.signals import Array, Ensemble

CURVE = 101  # velocities at which a polynomial is written down
NO_BAND = "the method's authors state none for two pathways that are identified in turn"


@attrs.frozen
class VelocityPolynomial:
    """Polynomial of the velocity of the total angle, 0 where that is.

    ``coefficients`` of Chebyshev's from degree 1 on.

    ``limits`` in rad/s are those that are mapped to -1 and 1; beyond them the polynomial keeps
    its value.
    """

    coefficients: tuple[float, ...]
    limits: tuple[float, float]

    def __call__(self, ensemble: Ensemble) -> Array:
        """Polynomial at the recorded rate, then decimated as the torque was."""
        velocity, ratio = velocity_of(ensemble)
        return decimated(self.value(velocity), ratio)

    def value(self, velocity: Array) -> Array:
        """At a velocity in rad/s, of any shape."""
        return np.asarray(
            degrees_of(velocity, self.limits, len(self.coefficients)) @ np.array(self.coefficients)
        )

    def curve(self) -> tuple[Array, Array]:
        """Velocities in rad/s within the limits, and the polynomial at each."""
        velocity = np.linspace(*self.limits, CURVE)
        return velocity, self.value(velocity)


def degrees_of(velocity: Array, limits: tuple[float, float], degree: int) -> Array:
    """Chebyshev polynomials of degree 1 to the highest, less what they are at rest: (..., degree)."""
    degrees = chebyshev_of(velocity, limits, degree + 1)
    degrees -= chebyshev_of(np.zeros(1), limits, degree + 1)[0]
    return degrees[..., 1:]


def limits_of(velocity: Array) -> tuple[float, float]:
    """Lowest and highest velocity in rad/s."""
    return float(velocity.min()), float(velocity.max())


def polynomial_drives(ensemble: Ensemble, degree: int) -> tuple[Array, tuple[float, float]]:
    """Polynomials (degree, realization, context + time + context) of the velocity, decimated, and its limits."""
    velocity, ratio = velocity_of(ensemble)
    limits = limits_of(velocity)
    values = np.stack(
        [
            decimated(each, ratio)
            for each in np.moveaxis(degrees_of(velocity, limits, degree), -1, 0)
        ]
    )
    return values, limits


def slope_of_stretch(drive: Array, rectified: Array) -> tuple[float, int]:
    """Mean slope of a static function of the velocity in the direction in which it is steeper, and this direction.

    The ``drive`` is fitted by least squares with an offset and a slope for either of the
    ``rectified`` velocities, (2, ...): a polynomial rounds the corner of a rectifier.
    """
    columns, target = rectified.reshape(2, -1).T, drive.ravel()
    slopes = np.linalg.lstsq(columns - columns.mean(axis=0), target - target.mean(), rcond=None)[0]
    steeper = int(np.argmax(np.abs(slopes)))
    return float(slopes[steeper]), (1, -1)[steeper]


def past_of(ensemble: Ensemble, drives: Array, before: int) -> Array:
    """Drives (signal, realization, before + time), their mean over realizations subtracted where the ensemble's is."""
    past = np.stack([history(ensemble, each, before) for each in drives])
    return (
        np.stack([each - mean_known(each) for each in past]) if ensemble.mean_subtracted else past
    )


def rows_with_history(ensemble: Ensemble, drives: Array, lags: int, before: int) -> list[Rows]:
    """Signals (1 + signal, realization, before + time) and torque, wherever they are recorded with what they need.

    The first signal is the angle so many samples ``lags`` ahead, of which no more than 2 lags
    samples before are there. Realizations are together that have their past from the same time
    on.
    """
    past = past_of(ensemble, drives, before)
    missing: NDArray[np.int64] = np.isnan(past[0]).sum(
        axis=1
    )  # what is missing lies before all else
    short = max(0, lags - ensemble.context)
    last, found = ensemble.samples - short, []
    for first in np.unique(np.maximum(missing, short)):
        if first >= last:
            continue
        who = np.flatnonzero(np.maximum(missing, short) == first)
        columns = ensemble.context + lags + np.arange(first - before, last)
        angle = np.where(columns >= 0, ensemble.angle[np.ix_(who, np.maximum(columns, 0))], 0.0)
        signals = np.concatenate([angle[None], past[:, who, first : before + last]])
        found.append(
            (signals, ensemble.torque[who, ensemble.context + first : ensemble.context + last])
        )
    return found


def direction_of_stretch(ensemble: Ensemble, lags: int, before: int) -> int:
    """Direction, 1 or -1, whose rectified velocity explains more of the torque, were the joint constant."""
    explained = [
        parallel_cascade(
            rows_with_history(ensemble, each[None], lags, before), lags, np.ones(1), "rectifier"
        ).explained
        for each in rectified_velocities(ensemble)
    ]
    return (1, -1)[int(np.argmax(explained))]


def cascade_model(
    plain: ImpulseResponseModel,
    ensemble: Ensemble,
    reflex: Array,
    drive: Drive,
    first: int = 0,
    unit: str = UNITS["reflex_gain"],
) -> TwoPathwayModel:
    """Model of the intrinsic pathway with a reflex beside it, of weights (time, lag) on lags from the ``first`` on.

    The gain is the area under the reflex's response. No estimate has a band.
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
    """Model that knows what shares of the torque it explains, in per cent: together, and by either pathway."""
    torque, parts = ensemble.torque[:, ensemble.core], model.pathways(ensemble)
    whole = parts["intrinsic"] + parts["reflex"]
    seen = np.isfinite(whole)
    power = float(np.sum(torque[seen] ** 2))
    explained = {"vaf": whole} | {f"vaf_{name}": part for name, part in parts.items()}
    shares = {
        name: 100 * (1 - float(np.sum((torque - part)[seen] ** 2)) / power)
        for name, part in explained.items()
    }
    return attrs.evolve(
        model,
        diagnostics=attrs.evolve(
            model.diagnostics, details={**model.diagnostics.details, **shares}
        ),
    )
