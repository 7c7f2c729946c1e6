"""Choose the pathways, and whether they change over time, by how they predict held-out data."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from functools import cached_property, lru_cache, partial
from typing import NamedTuple

import attrs
import numpy as np
from scipy.linalg import block_diag

from tvsysid.methods.cascade.columns import deviations, readout
from tvsysid.methods.cascade.data import Data, Reflex
from tvsysid.methods.cascade.pathways import Drive, Measured, Stretch, history, velocity_of
from tvsysid.methods.cascade.problem import Problem, Solution
from tvsysid.methods.cascade.reflex_test import MIN_TESTED_REALIZATIONS
from tvsysid.methods.cascade.shape import Shape, first_shapes
from tvsysid.numerics import Array
from tvsysid.numerics.bases import FourierSeries
from tvsysid.numerics.noise import autocorrelation
from tvsysid.numerics.stretch import stretch
from tvsysid.signals import Ensemble

HISTORY_S = 0.75  # of the reflex's drive that is used where it was recorded
MAX_LIMITED_TIMES = 500  # in a period at which signs are limited, or somewhat more
MIN_EVIDENCE_GAIN = 10.0  # log evidence by which a reflex must be better than all else to be shown
MAX_MISFIT = 0.02  # share by which whitening may raise the held-out squares
WHITE_FLOOR = 30.0  # power of added white noise, relative to the noise, where whitening is wrong
MAX_CHANGE_P_VALUE = 0.05  # p-value below which a change or a threshold is accepted
CACHED_DRIVES = 4  # of a threshold, of those of its slopes, and of one that is tried

DIRECTIONS = {"positive": 1, "negative": -1}


class Hyperparameters(NamedTuple):
    """Settings that determine a solution, except its coefficients."""

    reflex: str
    varies: bool
    noise: Array
    shape: Shape
    parameters: Array


@attrs.frozen(eq=False)
class Search:
    """Data, and the reflexes that may explain them.

    A reflex is named ``"none"``, ``"linear"``, ``"positive"`` or ``"negative"`` by its direction,
    or ``"emg"`` if the channel of this name is given. A ``delay`` of None is fitted. ``harmonics``
    is the number of harmonics of the gain over a ``period`` in s. ``lags`` is the number of lags
    of the intrinsic response to either side, in samples.
    """

    ensemble: Ensemble
    data: Data
    lags: int
    emg: str | None
    harmonics: int
    period: float
    delay: float | None

    @property
    def reflexes(self) -> tuple[str, ...]:
        """Return the names of the reflexes that are compared."""
        return ("linear", *DIRECTIONS) if self.emg is None else ("emg",)

    @cached_property
    def velocity(self) -> tuple[Array, int]:
        """Return the velocity at the recorded rate, and the ratio of the rates."""
        return velocity_of(self.ensemble)

    def drive(self, name: str, threshold: float) -> Drive:
        """Return the drive of the named reflex."""
        return Measured(self.emg) if self.emg else Stretch(threshold, DIRECTIONS[name])

    def _past(self, name: str, threshold: float) -> Array:
        """Return the drive with its history (realization, history + time), less its mean.

        It is 0 where nothing was recorded.
        """
        if name == "linear":  # both directions together are not rectified
            return self._past("positive", 0.0) + self._past("negative", 0.0)
        if self.emg is None:
            values = stretch(*self.velocity, threshold, DIRECTIONS[name])
        else:
            values = self.ensemble.signal(self.emg)
        samples, times = round(HISTORY_S * self.ensemble.sampling_rate), self.data.times
        past = history(self.ensemble, values, samples)
        return deviations(past[self.data.rows, times.start : samples + times.stop])

    def problem(self, name: str, data: Data, is_free: bool = True) -> Problem:
        """Return the problem with the named reflex, whose shape may be free.

        The gain changes over time if the stiffness does.
        """
        if name == "none":
            return Problem(data)
        basis = FourierSeries(self.harmonics if data.varies else 0)
        past = lru_cache(CACHED_DRIVES)(partial(self._past, name))
        reflex = Reflex(past, basis, self.period, self.ensemble.sampling_rate, data.times)
        threshold = ("threshold",) * (name in DIRECTIONS)
        free = ("frequency", "damping", *threshold, *("delay",) * (self.delay is None))
        return Problem(data, reflex, free if is_free else ())

    def fits(self, constant: bool | None, names: Iterable[str]) -> dict[str, Solution]:
        """Return the solution for each named reflex.

        If ``constant`` is None, the data choose whether the coefficients change over time.
        """
        still = self.data.constant()
        begun = {}
        for name in names:
            problem = self.problem(name, still)
            begun[name] = problem.started(first_shapes(self.delay, problem.free))
        shapes = {name: each.shape for name, each in begun.items()}
        varying = self.data.varies and not constant
        data = self.data if varying else still
        likely = max(
            begun, key=lambda name: begun[name].objective + MIN_EVIDENCE_GAIN * (name == "none")
        )
        left = self.problem(likely, data).at(shapes[likely]).left
        weighted = data.weighted(autocorrelation(left))
        found = self._solved(weighted, shapes)
        if varying and constant is None:
            unchanging = self._solved(weighted.constant(), shapes)
            if not _is_better(_best(found), _best(unchanging)):
                found, data = unchanging, still
        if len(data.torque) < MIN_TESTED_REALIZATIONS:
            return found
        best = _best(found)
        data = data.weighted(autocorrelation(left, WHITE_FLOOR))
        white = attrs.evolve(best.problem, data=data).at(best.shape, best.parameters).share()
        is_misfit = white - best.share() > MAX_MISFIT * (1 - white)
        return self._solved(data, shapes) if is_misfit else found

    def _solved(self, data: Data, shapes: Mapping[str, Shape]) -> dict[str, Solution]:
        return {name: self.problem(name, data).at(shape) for name, shape in shapes.items()}

    def limited(self, found: Solution) -> Solution:
        """Return the solution with the same hyperparameters, without negative viscosity and gain.

        Stiffness, and the gain of EMG, are of either sign, but the same at all times.
        """
        problem, rate = found.problem, self.ensemble.sampling_rate
        weights = readout(self.lags, rate)[:2]
        weights[0] = 0.0
        weights[0, 0] = np.sign(found.coefficients[0])
        repeated = math.ceil(self.period * rate)
        some = slice(0, repeated, max(1, repeated // MAX_LIMITED_TIMES))
        rows = np.concatenate([each[some] for each in problem.data.features(weights)])
        gains = []
        if problem.reflex is not None:
            gains = [problem.reflex.basis(self.ensemble.time[some] / self.period)]
        both = [
            attrs.evolve(
                problem, positive=block_diag(rows, *(sign * gain for gain in gains))
            ).solution(found.shape, found.moments, found.parameters)
            for sign in ((1, -1) if self.emg else (1,))
        ]
        return min(both, key=lambda each: each.ridge.lost)

    def refitted(self, known: Hyperparameters) -> Solution:
        """Return the solution with these hyperparameters."""
        data = self.data if known.varies else self.data.constant()
        problem = self.problem(known.reflex, data.weighted(known.noise), is_free=False)
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
        problem = self.problem(name, found.problem.data, is_free=False)
        return problem.at(Shape(found.shape.delay))


@attrs.frozen(eq=False)
class Chosen:
    """Chosen reflex, whether it is ``shown``, and its solution among the ``fits`` of a search."""

    search: Search
    fits: Mapping[str, Solution]
    name: str
    shown: bool
    fit: Solution


def by_evidence(fits: Mapping[str, Solution]) -> tuple[str, bool]:
    """Return the reflex of greatest evidence, and whether that is clearly the greatest.

    It is compared with no reflex, with a linear late response and with the other reflexes.
    """
    evidence = {name: fit.objective for name, fit in fits.items()}
    best = max(evidence.keys() - {"none", "linear"}, key=lambda name: evidence[name])
    return best, all(
        evidence[best] - other > MIN_EVIDENCE_GAIN
        for name, other in evidence.items()
        if name != best
    )


def _best(fits: Mapping[str, Solution]) -> Solution:
    return max(fits.values(), key=lambda fit: fit.objective)


def _is_better(best: Solution, rest: Solution) -> bool:
    """Return whether a solution predicts better; of few realizations, has more evidence."""
    if len(best.problem.data.torque) < MIN_TESTED_REALIZATIONS:
        return best.objective > rest.objective
    return best.better_than(rest) < MAX_CHANGE_P_VALUE
