"""Which pathways there are, and whether they change over a realization: by what predicts realizations not fitted to."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from tvsysid.methods.cascade.regressors import Data, Reflex, Shape, readout
from tvsysid.methods.cascade.shape import Found, Problem, first_shapes, held_out
from tvsysid.numerics import Array
from tvsysid.numerics.bases import FourierSeries
from tvsysid.numerics.noise import white_share
from tvsysid.quality.reflexes import predicts_better
from tvsysid.quality.statistics import LEAST_REALIZATIONS
from tvsysid.signals import Ensemble

SETTLED = 0.45  # seconds of what drives a reflex that must be known before a sample that is fitted
HISTORY = 0.75  # seconds of it that are used where they were recorded
FOLDS = 3  # of realizations, taken in turn, each predicted from the others
USUAL = (16.0, 0.8, 0.0)  # frequency in rad/s, damping and threshold of a reflex that is not shown
CERTAIN = 10.0  # log evidence by which a reflex must be better than none, and than the rest, to be shown
LIKELY = 0.05  # probability below which what changes is taken to do so, and a threshold to be one

DIRECTIONS = {"positive": 1, "negative": -1}

Drives = Mapping[str, Callable[[float], Array]]  # by threshold, deviations (realization, history + time)


class Candidate(NamedTuple):
    """A solution, and the squares that it ``left`` in each realization that it was not fitted to; NaN if alone."""

    problem: Problem
    found: Found
    left: Array

    def share(self) -> float:
        """Of the torque's square, what is predicted where it was not fitted to."""
        return 1 - float(self.left.sum()) / float(np.sum(self.problem.data.torque**2))

    def better_than(self, other: Candidate) -> float:
        """Probability that this one predicts so much better by chance."""
        return predicts_better(self.left, other.left)[0]


class Hyperparameters(NamedTuple):
    """Everything of a solution with a reflex of some name but its coefficients."""

    reflex: str
    varies: bool
    share: float
    remainder: float | None
    shape: Shape
    parameters: Array

    @classmethod
    def of(cls, reflex: str, fit: Candidate) -> Self:
        """Return those of a solution."""
        data, found = fit.problem.data, fit.found
        return cls(reflex, data.varies, data.share, data.remainder, found.shape, found.parameters)


