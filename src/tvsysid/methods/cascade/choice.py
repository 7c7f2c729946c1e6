"""Which pathways there are, and whether they change over a realization: by what predicts realizations not fitted to."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from typing import NamedTuple, Self

import attrs
import numpy as np
from scipy.linalg import block_diag

from tvsysid.methods.cascade.reflex_test import MIN_TESTED_REALIZATIONS, predicts_better
from tvsysid.methods.cascade.regressors import Data, Reflex, Shape, readout
from tvsysid.methods.cascade.shape import Found, Problem, first_shapes, held_out
from tvsysid.numerics import Array
from tvsysid.numerics.bases import FourierSeries
from tvsysid.numerics.noise import autocorrelation
from tvsysid.signals import Ensemble

SETTLED = 0.45  # seconds of what drives a reflex that must be known before a sample that is fitted
HISTORY = 0.75  # seconds of it that are used where they were recorded
USUAL = (16.0, 0.8, 0.0)  # frequency in rad/s, damping and threshold of a reflex that is not shown
LIMITED = 500  # times of a period at which signs are limited, or somewhat more
CERTAIN = (
    10.0  # log evidence by which a reflex must be better than none, and than the rest, to be shown
)
MISFIT = 0.02  # share of the squares left by which whitening may make them larger
PLAIN = 30.0  # floor of the noise, in shares of its power, where whitening is not right
LIKELY = 0.05  # probability below which what changes is taken to do so, and a threshold to be one

DIRECTIONS = {"positive": 1, "negative": -1}

Drives = Mapping[
    str, Callable[[float], Array]
]  # by threshold, deviations (realization, history + time)


@attrs.frozen(eq=False)
class Candidate:
    """A solution."""

    problem: Problem
    found: Found

    @cached_property
    def left(self) -> Array:
        """Torque (realization, time) that is left where it was not fitted to."""
        return held_out(self.problem, self.found)

    def share(self) -> float:
        """Of the torque's square, what is predicted where it was not fitted to."""
        return 1 - float(np.sum(self.left**2)) / float(np.sum(self.problem.data.torque**2))

    def better_than(self, other: Candidate) -> float:
        """Probability that this one predicts so much better by chance."""
        squares = (
            np.sum(self.problem.data.whitened(each.left) * each.left, axis=1)
            for each in (self, other)
        )
        return predicts_better(*squares)[0]


class Hyperparameters(NamedTuple):
    """Everything of a solution with a reflex of some name but its coefficients."""

    reflex: str
    varies: bool
    noise: Array
    shape: Shape
    parameters: Array

    @classmethod
    def of(cls, reflex: str, fit: Candidate) -> Self:
        """Return those of a solution."""
        data, found = fit.problem.data, fit.found
        return cls(reflex, data.varies, data.noise, found.shape, found.parameters)


