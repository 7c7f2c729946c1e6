"""The reflex's shape (delay, frequency and damping of the muscle, threshold): found by Gauss-Newton steps."""

from __future__ import annotations

import math
from typing import NamedTuple, Self

import attrs
import numpy as np

from tvsysid.methods.cascade.evidence import UNLIMITED, Family, Moments, Prior, Solved, solve, tuned
from tvsysid.methods.cascade.regressors import Data, Reflex, Shape
from tvsysid.numerics import Array

STEPS, HALVINGS, ROUNDS = 8, 6, 2
SETTLED = 0.02  # step in standard deviations below which nothing more is gained
FREQUENCIES, THRESHOLDS = (9.0, 16.0, 26.0), (0.0, 0.15, 0.5)  # to begin with, in rad/s
DELAYS = (0.04, 0.05, 0.06)  # to begin with where the delay is free, in s


class Term(NamedTuple):
    """One number of the shape: mean and standard deviation of its prior, its bounds, and a step for differences.

    Frequency and damping count by their logarithms.
    """

    mean: float
    spread: float
    low: float
    high: float
    step: float


TERMS = {
    "frequency": Term(math.log(16), 0.6, math.log(3), math.log(60), 1e-3),
    "damping": Term(math.log(0.8), 0.5, math.log(0.2), math.log(3), 1e-3),
    "threshold": Term(0.0, 0.3, 0.0, 2.0, 0.02),
    "delay": Term(0.045, 0.010, 0.035, 0.075, 1e-4),
}
LOGARITHMIC = ("frequency", "damping")


def place_of(shape: Shape, free: tuple[str, ...]) -> Array:
    """Numbers that are free, as they count."""
    values = (getattr(shape, name) for name in free)
    return np.array(
        [math.log(v) if name in LOGARITHMIC else v for name, v in zip(free, values, strict=True)]
    )


def moved(shape: Shape, free: tuple[str, ...], place: Array) -> Shape:
    """Shape with these numbers, kept within their bounds."""
    changes = {}
    for name, value in zip(free, place, strict=True):
        inside = min(max(float(value), TERMS[name].low), TERMS[name].high)
        changes[name] = math.exp(inside) if name in LOGARITHMIC else inside
    return shape._replace(**changes)


def log_prior(shape: Shape, free: tuple[str, ...]) -> float:
    """Log density of a shape, up to a constant."""
    place = zip(place_of(shape, free), (TERMS[name] for name in free), strict=True)
    return -0.5 * float(sum(((value - term.mean) / term.spread) ** 2 for value, term in place))


class Found(NamedTuple):
    """A solution for a shape: moments and coefficients of the columns, divided by their ``scale``."""

    shape: Shape
    parameters: Array
    moments: Moments
    scale: Array
    spread: Array
    solved: Solved
    objective: float

    @property
    def coefficients(self) -> Array:
        """Of the columns as they are."""
        return self.solved.coefficients / self.scale


