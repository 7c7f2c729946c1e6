"""Fit both pathways in one regression. Gauss-Newton steps find the shape of the reflex."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property

import attrs
import numpy as np

from tvsysid.methods.cascade.data import ALL, Data, Factor, Reflex
from tvsysid.methods.cascade.evidence import UNLIMITED, Prior, Ridge
from tvsysid.methods.cascade.reflex_test import predicts_better
from tvsysid.methods.cascade.shape import Shape, Terms
from tvsysid.numerics import Array
from tvsysid.numerics.gaussian import Moments, solve

MAX_STEPS, MAX_HALVINGS, ROUNDS = 8, 6, 2
SMALLEST_STEP = 0.02  # in standard deviations of the prior


@attrs.frozen(eq=False)
class Problem:
    """Data, the reflex (none in a plain model), and which numbers of its shape are ``free``.

    The products of the coefficients with each row of ``positive`` (row, column) are not negative.
    """

    data: Data
    reflex: Reflex | None = None
    free: tuple[str, ...] = ()
    positive: Array = attrs.field(factory=lambda: UNLIMITED)

    @cached_property
    def prior(self) -> Prior:
        """Return the prior. Signals beyond the acceleration share one size."""
        harmonics = [functions.shape[1] // 2 for functions in self.data.bases]
        gain = None if self.reflex is None else self.reflex.basis.harmonics
        return Prior.of(harmonics[:3], len(harmonics[3:]), gain)

    @property
    def own(self) -> int:
        """Return the number of intrinsic columns."""
        return sum(functions.shape[1] for functions in self.data.bases)

    def moments(self, shape: Shape, fold: int | None = None) -> Moments:
        """Return the weighted moments of all columns, of a fold of the realizations or of all."""
        data = self.data
        moments = data.moments if fold is None else data.fold_moments[fold]
        rows = ALL if fold is None else data.folds[fold]
        if self.reflex is None:
            return moments
        return data.append(moments, data.factors, [self.reflex.factor(shape)], rows)

    def at(self, shape: Shape, parameters: Array | None = None) -> Solution:
        """Return the solution for a shape; hyperparameters that are not given are tuned."""
        moments = self.moments(shape)
        if parameters is None:
            parameters = self.prior.tuned(moments, self.prior.usual)
        return self.solution(shape, moments, parameters)

    def solution(self, shape: Shape, moments: Moments, parameters: Array) -> Solution:
        """Return the solution for a shape, the moments of its columns and hyperparameters."""
        spread = self.prior.spread(parameters) / self.prior.scale(moments)
        ridge = Ridge.of(moments, spread, self.positive)
        prior = shape.log_prior(self.free) + self.prior.log_density(parameters)[0]
        return Solution(self, shape, parameters, moments, ridge, ridge.log_evidence + prior)

    def torques(self, shape: Shape, coefficients: Array) -> tuple[Array, Array]:
        """Return intrinsic and reflex torque (realization, time), less their means."""
        intrinsic = self.data.intrinsic(coefficients[: self.own])
        if self.reflex is None:
            return intrinsic, np.zeros_like(intrinsic)
        return intrinsic, self.reflex.torque(shape, coefficients[self.own :])

    def refined(self, shape: Shape) -> Solution:
        """Return the solution from an initial shape, with hyperparameters and shape in turn."""
        found = self.at(shape)
        for _ in range(ROUNDS if self.free else 0):
            found = found.improved()
            parameters = self.prior.tuned(found.moments, found.parameters)
            found = self.solution(found.shape, found.moments, parameters)
        return found

    def started(self, shapes: Iterable[Shape]) -> Solution:
        """Improve the best solution for some initial shapes."""
        found = [self.at(shape, self.prior.usual) for shape in shapes]
        return max(found, key=lambda each: each.objective).improved()


@attrs.frozen(eq=False)
class Solution:
    """Posterior of the coefficients for a shape and hyperparameters ``parameters``.

    The ``objective`` is the log evidence with the log densities of shape and hyperparameters.
    """

    problem: Problem
    shape: Shape
    parameters: Array
    moments: Moments
    ridge: Ridge
    objective: float

    @property
    def coefficients(self) -> Array:
        """Return the coefficients of intrinsic columns and reflex."""
        return self.ridge.coefficients

    def torques(self) -> tuple[Array, Array]:
        """Return intrinsic and reflex torque (realization, time), less their means."""
        return self.problem.torques(self.shape, self.coefficients)

    @property
    def left(self) -> Array:
        """Return the residual torque (realization, time)."""
        return np.asarray(self.problem.data.torque - np.sum(self.torques(), axis=0))

    @cached_property
    def held_out(self) -> Array:
        """Return the residual torque (realization, time) of coefficients of the other folds.

        NaN if there is a single fold.
        """
        problem, data = self.problem, self.problem.data
        left = np.full_like(data.torque, np.nan)
        for fold, rows in enumerate(data.folds if len(data.folds) > 1 else []):
            others = self.moments.without(problem.moments(self.shape, fold))
            ridge = Ridge.of(others, self.ridge.spread, problem.positive)
            torques = problem.torques(self.shape, ridge.coefficients)
            left[rows] = (data.torque - np.sum(torques, axis=0))[rows]
        return left

    def share(self) -> float:
        """Return the share of the held-out torque's square that the solution predicts."""
        torque = self.problem.data.torque
        return 1 - float(np.sum(self.held_out**2)) / float(np.sum(torque**2))

    def better_than(self, other: Solution) -> float:
        """Return the probability that this solution predicts so much better by chance."""
        data = self.problem.data
        return predicts_better(data.squares(self.held_out), data.squares(other.held_out))[0]

    def slopes(self) -> Array:
        """Return the derivatives (number, realization, time) of the reflex torque by its shape."""
        reflex, free = self.problem.reflex, self.problem.free
        out = np.zeros((len(free), *self.problem.data.torque.shape))
        if reflex is None:
            return out
        coefficients, position = self.coefficients[self.problem.own :], self.shape.position(free)
        for index, step in enumerate(np.diag(Terms.of(free).step)):
            ends = [self.shape.at(free, position + way * step) for way in (-1, 1)]
            width = ends[1].position(free)[index] - ends[0].position(free)[index]
            earlier, later = (reflex.torque(end, coefficients) for end in ends)
            out[index] = (later - earlier) / width
        return out

    def columns_and_slopes(self) -> Array:
        """Return columns of the reflex, and the torque's derivatives by its shape."""
        assert self.problem.reflex is not None
        return np.concatenate([self.problem.reflex.columns(self.shape), self.slopes()])

    def moments_with_slopes(self, data: Data, moments: Moments) -> Moments:
        """Append the torque's derivatives by the shape to moments of all columns."""
        reflex, slopes = self.problem.reflex, [Factor.column(each) for each in self.slopes()]
        if reflex is None or not slopes:
            return moments
        return data.append(moments, [*data.factors, reflex.factor(self.shape)], slopes)

    def precision(self) -> Array:
        """Return the prior precision of coefficients and shape, times the noise variance."""
        shape = self.ridge.noise_variance / Terms.of(self.problem.free).spread ** 2
        return np.concatenate([self.ridge.spread**-2, shape])

    def step(self) -> Array:
        """Return a Gauss-Newton step of the free numbers, solved for with all coefficients."""
        free = self.problem.free
        moments = self.moments_with_slopes(self.problem.data, self.moments)
        away = np.zeros(len(moments.cross))
        away[-len(free) :] = Terms.of(free).mean - self.shape.position(free)
        shifted = moments._replace(cross=moments.cross - moments.gram @ away)
        return (solve(shifted, self.precision()).mean + away)[-len(free) :]

    def improved(self) -> Solution:
        """Return the solution after some steps, each halved until it is better."""
        found, free = self, self.problem.free
        for _ in range(MAX_STEPS if free else 0):
            step = found.step()
            if np.max(np.abs(step) / Terms.of(free).spread) < SMALLEST_STEP:
                break
            position = found.shape.position(free)
            tried = (
                self.problem.at(found.shape.at(free, position + step / 2**n), found.parameters)
                for n in range(MAX_HALVINGS)
            )
            better = next((each for each in tried if each.objective > found.objective), None)
            if better is None:
                break
            found = better
        return found