class Search(NamedTuple):
    """Data, and what may drive a reflex, by name; which numbers of its shape are ``free``; a ``delay`` of None is.

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

    @property
    def folds(self) -> list[NDArray[np.int64]]:
        """Realizations in the order in which they were recorded, in turn."""
        order = np.concatenate(self.ensemble.runs)
        return [np.sort(order[first::FOLDS]) for first in range(min(FOLDS, len(order)))]

    def problem(self, name: str, data: Data, free: tuple[str, ...] | None = None) -> Problem:
        """With a reflex of this name, or plain where it is "none"; the gain changes if the stiffness does."""
        if name == "none":
            return Problem.of(data, None, ())
        basis = FourierSeries(self.harmonics if data.varies else 0)
        reflex = Reflex(self.drives[name], basis, self.period, self.ensemble.sampling_rate, data.fitted)
        return Problem.of(data, reflex, self.free[name] if free is None else free)

    def fits(self, constant: bool | None, names: Iterable[str]) -> dict[str, Candidate]:
        """Solution with each of some reflexes, or without one ("none"); None chooses whether they are constant."""
        still = self.data.constant()
        first = {name: first_shapes(self.delay, self.free.get(name, ())) for name in names}
        shapes = {name: self.problem(name, still).started(each).shape for name, each in first.items()}
        varying = self.data.varies and not constant
        data = self.data if varying else still
        begun = {name: self.problem(name, data).at(shape) for name, shape in shapes.items()}
        known = self._noise(data, begun)
        counted = {name: self.problem(name, data.counting(*known)) for name in shapes}
        found = {name: self.judged(problem, problem.counted(begun[name])) for name, problem in counted.items()}
        if not varying or constant is False:
            return found
        constants = {name: self.problem(name, still.counting(*known)) for name in shapes}
        unchanging = {name: self.judged(problem, problem.at(shapes[name])) for name, problem in constants.items()}
        return found if _better(found, unchanging) else unchanging

    def _noise(self, data: Data, found: Mapping[str, Found]) -> tuple[float, float | None]:
        """What a sample is worth, as what the best solution leaves is not white, and the size of the differences.

        The latter is that for which all samples count: what the differences stand for (unlike filters, aliases) is no
        noise.
        """
        best = max(found, key=lambda name: found[name].objective + CERTAIN * (name == "none"))
        left = data.torque - np.sum(self.problem(best, data).torques(found[best]), axis=0)
        seen = data.fitted.all(axis=0)
        if not seen.any():
            return 1.0, None
        rate = self.ensemble.sampling_rate
        share = white_share(left[:, seen], data.signals[0][:, seen], rate, (0.0, rate / 2))
        if len(data.bases) == 3:
            return share, None
        # Where samples count less, a prior must be as much wider to hold as little.
        size = found[best].spread[sum(functions.shape[1] for functions in data.bases[:3])]
        return share, math.log(size) - math.log(share) / 2

    def limited(self, name: str, fit: Candidate) -> Candidate:
        """Solution with the same hyperparameters, whose viscosity and gain are not negative.

        The gain of EMG may be: its sign is the muscle's.
        """
        problem, found, left = fit
        rows = problem.data.features(readout(self.lags, self.ensemble.sampling_rate)[1:2])
        if problem.reflex is not None:
            gain = problem.reflex.basis(self.ensemble.time / self.period)
            rows.append(gain[: None if name in DIRECTIONS else 0])
        problem = replace(problem, positive=block_diag(*rows))
        found = problem.solved(found.shape, found.moments, found.scale, found.parameters)
        is_new = found.solved.lost > 0 and np.isfinite(left).all()
        return Candidate(problem, found, held_out(problem, found, self.folds) if is_new else left)

    def refitted(self, known: Hyperparameters) -> Candidate:
        """Return the solution with these hyperparameters."""
        data = self.data if known.varies else self.data.constant()
        problem = self.problem(known.reflex, data.counting(known.share, known.remainder), free=())
        return Candidate(problem, problem.at(known.shape, known.parameters), np.full(len(data.torque), np.nan))

    def judged(self, problem: Problem, found: Found) -> Candidate:
        """Solution with what it leaves where it was not fitted to."""
        folds = self.folds
        one = np.full(len(problem.data.torque), np.nan)
        return Candidate(problem, found, held_out(problem, found, folds) if len(folds) > 1 else one)

    def refined(self, name: str, fits: Mapping[str, Candidate]) -> Candidate:
        """Best solution with a reflex; without a threshold unless it predicts better with one.

        The threshold stays among the free numbers: bands count that it is not known.
        """
        problem = fits[name].problem
        found = problem.refined(fits[name].found.shape)
        best = self.judged(problem, found)
        if "threshold" not in problem.free or found.shape.threshold == 0:
            return best
        others = tuple(each for each in problem.free if each != "threshold")
        without = replace(problem, free=others).refined(found.shape._replace(threshold=0.0))
        simple = self.judged(problem, without)
        return best if _better({name: best}, {name: simple}) else simple

    def unshown(self, name: str, fits: Mapping[str, Candidate]) -> Candidate:
        """Solution with a reflex that nothing shows: it has the usual shape, and no threshold."""
        usual = Shape(fits[name].found.shape.delay, *USUAL)
        problem = self.problem(name, fits[name].problem.data, free=())
        return Candidate(problem, problem.at(usual), fits["none"].left)


def by_evidence(fits: Mapping[str, Candidate]) -> tuple[str, bool]:
    """Reflex of most evidence, and whether it has clearly more than no reflex, a linear late answer, or another one."""
    evidence = {name: fit.found.objective for name, fit in fits.items()}
    best = max(evidence.keys() - {"none", "linear"}, key=lambda name: evidence[name])
    return best, all(evidence[best] - other > CERTAIN for name, other in evidence.items() if name != best)


def _better(one: Mapping[str, Candidate], other: Mapping[str, Candidate]) -> bool:
    """Whether the best of some candidates predicts better than the best of others; of few, if it has more evidence."""
    best, rest = (max(each.values(), key=lambda fit: fit.found.objective) for each in (one, other))
    if len(best.left) < LEAST_REALIZATIONS:
        return best.found.objective > rest.found.objective
    return best.better_than(rest) < LIKELY