class Search(NamedTuple):
    """Data, and what may drive a reflex, by name; which numbers of its shape are ``free``.

    A ``delay`` of None is.

    ``harmonics`` are the gain's, ``lags`` the intrinsic response's to either side, in samples.
    """

    ensemble: Ensemble
    data: Data
    lags: int
    drives: Drives
    harmonics: int
    period: float
    delay: float | None
    free: Mapping[str, tuple[str, ...]]

    def problem(self, name: str, data: Data, free: tuple[str, ...] | None = None) -> Problem:
        """With a reflex of this name, or plain where it is "none".

        The gain changes if the stiffness does.
        """
        if name == "none":
            return Problem.of(data, None, ())
        basis = FourierSeries(self.harmonics if data.varies else 0)
        reflex = Reflex(self.drives[name], basis, self.period, self.ensemble.sampling_rate, data)
        return Problem.of(data, reflex, self.free[name] if free is None else free)

    def fits(self, constant: bool | None, names: Iterable[str]) -> dict[str, Candidate]:
        """Solution with each of some reflexes, or without one ("none").

        None chooses whether they are constant.
        """
        still = self.data.constant()
        first = {name: first_shapes(self.delay, self.free.get(name, ())) for name in names}
        begun = {name: self.problem(name, still).started(each) for name, each in first.items()}
        shapes = {name: each.shape for name, each in begun.items()}
        varying = self.data.varies and not constant
        data = self.data if varying else still
        likely = max(begun, key=lambda name: begun[name].objective + CERTAIN * (name == "none"))
        problem = self.problem(likely, data)
        left = problem.left(problem.at(shapes[likely]))
        weighed = data.weighed(autocorrelation(left))
        found = self._solved(weighed, shapes)
        if varying and constant is None:
            unchanging = self._solved(weighed.constant(), shapes)
            found, data = (found, data) if _better(found, unchanging) else (unchanging, still)
        if len(data.torque) < MIN_TESTED_REALIZATIONS:
            return found
        best = _best(found)
        data = data.weighed(autocorrelation(left, PLAIN))
        plain = best.problem.with_data(data)
        alike = Candidate(plain, plain.at(best.found.shape, best.found.parameters))
        return (
            self._solved(data, shapes)
            if alike.share() - best.share() > MISFIT * (1 - alike.share())
            else found
        )

    def _solved(self, data: Data, shapes: Mapping[str, Shape]) -> dict[str, Candidate]:
        problems = {name: self.problem(name, data) for name in shapes}
        return {
            name: Candidate(problem, problem.at(shapes[name])) for name, problem in problems.items()
        }

    def limited(self, name: str, fit: Candidate) -> Candidate:
        """Solution with the same hyperparameters, whose viscosity and gain are not negative.

        Stiffness, and the gain of EMG, are of either sign, but the same at all times.
        """
        old, data, reflex = fit.found, fit.problem.data, fit.problem.reflex
        weights = readout(self.lags, self.ensemble.sampling_rate)[:2]
        weights[0] = 0.0
        weights[0, 0] = np.sign(old.coefficients[0])
        repeated = math.ceil(self.period * self.ensemble.sampling_rate)
        some = slice(0, repeated, max(1, repeated // LIMITED))
        rows = np.concatenate([each[some] for each in data.features(weights)])
        gains = [] if reflex is None else [reflex.basis(self.ensemble.time[some] / self.period)]
        problems = [
            attrs.evolve(fit.problem, positive=block_diag(rows, *(sign * gain for gain in gains)))
            for sign in ((1, -1) if name == "emg" else (1,))
        ]
        both = [
            Candidate(each, each.solved(old.shape, old.moments, old.scale, old.parameters))
            for each in problems
        ]
        return min(both, key=lambda each: each.found.solved.lost)

    def refitted(self, known: Hyperparameters) -> Candidate:
        """Return the solution with these hyperparameters."""
        data = self.data if known.varies else self.data.constant()
        problem = self.problem(known.reflex, data.weighed(known.noise), free=())
        return Candidate(problem, problem.at(known.shape, known.parameters))

    def refined(self, name: str, fits: Mapping[str, Candidate]) -> Candidate:
        """Best solution with a reflex; without a threshold unless it predicts better with one.

        The threshold stays among the free numbers: bands count that it is not known.
        """
        problem = fits[name].problem
        found = problem.refined(fits[name].found.shape)
        best = Candidate(problem, found)
        if "threshold" not in problem.free or found.shape.threshold == 0:
            return best
        others = tuple(each for each in problem.free if each != "threshold")
        without = attrs.evolve(problem, free=others).refined(found.shape._replace(threshold=0.0))
        simple = Candidate(problem, without)
        return best if _better({name: best}, {name: simple}) else simple

    def unshown(self, name: str, fits: Mapping[str, Candidate]) -> Candidate:
        """Solution with a reflex that nothing shows: it has the usual shape, and no threshold."""
        usual = Shape(fits[name].found.shape.delay, *USUAL)
        problem = self.problem(name, fits[name].problem.data, free=())
        return Candidate(problem, problem.at(usual))


def by_evidence(fits: Mapping[str, Candidate]) -> tuple[str, bool]:
    """Reflex of most evidence, and whether it has clearly more than no reflex, a linear late answer, or another one."""
    evidence = {name: fit.found.objective for name, fit in fits.items()}
    best = max(evidence.keys() - {"none", "linear"}, key=lambda name: evidence[name])
    return best, all(
        evidence[best] - other > CERTAIN for name, other in evidence.items() if name != best
    )


def _best(fits: Mapping[str, Candidate]) -> Candidate:
    return max(fits.values(), key=lambda fit: fit.found.objective)


def _better(one: Mapping[str, Candidate], other: Mapping[str, Candidate]) -> bool:
    """Whether the best of some candidates predicts better than the best of others.

    Of few, if it has more evidence.
    """
    best, rest = _best(one), _best(other)
    if len(best.problem.data.torque) < MIN_TESTED_REALIZATIONS:
        return best.found.objective > rest.found.objective
    return best.better_than(rest) < LIKELY
