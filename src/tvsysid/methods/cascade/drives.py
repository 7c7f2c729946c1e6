"""Find the signal that drives a reflex: a rectified velocity, or a polynomial of the velocity."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid.methods.cascade.pathways import (
    DIRECTIONS,
    Drive,
    Stretch,
    history,
    rectified_velocities,
    velocity_of,
)
from tvsysid.numerics.bands import mean_known
from tvsysid.numerics.bases import chebyshev_of
from tvsysid.numerics.hammerstein import Cascade, Nonlinearity, Rows, parallel_cascade
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

    def __call__(self, ensemble: Ensemble) -> Array:
        """Return the polynomial at the recorded rate, decimated as the torque was."""
        velocity, ratio = velocity_of(ensemble)
        return decimated(self.value(velocity), ratio)

    def value(self, velocity: Array) -> Array:
        """Return the polynomial at a velocity in rad/s, of any shape."""
        terms = _terms(velocity, self.limits, len(self.coefficients))
        return np.asarray(terms @ np.array(self.coefficients))

    def curve(self) -> tuple[Array, Array]:
        """Return velocities in rad/s within the limits, and the polynomial at each."""
        velocity = np.linspace(*self.limits, CURVE_POINTS)
        return velocity, self.value(velocity)


def _terms(velocity: Array, limits: tuple[float, float], degree: int) -> Array:
    """Return Chebyshev polynomials of degree 1 on, less their values at rest: (..., degree)."""
    at_rest = chebyshev_of(np.zeros(1), limits, degree + 1)
    return (chebyshev_of(velocity, limits, degree + 1) - at_rest)[..., 1:]


def velocity_terms(ensemble: Ensemble, degree: int) -> Array:
    """Return the terms (degree, realization, time) of a polynomial of the velocity, decimated."""
    velocity, ratio = velocity_of(ensemble)
    terms = _terms(velocity, (float(velocity.min()), float(velocity.max())), degree)
    return np.stack([decimated(each, ratio) for each in np.moveaxis(terms, -1, 0)])


def of_unit_slope(ensemble: Ensemble, weights: Array) -> tuple[VelocityPolynomial, float, int]:
    """Return a polynomial of these weights divided by its slope for stretch.

    Return also the slope, and the direction of stretch, which is the steeper one. The slopes are
    those of a least-squares fit with an offset and a slope for either direction, as a polynomial
    rounds the corner of a rectifier.
    """
    velocity, _ = velocity_of(ensemble)
    drive = VelocityPolynomial(tuple(weights), (float(velocity.min()), float(velocity.max())))
    target = drive(ensemble).ravel()
    columns = rectified_velocities(ensemble).reshape(2, -1).T
    centred = columns - columns.mean(axis=0)
    slopes = np.linalg.lstsq(centred, target - target.mean(), rcond=None)[0]
    steeper = int(np.argmax(np.abs(slopes)))
    slope = float(slopes[steeper])
    scaled = attrs.evolve(drive, coefficients=tuple((weights / slope).tolist()))
    return scaled, slope, DIRECTIONS[steeper]


class Candidate(NamedTuple):
    """Signals (signal, realization, context + time + context) whose weighted sum drives a reflex.

    ``start`` are the initial weights. The single signal of a ``drive`` needs no weights; others
    are the terms of a polynomial of the velocity.
    """

    signals: Array
    start: Array
    drive: Drive | None = None

    @classmethod
    def of(cls, ensemble: Ensemble, drive: Drive) -> Candidate:
        """Return the candidate of a drive."""
        return cls(drive(ensemble)[None], np.ones(1), drive)

    @classmethod
    def rectifiers(cls, ensemble: Ensemble) -> list[Candidate]:
        """Return the velocity of stretch, rectified, for either direction."""
        return [cls.of(ensemble, Stretch(direction=direction)) for direction in DIRECTIONS]

    def as_polynomial(self, ensemble: Ensemble, degree: int) -> Candidate:
        """Return a polynomial of the velocity that begins as the least-squares fit to a drive."""
        signals = velocity_terms(ensemble, degree)
        columns = signals.reshape(degree, -1).T
        start = np.linalg.lstsq(columns, self.signals.ravel(), rcond=None)[0]
        return Candidate(signals, np.asarray(start))

    def scaled(self, ensemble: Ensemble, weights: Array) -> tuple[Drive, float, int]:
        """Return the drive of unit slope, its slope before, and its direction (0 of EMG)."""
        if self.drive is None:
            return of_unit_slope(ensemble, weights)
        return self.drive, 1.0, getattr(self.drive, "direction", 0)


def past_of(ensemble: Ensemble, signals: Array, before: int) -> Array:
    """Return signals with their past (signal, realization, before + time).

    Their mean over realizations is subtracted where the ensemble's is.
    """
    past = np.stack([history(ensemble, each, before) for each in signals])
    return (
        np.stack([each - mean_known(each) for each in past]) if ensemble.mean_subtracted else past
    )


def constant_cascade(
    ensemble: Ensemble,
    candidates: Iterable[Candidate],
    lags: int,
    before: int,
    nonlinearity: Nonlinearity = "rectifier",
) -> tuple[Candidate, Cascade]:
    """Return the drive that explains most of the torque of a constant joint, with its fit."""
    fits = []
    for each in candidates:
        rows = _rows(ensemble, each.signals, lags, before)
        fits.append((each, parallel_cascade(rows, lags, each.start, nonlinearity)))
    return max(fits, key=lambda fit: fit[1].explained)


def _rows(ensemble: Ensemble, signals: Array, lags: int, before: int) -> list[Rows]:
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