@attrs.frozen(eq=False)
class Problem:
    """Data, what else drives the torque (nothing, in a plain model), which numbers of its shape are ``free``.

    The products of the coefficients with each row of ``positive`` (row, column) are not negative.
    """

    data: Data
    families: tuple[Family, ...]
    prior: Prior
    reflex: Reflex | None = None
    free: tuple[str, ...] = ()
    positive: Array = attrs.field(factory=lambda: UNLIMITED)

    @classmethod
    def of(cls, data: Data, reflex: Reflex | None, free: tuple[str, ...]) -> Self:
        """Of data and a reflex.

        Each signal is a family, but those beyond the acceleration are one together.
        """
        families = [Family(basis.shape[1] // 2) for basis in data.bases[:3]]
        if len(data.bases) > 3:
            families.append(Family(several=len(data.bases) - 3))
        if reflex is not None:
            families.append(Family(reflex.basis.harmonics, free=False))
        return cls(data, tuple(families), Prior.of(tuple(families)), reflex, free)

    def with_data(self, data: Data) -> Self:
        """Problem whose samples are weighed in another way."""
        return attrs.evolve(
            self, data=data, reflex=self.reflex and attrs.evolve(self.reflex, data=data)
        )

    @property
    def own(self) -> int:
        """How many columns are intrinsic."""
        return sum(functions.shape[1] for functions in self.data.bases)

    def columns_and_slopes(self, found: Found) -> Array:
        """Columns of the reflex, and the torque's derivatives by its shape."""
        assert self.reflex is not None
        return np.concatenate([self.reflex.columns(found.shape), self.slopes(found)])

    def moments(self, shape: Shape, fold: int | None = None) -> Moments:
        """Moments of all columns, of a fold of the realizations or all."""
        products = self.data.own.sum(axis=0) if fold is None else self.data.own[fold]
        if self.reflex is not None:
            gram, cross = self.reflex.moments(shape, fold)
            products = np.block(
                [
                    [products[:-1, :-1], cross[:-1], products[:-1, -1:]],
                    [cross[:-1].T, gram, cross[-1:].T],
                    [products[-1:, :-1], cross[-1:], products[-1:, -1:]],
                ]
            )
        share = 1.0 if fold is None else len(self.data.folds[fold]) / len(self.data.torque)
        return Moments.of(products, share * self.data.number)

    def moments_and_slopes(self, found: Found, moments: Moments) -> tuple[Array, Array]:
        """Weighted products of all columns and of the torque's derivatives by the shape, and with the torque."""
        slopes = self.slopes(found)
        if not len(slopes):
            return moments.gram, moments.cross
        assert self.reflex is not None
        white = self.data.whitened(slopes)
        cross = self.data.cross(white)
        mixed = (
            np.concatenate([cross[:-1], self.reflex.with_signals(found.shape, white).T])
            / found.scale[:, None]
        )
        own = np.tensordot(white, slopes, axes=((1, 2), (1, 2)))
        gram = np.block([[moments.gram, mixed], [mixed.T, own]])
        return gram, np.concatenate([moments.cross, cross[-1]])

    def scale(self, moments: Moments) -> Array:
        """Root mean square of each family's column that is not modulated."""
        rms, at = np.sqrt(np.maximum(np.diag(moments.gram), 0.0) / moments.number), 0
        for family in self.families:
            if not family.several:
                rms[at : at + family.columns] = rms[at]
            at += family.columns
        return np.where(rms > 0, rms, 1.0)

    def at(self, shape: Shape, parameters: Array | None = None) -> Found:
        """Solution for a shape; hyper-parameters not given are tuned."""
        moments = self.moments(shape)
        scale = self.scale(moments)
        moments = moments.scaled(scale)
        return self.solved(shape, moments, scale, parameters)

    def solved(
        self, shape: Shape, moments: Moments, scale: Array, parameters: Array | None
    ) -> Found:
        """Solution from moments of the scaled columns."""
        if parameters is None:
            parameters = tuned(moments, self.prior, self.prior.usual)
        spread = self.prior.spread(parameters)
        solved = solve(moments, spread, self.positive / scale)
        own = log_prior(shape, self.free) + self.prior.log_density(parameters)[0]
        return Found(shape, parameters, moments, scale, spread, solved, solved.log_evidence + own)

    def retuned(self, found: Found) -> Found:
        """Solution for the same shape, with hyper-parameters tuned anew."""
        parameters = tuned(found.moments, self.prior, found.parameters)
        return self.solved(found.shape, found.moments, found.scale, parameters)

    def torques(self, shape: Shape, coefficients: Array) -> tuple[Array, Array]:
        """Intrinsic and reflex torque (realization, time), as deviations from their means."""
        intrinsic = self.data.torque_of(coefficients[: self.own])
        if self.reflex is None:
            return intrinsic, np.zeros_like(intrinsic)
        return intrinsic, self.reflex.torque(shape, coefficients[self.own :])

    def left(self, found: Found) -> Array:
        """Torque (realization, time) that a solution leaves."""
        return np.asarray(
            self.data.torque - np.sum(self.torques(found.shape, found.coefficients), axis=0)
        )

    def slopes(self, found: Found) -> Array:
        """Derivatives of the reflex torque by the free numbers of its shape, (number, realization, time)."""
        out = np.zeros((len(self.free), *self.data.torque.shape))
        if self.reflex is None:
            return out
        coefficients = found.coefficients[self.own :]
        place = place_of(found.shape, self.free)
        for index, name in enumerate(self.free):
            ends = [place.copy(), place.copy()]
            ends[0][index] -= TERMS[name].step
            ends[1][index] += TERMS[name].step
            shapes = [moved(found.shape, self.free, end) for end in ends]
            width = np.diff([place_of(shape, self.free)[index] for shape in shapes])
            later, earlier = (self.reflex.torque(shape, coefficients) for shape in shapes[::-1])
            out[index] = (later - earlier) / width
        return out

    def step(self, found: Found) -> Array:
        """Gauss-Newton step of the free numbers: all coefficients and it are solved for together."""
        terms, count = [TERMS[name] for name in self.free], len(found.scale)
        gram, cross = self.moments_and_slopes(found, found.moments)
        weight = found.solved.noise_variance / np.array([term.spread for term in terms]) ** 2
        system = gram + np.diag(np.concatenate([1 / found.spread**2, weight]))
        away = np.array([term.mean for term in terms]) - place_of(found.shape, self.free)
        right = cross + np.concatenate([np.zeros(count), weight * away])
        return np.asarray(np.linalg.solve(system, right)[count:])

    def improved(self, found: Found) -> Found:
        """Solution after some steps, each halved until it is better."""
        for _ in range(STEPS if self.free else 0):
            step = self.step(found)
            sizes = np.abs(step) / [TERMS[name].spread for name in self.free]
            if sizes.max() < SETTLED:
                break
            place, better = place_of(found.shape, self.free), None
            for halving in range(HALVINGS):
                tried = self.at(
                    moved(found.shape, self.free, place + step / 2**halving), found.parameters
                )
                if tried.objective > found.objective:
                    better = tried
                    break
            if better is None:
                break
            found = better
        return found

    def refined(self, shape: Shape) -> Found:
        """Solution from a shape on: hyper-parameters and shape in turn."""
        found = self.at(shape)
        for _ in range(ROUNDS if self.free else 0):
            found = self.retuned(self.improved(found))
        return found

    def started(self, shapes: tuple[Shape, ...]) -> Found:
        """Best solution for some shapes, refined."""
        usual = self.prior.usual
        best = max((self.at(shape, usual) for shape in shapes), key=lambda found: found.objective)
        return self.improved(best)


def first_shapes(delay: float | None, free: tuple[str, ...]) -> tuple[Shape, ...]:
    """Shapes to begin with; a delay of None is free."""
    thresholds = THRESHOLDS if "threshold" in free else (0.0,)
    delays = DELAYS if delay is None else (delay,)
    return tuple(Shape(d, w, 0.8, c) for d in delays for w in FREQUENCIES for c in thresholds)


def held_out(problem: Problem, found: Found) -> Array:
    """Torque (realization, time) that is left by what was fitted to the other folds.

    NaN of a single fold.
    """
    data, limits = problem.data, problem.positive / found.scale
    left = np.full_like(data.torque, np.nan)
    for fold, rows in enumerate(data.folds if len(data.folds) > 1 else []):
        others = found.moments.without(problem.moments(found.shape, fold).scaled(found.scale))
        coefficients = solve(others, found.spread, limits).coefficients / found.scale
        left[rows] = (data.torque - np.sum(problem.torques(found.shape, coefficients), axis=0))[
            rows
        ]
    return left
