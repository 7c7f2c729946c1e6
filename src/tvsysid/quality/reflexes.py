"""Whether a stretch reflex shows: joints with and without one are fitted, and judged by what they predict."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.special import stdtr, stdtrit

from tvsysid.errors import InputError
from tvsysid.numerics.stretch import recorded_velocity, stretch
from tvsysid.quality.statistics import LEAST_REALIZATIONS, solved
from tvsysid.signals import Array, Ensemble

ENOUGH = 1e-3  # probability below which it is not taken for chance
SURE = 0.95  # probability with which the share that a reflex predicts is larger than the one given
BLOCKS = 5  # of neighbouring realizations, each predicted from the others: slow noise is alike in neighbours
HARMONICS = 8  # of the realization's duration with which stiffness and viscosity vary
REACH = 0.04  # s to either side that the intrinsic response lasts
SOONEST, LATEST, SHAPES = 0.04, 0.33, 8  # lags in s of the reflex's response, and the triangles that make it up
LEAST_SAMPLES = 20  # of a realization at which all lags must be known
ROUNDING = 1e-12  # share of the torque's power that rounding leaves


class ReflexTest(NamedTuple):
    """What a stretch reflex adds to the prediction of torque in realizations that it was not fitted to.

    ``direction`` is 1 for a reflex to positive velocity and -1 for one to negative velocity, whichever predicts better.
    ``over_none`` and ``over_other`` are the probabilities that it predicts better than no reflex, and than a reflex of
    the other direction, by chance. ``share`` is how much of the squared error of either it takes at least, with a
    probability of 95 %; below zero where that is not sure. ``stiffness`` is the mean in N·m/rad without a reflex and
    with it.
    """

    direction: int
    over_none: float
    over_other: float
    share: float
    stiffness: tuple[float, float]

    @property
    def shown(self) -> bool:
        """Whether there is one: a late answer that is linear is explained as well by the other direction."""
        return max(self.over_none, self.over_other) < ENOUGH


class _Moments(NamedTuple):
    """Second moments in each realization of regressors (grams), with the torque (moments), and of the torque (squares).

    The first regressors are the joint's, ``mean`` of which gives its mean stiffness; then come those of a reflex to
    positive velocity, and to negative velocity.
    """

    grams: Array
    moments: Array
    squares: Array
    mean: Array

    def columns(self, direction: int) -> NDArray[np.intp]:
        """Regressors of a joint without a reflex (0), or with one of a direction."""
        every = np.arange(len(self.mean) + 2 * SHAPES)
        joint, positive, negative = np.split(every, [len(self.mean), len(self.mean) + SHAPES])
        return np.concatenate([joint, {0: joint[:0], 1: positive, -1: negative}[direction]])

    def weights(self, direction: int, left_out: slice = slice(0)) -> Array:
        """Coefficients fitted to all realizations but some."""
        own = self.columns(direction)
        gram, moments = (values.sum(axis=0) - values[left_out].sum(axis=0) for values in (self.grams, self.moments))
        gram, power = gram[np.ix_(own, own)], gram.diagonal()[own]
        size = np.sqrt(np.where(power > 0, power, 1.0))
        return solved(gram / np.outer(size, size), moments[own] / size) / size

    def errors(self, direction: int) -> Array:
        """Squared error of each realization as predicted from those of other blocks."""
        own, count, left = self.columns(direction), len(self.squares), self.squares.copy()
        for block in range(BLOCKS):
            out = slice(count * block // BLOCKS, count * (block + 1) // BLOCKS)
            weights = self.weights(direction, out)
            spent = self.grams[out][:, own[:, None], own] @ weights - 2 * self.moments[out][:, own]
            left[out] += spent @ weights
        return np.asarray(np.maximum(left, ROUNDING * self.squares) + np.finfo(float).tiny)


def reflex_test_of(ensemble: Ensemble) -> ReflexTest:
    """Test an ensemble for a stretch reflex, with the velocity rectified at the rate at which the angle was recorded.

    As :func:`reflex_test`, of the deviations from the mean over realizations.
    """
    order, recorded = np.concatenate(ensemble.runs), ensemble.angle_as_recorded
    velocity, ratio = recorded_velocity(recorded[order], ensemble.sampling_rate), recorded.shape[-1]
    stretches = stretch(velocity, ratio), stretch(velocity, ratio, direction=-1)
    angle, torque = ((each - each.mean(axis=0))[order] for each in (ensemble.angle, ensemble.torque))
    return reflex_test(angle, torque, stretches, ensemble.core, ensemble.sampling_rate)


def reflex_test(angle: Array, torque: Array, stretches: tuple[Array, Array], core: slice, rate: float) -> ReflexTest:
    """Test for a stretch reflex by nested models, each fitted to all but a block of realizations, which it predicts.

    The joint's response lasts 40 ms to either side, and its stiffness and viscosity vary over a realization; that of
    the reflex is to the velocity 40 to 330 ms earlier, where that is positive, or where it is negative.

    Parameters
    ----------
    angle, torque
        Deviations from the mean over realizations in rad and N·m, shape (realization, time), in the order of recording.
    stretches
        Velocity in rad/s where it is positive, and where it is negative, zero elsewhere; rectified before decimation.
        Each of the angle's shape.
    core
        Samples of a realization within its context.
    rate
        Sampling rate in Hz.

    Raises
    ------
    InputError
        If all lags are known at fewer than 20 samples of a realization.
    """
    sums = _moments(angle, torque, stretches, core, rate)
    errors = {direction: sums.errors(direction) for direction in (0, 1, -1)}
    best = 1 if np.sum(np.log(errors[-1] / errors[1])) >= 0 else -1
    without, other, error = errors[0], errors[-best], errors[best]
    over_none, least_over_none = predicts_better(error, without)
    over_other, least_over_other = predicts_better(error, other)
    stiffness = [float(sums.mean @ sums.weights(direction)[: len(sums.mean)]) for direction in (0, best)]
    return ReflexTest(
        direction=best,
        over_none=min(1.0, 2 * over_none),  # each of two directions may predict better than none by chance
        over_other=over_other,
        share=1 - math.exp(-min(least_over_none, least_over_other)),
        stiffness=(stiffness[0], stiffness[1]),
    )


def predicts_better(errors: Array, others: Array) -> tuple[float, float]:
    """Probability that squared errors are so much smaller than others by chance, and how much they are so at least.

    Of the same realizations, which neither was fitted to; in logarithms, as some realizations are louder than others.
    """
    scores, count = np.log(others / errors), len(errors)
    spread = float(scores.std(ddof=1)) / math.sqrt(count) if count >= LEAST_REALIZATIONS else 0.0
    if spread == 0:
        return 1.0, 0.0
    mean = float(scores.mean())
    return float(stdtr(count - 1, -mean / spread)), mean - spread * float(stdtrit(count - 1, SURE))


def _moments(angle: Array, torque: Array, stretches: tuple[Array, Array], core: slice, rate: float) -> _Moments:
    reach, soonest, latest = (round(seconds * rate) for seconds in (REACH, SOONEST, LATEST))
    start, stop = max(core.start, latest, reach), min(core.stop, angle.shape[1] - reach)
    if stop - start < LEAST_SAMPLES:
        raise InputError(
            f"reflex_test: what was {LATEST:g} s before is known at {max(stop - start, 0)} samples of a realization, "
            f"it takes {LEAST_SAMPLES}; give longer realizations, or {LATEST:g} s of context"
        )
    times, wide = slice(start, stop), 2 * reach + 1
    turns = (np.arange(start, stop)[:, None] - core.start) / (core.stop - core.start) * np.arange(1, HARMONICS + 1)
    waves = np.concatenate([np.cos(2 * np.pi * turns), np.sin(2 * np.pi * turns)], axis=1)
    late = [
        _windows(each - each.mean(axis=0), latest - soonest + 1, start - latest, stop - latest) for each in stretches
    ]
    # The first of a window's samples is the earliest.
    apart = np.abs(np.arange(latest, soonest - 1, -1)[:, None] - np.linspace(soonest, latest, SHAPES))
    triangles = np.maximum(0.0, 1 - apart * (SHAPES - 1) / max(latest - soonest, 1))
    near = _windows(angle, wide, start - reach, stop - reach)
    velocity = stretches[0] + stretches[1]
    velocity = (velocity - velocity.mean(axis=0))[:, times, None]
    mean = np.concatenate([np.ones(wide), waves.mean(axis=0), np.zeros(waves.shape[1])])
    grams = np.empty((len(angle), *2 * (len(mean) + 2 * SHAPES,)))
    moments = np.empty(grams.shape[:2])
    for each in range(len(angle)):
        varying = [waves * angle[each, times, None], waves * velocity[each]]
        rows = np.concatenate([near[each], *varying, *(drive[each] @ triangles for drive in late)], axis=1)
        grams[each], moments[each] = rows.T @ rows, torque[each, times] @ rows
    return _Moments(grams, moments, np.sum(torque[:, times] ** 2, axis=1), mean)


def _windows(signal: Array, width: int, first: int, stop: int) -> Array:
    return sliding_window_view(signal, width, axis=1)[:, first:stop]
