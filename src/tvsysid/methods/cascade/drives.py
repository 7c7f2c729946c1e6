"""Find the signal that drives a reflex: a rectified velocity, or a polynomial of the velocity."""

from __future__ import annotations

from typing import NamedTuple, Self

import attrs
import numpy as np

from tvsysid.methods.cascade.pathways import (
    DIRECTIONS,
    Drive,
    rectified_velocities,
    velocity_of,
)
from tvsysid.numerics.bases import chebyshev_of
from tvsysid.numerics.stretch import decimated
from tvsysid.signals import Array, Ensemble

CURVE_POINTS = 101  # velocities at which the curve of a polynomial is given


@attrs.frozen
class VelocityPolynomial:
    """Polynomial of the total angle's velocity, which is 0 where the velocity is.

    ``coefficients`` are those of Chebyshev polynomials from degree 1 on. ``limits`` in rad/s are
    mapped to -1 and 1; beyond them the polynomial keeps its value.
    """

    coefficients: tuple[float, ...]
    limits: tuple[float, float]

    @classmethod
    def of(cls, ensemble: Ensemble, coefficients: Array) -> Self:
        """Return a polynomial whose limits are those of an ensemble's velocity."""
        velocity, _ = velocity_of(ensemble)
        return cls(tuple(coefficients.tolist()), (float(velocity.min()), float(velocity.max())))

    def __call__(self, ensemble: Ensemble) -> Array:
        """Return the polynomial at the recorded rate, decimated as the torque was."""
        velocity, ratio = velocity_of(ensemble)
        return decimated(self.value(velocity), ratio)

    def value(self, velocity: Array) -> Array:
        """Return the polynomial at a velocity in rad/s, of any shape."""
        count = len(self.coefficients) + 1
        at_rest = chebyshev_of(np.zeros(1), self.limits, count)
        terms = chebyshev_of(velocity, self.limits, count) - at_rest
        return np.asarray(terms[..., 1:] @ np.array(self.coefficients))

    def curve(self) -> tuple[Array, Array]:
        """Return velocities in rad/s within the limits, and the polynomial at each."""
        velocity = np.linspace(*self.limits, CURVE_POINTS)
        return velocity, self.value(velocity)


def velocity_terms(ensemble: Ensemble, degree: int) -> Array:
    """Return the terms (degree, realization, time) of a polynomial of the velocity, decimated."""
    return np.stack([VelocityPolynomial.of(ensemble, unit)(ensemble) for unit in np.eye(degree)])


def of_unit_slope(ensemble: Ensemble, weights: Array) -> tuple[VelocityPolynomial, float, int]:
    """Return a polynomial of these weights divided by its slope for stretch.

    Return also the slope, and the direction of stretch, which is the steeper one. The slopes are
    those of a least-squares fit with an offset and a slope for either direction, as a polynomial
    rounds the corner of a rectifier.
    """
    target = VelocityPolynomial.of(ensemble, weights)(ensemble).ravel()
    columns = rectified_velocities(ensemble).reshape(2, -1).T
    centred = columns - columns.mean(axis=0)
    slopes = np.linalg.lstsq(centred, target - target.mean(), rcond=None)[0]
    steeper = int(np.argmax(np.abs(slopes)))
    slope = float(slopes[steeper])
    return VelocityPolynomial.of(ensemble, weights / slope), slope, DIRECTIONS[steeper]


class Candidate(NamedTuple):
    """Signals (signal, realization, context + time + context) whose weighted sum drives a reflex.

    ``start`` are the initial weights. The single signal of a ``drive`` needs no weights; others
    are the terms of a polynomial of the velocity.
    """

    signals: Array
    start: Array
    drive: Drive | None = None

    @classmethod
    def of(cls, ensemble: Ensemble, drive: Drive) -> Self:
        """Return the candidate of a drive."""
        return cls(drive(ensemble)[None], np.ones(1), drive)

    def as_polynomial(self, terms: Array) -> Candidate:
        """Return a polynomial of the velocity that begins as the least-squares fit to a drive."""
        columns = terms.reshape(len(terms), -1).T
        start = np.linalg.lstsq(columns, self.signals.ravel(), rcond=None)[0]
        return Candidate(terms, np.asarray(start))

    def scaled(self, ensemble: Ensemble, weights: Array) -> tuple[Drive, float, int]:
        """Return the drive of unit slope, its slope before, and its direction (0 of EMG)."""
        if self.drive is None:
            return of_unit_slope(ensemble, weights)
        return self.drive, 1.0, getattr(self.drive, "direction", 0)
