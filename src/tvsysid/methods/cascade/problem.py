"""Fit both pathways in one regression. Gauss-Newton steps find the shape of the reflex."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from typing import Self

import attrs
import numpy as np

from tvsysid.methods.cascade.evidence import UNLIMITED, Moments, Posterior, Prior, solve, tuned
from tvsysid.methods.cascade.reflex_test import predicts_better
from tvsysid.methods.cascade.regressors import Data, Reflex
from tvsysid.methods.cascade.shape import TERMS, Shape
from tvsysid.numerics import Array

STEPS, HALVINGS, ROUNDS = 8, 6, 2
SETTLED = 0.02  # step in standard deviations below which nothing more is gained


@attrs.frozen(eq=False)
class Problem:
    """Data, the reflex (none in a plain model), and which numbers of its shape are ``free``.

    The products of the coefficients with each row of ``positive`` (row, column) are not negative.
    """

    data: Data
    prior: Prior
    reflex: Reflex | None = None
    free: tuple[str, ...] = ()
    positive: Array = attrs.field(factory=lambda: UNLIMITED)

    @classmethod
    def of(cls, data: Data, reflex: Reflex | None, free: tuple[str, ...]) -> Self:
        """Return the problem of data and a reflex.

        Signals beyond the acceleration have a prior in common.
        """
        harmonics = [functions.shape[1] // 2 for functions in data.bases]
        gain = None if reflex is None else reflex.basis.harmonics
        return cls(data, Prior.of(harmonics[:3], len(harmonics[3:]), gain), reflex, free)

    def with_data(self, data: Data) -> Self:
        """Return the same problem with other data, such as other weights of the samples."""
        reflex = self.reflex and attrs.evolve(self.reflex, data=data)
        return attrs.evolve(self, data=data, reflex=reflex)

    @property
    def own(self) -> int:
        """Return the number of intrinsic columns."""
        return sum(functions.shape[1] for functions in self.data.bases)

    def moments(self, shape: Shape, fold: int | None = None) -> Moments:
        """Return the moments of all columns, of a fold of the realizations or of all."""
        products = self.data.own.sum(axis=0) if fold is None else self.data.own[fold]
        if self.reflex is not None:
            gram, cross = self.reflex.moments(shape, fold)
            products = np.block([[products, cross], [cross.T, gram]])
            order = np.r_[: self.own, self.own + 1 : len(products), self.own]  # the torque is last
            products = products[np.ix_(order, order)]
        share = 1.0 if fold is None else len(self.data.folds[fold]) / len(self.data.torque)
        return Moments(products, share * self.data.number)

    def at(self, shape: Shape, parameters: Array | None = None) -> Solution:
        """Return the solution for a shape; hyperparameters that are not given are tuned."""
        moments = self.moments(shape)
        rms = np.sqrt(np.maximum(np.diag(moments.gram), 0.0) / moments.number)[self.prior.first]
        scale = np.where(rms > 0, rms, 1.0)
        return self.solution(shape, moments.scaled(scale), scale, parameters)

    def solution(
        self, shape: Shape, moments: Moments, scale: Array, parameters: Array | None
    ) -> Solution:
        """Return the solution from moments of the scaled columns."""
        if parameters is None:
            parameters = tuned(moments, self.prior, self.prior.usual)
        spread = self.prior.spread(parameters)
        posterior = solve(moments, spread, self.positive / scale)
        prior = shape.log_prior(self.free) + self.prior.log_density(parameters)[0]
        objective = posterior.log_evidence + prior
        return Solution(self, shape, parameters, moments, scale, spread, posterior, objective)

    def torques(self, shape: Shape, coefficients: Array) -> tuple[Array, Array]:
        """Return intrinsic and reflex torque (realization, time), less their means."""
        intrinsic = self.data.torque_of(coefficients[: self.own])
        if self.reflex is None:
            return intrinsic, np.zeros_like(intrinsic)
        return intrinsic, self.reflex.torque(shape, coefficients[self.own :])

    def refined(self, shape: Shape) -> Solution:
        """Return the solution from an initial shape, with hyperparameters and shape in turn."""
        found = self.at(shape)
        for _ in range(ROUNDS if self.free else 0):
            found = found.improved().retuned()
        return found

    def started(self, shapes: Iterable[Shape]) -> Solution:
        """Improve the best solution for some initial shapes."""
        found = [self.at(shape, self.prior.usual) for shape in shapes]
        return max(found, key=lambda each: each.objective).improved()


@attrs.frozen(eq=False)
class Solution:
    """Posterior of the coefficients of columns, which are divided by their ``scale``.

    The ``objective`` is the log evidence with the log densities of shape and hyperparameters,
    ``parameters``.
    """

    problem: Problem
    shape: Shape
    parameters: Array
    moments: Moments
    scale: Array
    spread: Array
    posterior: Posterior
    objective: float

    @property
    def coefficients(self) -> Array:
        """Return the coefficients of the unscaled columns."""
        return self.posterior.coefficients / self.scale

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
            own = problem.moments(self.shape, fold).scaled(self.scale)
            posterior = solve(self.moments.without(own), self.spread, problem.positive / self.scale)
            torques = problem.torques(self.shape, posterior.coefficients / self.scale)
            left[rows] = (data.torque - np.sum(torques, axis=0))[rows]
        return left

    def share(self) -> float:
        """Return the share of the held-out torque's square that the solution predicts."""
        torque = self.problem.data.torque
        return 1 - float(np.sum(self.held_out**2)) / float(np.sum(torque**2))

    def better_than(self, other: Solution) -> float:
        """Return the probability that this solution predicts so much better by chance."""
        data = self.problem.data
        squares = (
            np.sum(data.whitened(each.held_out) * each.held_out, axis=1) for each in (self, other)
        )
        return predicts_better(*squares)[0]

    def slopes(self) -> Array:
        """Return the derivatives (number, realization, time) of the reflex torque by its shape."""
        problem, free = self.problem, self.problem.free
        out = np.zeros((len(free), *problem.data.torque.shape))
        if problem.reflex is None:
            return out
        coefficients, place = self.coefficients[problem.own :], self.shape.place(free)
        for index, step in enumerate(np.diag([TERMS[name].step for name in free])):
            ends = [self.shape.at(free, place + way * step) for way in (-1, 1)]
            width = ends[1].place(free)[index] - ends[0].place(free)[index]
            earlier, later = (problem.reflex.torque(end, coefficients) for end in ends)
            out[index] = (later - earlier) / width
        return out

    def columns_and_slopes(self) -> Array:
        """Return columns of the reflex, and the torque's derivatives by its shape."""
        assert self.problem.reflex is not None
        return np.concatenate([self.problem.reflex.columns(self.shape), self.slopes()])

    def products_with_slopes(self, moments: Moments) -> tuple[Array, Array]:
        """Return weighted products of all columns and slopes, and with the torque."""
        slopes, data = self.slopes(), self.problem.data
        if not len(slopes):
            return moments.gram, moments.cross
        assert self.problem.reflex is not None
        white = data.whitened(slopes)
        cross = data.cross(white)
        of_reflex = self.problem.reflex.with_signals(self.shape, white).T
        mixed = np.concatenate([cross[:-1], of_reflex]) / self.scale[:, None]
        own = np.tensordot(white, slopes, axes=((1, 2), (1, 2)))
        gram = np.block([[moments.gram, mixed], [mixed.T, own]])
        return gram, np.concatenate([moments.cross, cross[-1]])

    def precision(self) -> Array:
        """Return the prior precision of coefficients and shape, times the noise variance."""
        spread = np.array([TERMS[name].spread for name in self.problem.free])
        return np.concatenate([1 / self.spread**2, self.posterior.noise_variance / spread**2])

    def step(self) -> Array:
        """Return a Gauss-Newton step of the free numbers, solved for with all coefficients."""
        gram, cross = self.products_with_slopes(self.moments)
        free, precision = self.problem.free, self.precision()
        away = np.array([TERMS[name].mean for name in free]) - self.shape.place(free)
        right = cross + precision * np.pad(away, (len(self.scale), 0))
        return np.asarray(np.linalg.solve(gram + np.diag(precision), right)[len(self.scale) :])

    def improved(self) -> Solution:
        """Return the solution after some steps, each halved until it is better."""
        found, free = self, self.problem.free
        for _ in range(STEPS if free else 0):
            step = found.step()
            if np.max(np.abs(step) / [TERMS[name].spread for name in free]) < SETTLED:
                break
            place = found.shape.place(free)
            tried = (
                self.problem.at(found.shape.at(free, place + step / 2**n), found.parameters)
                for n in range(HALVINGS)
            )
            better = next((each for each in tried if each.objective > found.objective), None)
            if better is None:
                break
            found = better
        return found

    def retuned(self) -> Solution:
        """Return the solution for the same shape, with hyperparameters tuned anew."""
        parameters = tuned(self.moments, self.problem.prior, self.parameters)
        return self.problem.solution(self.shape, self.moments, self.scale, parameters)
