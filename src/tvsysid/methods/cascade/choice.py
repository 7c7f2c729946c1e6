"""Choose the pathways, and whether they change over time, by how they predict held-out data."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple, Self

import attrs
import numpy as np
from scipy.linalg import block_diag

from tvsysid.methods.cascade.problem import Problem, Solution
from tvsysid.methods.cascade.reflex_test import MIN_TESTED_REALIZATIONS
from tvsysid.methods.cascade.regressors import Data, Reflex, readout
from tvsysid.methods.cascade.shape import Shape, first_shapes
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


class Hyperparameters(NamedTuple):
    """Settings that determine a solution, except its coefficients."""

    reflex: str
    varies: bool
    noise: Array
    shape: Shape
    parameters: Array

    @classmethod
    def of(cls, reflex: str, found: Solution) -> Self:
        """Return the hyperparameters of a solution with the named reflex."""
        data = found.problem.data
        return cls(reflex, data.varies, data.noise, found.shape, found.parameters)


class Search(NamedTuple):
    """Data, and the signals that may drive a reflex, by name.

    ``free`` names the numbers of the reflex's shape that are fitted. A ``delay`` of None is
    fitted, too. ``harmonics`` is the number of harmonics of the gain. ``lags`` is the number of
    lags of the intrinsic response to either side, in samples.
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
        """Return the problem with the named reflex, or with no reflex if the name is "none".

        The gain changes over time if the stiffness does.
        """
        if name == "none":
            return Problem.of(data, None, ())
        basis = FourierSeries(self.harmonics if data.varies else 0)
        reflex = Reflex(self.drives[name], basis, self.period, self.ensemble.sampling_rate, data)
        return Problem.of(data, reflex, self.free[name] if free is None else free)

    def fits(self, constant: bool | None, names: Iterable[str]) -> dict[str, Solution]:
        """Return the solution for each named reflex; "none" stands for no reflex.

        If ``constant`` is None, the data choose whether the coefficients change over time.
        """
        still = self.data.constant()
        first = {name: first_shapes(self.delay, self.free.get(name, ())) for name in names}
        begun = {name: self.problem(name, still).started(each) for name, each in first.items()}
        shapes = {name: each.shape for name, each in begun.items()}
        varying = self.data.varies and not constant
        data = self.data if varying else still
        likely = max(begun, key=lambda name: begun[name].objective + CERTAIN * (name == "none"))
        left = self.problem(likely, data).at(shapes[likely]).left
        weighed = data.weighed(autocorrelation(left))
        found = self._solved(weighed, shapes)
        if varying and constant is None:
            unchanging = self._solved(weighed.constant(), shapes)
            if not _is_better(_best(found), _best(unchanging)):
                found, data = unchanging, still
        if len(data.torque) < MIN_TESTED_REALIZATIONS:
            return found
        best = _best(found)
        data = data.weighed(autocorrelation(left, PLAIN))
        alike = best.problem.with_data(data).at(best.shape, best.parameters).share()
        is_misfit = alike - best.share() > MISFIT * (1 - alike)
        return self._solved(data, shapes) if is_misfit else found

    def _solved(self, data: Data, shapes: Mapping[str, Shape]) -> dict[str, Solution]:
        return {name: self.problem(name, data).at(shape) for name, shape in shapes.items()}

    def limited(self, name: str, found: Solution) -> Solution:
        """Return the solution with the same hyperparameters, without negative viscosity and gain.

        Stiffness, and the gain of EMG, are of either sign, but the same at all times.
        """
        problem, reflex = found.problem, found.problem.reflex
        weights = readout(self.lags, self.ensemble.sampling_rate)[:2]
        weights[0] = 0.0
        weights[0, 0] = np.sign(found.coefficients[0])
        repeated = math.ceil(self.period * self.ensemble.sampling_rate)
        some = slice(0, repeated, max(1, repeated // LIMITED))
        rows = np.concatenate([each[some] for each in problem.data.features(weights)])
        gains = [] if reflex is None else [reflex.basis(self.ensemble.time[some] / self.period)]
        both = [
            attrs.evolve(
                problem, positive=block_diag(rows, *(sign * gain for gain in gains))
            ).solution(found.shape, found.moments, found.scale, found.parameters)
            for sign in ((1, -1) if name == "emg" else (1,))
        ]
        return min(both, key=lambda each: each.posterior.lost)

    def refitted(self, known: Hyperparameters) -> Solution:
        """Return the solution with these hyperparameters."""
        data = self.data if known.varies else self.data.constant()
        problem = self.problem(known.reflex, data.weighed(known.noise), free=())
        return problem.at(known.shape, known.parameters)

    def refined(self, found: Solution) -> Solution:
        """Return the best solution with a reflex, with a threshold if it predicts better so.

        The threshold stays among the free numbers: bands count that it is not known.
        """
        best = found.problem.refined(found.shape)
        if "threshold" not in best.problem.free or best.shape.threshold == 0:
            return best
        others = tuple(each for each in best.problem.free if each != "threshold")
        without = attrs.evolve(best.problem, free=others)
        simple = without.refined(best.shape._replace(threshold=0.0))
        simple = attrs.evolve(simple, problem=best.problem)
        return best if _is_better(best, simple) else simple

    def unshown(self, name: str, found: Solution) -> Solution:
        """Return the solution with a reflex of usual shape, without a threshold."""
        usual = Shape(found.shape.delay, *USUAL)
        return self.problem(name, found.problem.data, free=()).at(usual)


def by_evidence(fits: Mapping[str, Solution]) -> tuple[str, bool]:
    """Return the reflex of greatest evidence, and whether that is clearly the greatest.

    It is compared with no reflex, with a linear late response and with the other reflexes.
    """
    evidence = {name: fit.objective for name, fit in fits.items()}
    best = max(evidence.keys() - {"none", "linear"}, key=lambda name: evidence[name])
    return best, all(
        evidence[best] - other > CERTAIN for name, other in evidence.items() if name != best
    )


def _best(fits: Mapping[str, Solution]) -> Solution:
    return max(fits.values(), key=lambda fit: fit.objective)


def _is_better(best: Solution, rest: Solution) -> bool:
    """Return whether a solution predicts better; of few realizations, has more evidence."""
    if len(best.problem.data.torque) < MIN_TESTED_REALIZATIONS:
        return best.objective > rest.objective
    return best.better_than(rest) < LIKELY
