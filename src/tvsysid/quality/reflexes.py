"""Whether a stretch reflex shows: joints with and without one are fitted, and judged by what they predict."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.special import stdtr, stdtrit

from tvsysid.errors import InputError
from tvsysid.numerics.stretch import recorded_velocity, stretch
from tvsysid.quality.statistics import LEAST_REALIZATIONS, solved
from tvsysid.signals import Array, Ensemble

ENOUGH = 1e-4  # probability below which it is not taken for chance
SURE = 0.95  # probability with which the share that a reflex predicts is larger than the one given
BLOCKS = 5  # of neighbouring realizations, each predicted from the others: slow noise is alike in neighbours
HARMONICS = 8  # of the realization's duration with which stiffness and viscosity vary
SLOWEST = 2  # harmonics by which a change is found
REACH = 0.04  # s to either side that the intrinsic response lasts
SOONEST, LATEST, SHAPES = 0.04, 0.33, 8  # lags in s of the reflex's response, and the triangles that make it up
USUAL_MUSCLE = (16.0, 0.8)  # frequency in rad/s and damping of the muscle of the reflex that is tested for
LEAST_SAMPLES = 20  # of a realization at which all lags must be known
ROUNDING = 1e-12  # share of the torque's power that rounding leaves
_TESTED: WeakKeyDictionary[Ensemble, ReflexTest] = WeakKeyDictionary()


class ReflexTest(NamedTuple):
    """What a stretch reflex adds to the prediction of torque in realizations that it was not fitted to.

    ``direction`` is 1 for a reflex to positive velocity and -1 for one to negative velocity, whichever predicts better.
    ``over_none`` and ``over_linear`` are the probabilities that it adds so much to no reflex, and to a late answer that
    is the same in both directions, by chance. ``share`` is how much of the squared error of either it takes at least,
    with a probability of 95 %; below zero where that is not sure. ``stiffness`` is the mean in N·m/rad without a reflex
    and with it.
    """

    direction: int
    over_none: float
    over_linear: float
    share: float
    stiffness: tuple[float, float]

    @property
    def shown(self) -> bool:
        """Whether there is one: a late answer that is linear needs no direction."""
        return max(self.over_none, self.over_linear) < ENOUGH


class _Moments(NamedTuple):
    """Second moments in each realization of regressors (grams), with the torque (moments), and of the torque (squares).

    The first regressors are the joint's, ``mean`` of which gives its mean stiffness, modulated by these
    ``harmonics`` of the realization's duration; then come those of late answers to positive velocity, and to negative
    velocity: the triangles, from which any response is made.
    """

    grams: Array
    moments: Array
    squares: Array
    mean: Array
    harmonics: NDArray[np.int64]

    def columns(self, *late: Array) -> Array:
        """Columns of a model, as mixtures of the regressors: the joint's, and these of the late answers."""
        own = len(self.mean)
        out = np.zeros((own + 2 * SHAPES, own + len(late)))
        out[:own, :own] = np.eye(own)
        for number, mixture in enumerate(late):
            out[own:, own + number] = mixture
        return out

    def weights(self, columns: Array, left_out: slice = slice(0)) -> Array:
        """Weights of the regressors, fitted to all realizations but some."""
        gram, moments = (values.sum(axis=0) - values[left_out].sum(axis=0) for values in (self.grams, self.moments))
        gram, moments = columns.T @ gram @ columns, moments @ columns
        power = gram.diagonal()
        size = np.sqrt(np.where(power > 0, power, 1.0))
        return np.asarray(columns @ (solved(gram / np.outer(size, size), moments / size) / size))

    def weights_of_others(self, columns: Array) -> Array:
        """The same for each realization (realization, regressor), from those of other blocks."""
        count = len(self.squares)
        edges = [count * block // BLOCKS for block in range(BLOCKS + 1)]
        parts = [np.tile(self.weights(columns, slice(*out)), (out[1] - out[0], 1)) for out in pairwise(edges)]
        return np.concatenate(parts)

    def errors(self, weights: Array) -> Array:
        """Squared error of each realization."""
        left = self.squares + np.sum(weights * ((self.grams @ weights[..., None])[..., 0] - 2 * self.moments), axis=1)
        return np.asarray(np.maximum(left, ROUNDING * self.squares) + np.finfo(float).tiny)

    def added(self, weights: Array, further: Array) -> Array:
        """Product of the first weights' error with what others predict further, over that error's square."""
        change = further - weights
        product = np.sum(change * (self.moments - (self.grams @ weights[..., None])[..., 0]), axis=1)
        return np.where(np.abs(product) > ROUNDING * self.squares, product / self.errors(weights), 0.0)


def reflex_test_of(ensemble: Ensemble) -> ReflexTest:
    """Test an ensemble for a stretch reflex, with the velocity rectified at the rate at which the angle was recorded.

    As :func:`reflex_test`, of the deviations from the mean over realizations. It is done once for an ensemble: several
    methods and checks ask.
    """
    if ensemble not in _TESTED:
        _TESTED[ensemble] = _reflex_test(_moments_of(ensemble))
    return _TESTED[ensemble]


def changes(ensemble: Ensemble) -> bool:
    """Whether stiffness or viscosity change over a realization, by the first harmonics of it, beside any reflex.

    Tested as :func:`reflex_test` does, with the same error where realizations are too short.
    """
    sums = _moments_of(ensemble)
    every = sums.columns(*_answers())
    constant, changing = (
        sums.weights_of_others(np.delete(every, np.flatnonzero(sums.harmonics > most), axis=1)) for most in (0, SLOWEST)
    )
    return _above_zero(sums.added(constant, changing))[0] < ENOUGH


def _moments_of(ensemble: Ensemble) -> _Moments:
    order, recorded = np.concatenate(ensemble.runs), ensemble.angle_as_recorded
    velocity, ratio = recorded_velocity(recorded[order], ensemble.sampling_rate), recorded.shape[-1]
    stretches = stretch(velocity, ratio), stretch(velocity, ratio, direction=-1)
    angle, torque = ((each - each.mean(axis=0))[order] for each in (ensemble.angle, ensemble.torque))
    return _moments(angle, torque, stretches, ensemble.core, ensemble.sampling_rate)


def reflex_test(angle: Array, torque: Array, stretches: tuple[Array, Array], core: slice, rate: float) -> ReflexTest:
    r"""Test for a stretch reflex by nested models, each fitted to all but a block of realizations, which it predicts.

    The joint's response lasts 40 ms to either side, and its stiffness and viscosity vary over a realization. A reflex
    adds an answer to the velocity where that is positive, or where it is negative, through a usual muscle (16 rad/s, a
    damping of 0.8) that begins 40 ms later and is over after 330 ms. What it adds to a simpler model, without a reflex
    or with one that is linear, is tested by

    .. math:: \sum_t (y - \hat y_0)(\hat y_1 - \hat y_0)

    of each realization over its :math:`\sum_t (y - \hat y_0)^2`: zero on average if the simpler model 0 is right. The
    difference of squared errors has a part on top, which what is fitted in vain costs, and half the power.

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

    References
    ----------
    Clark & West 2007, J. Econometrics 138, 291-311: nested models by what they predict.
    """
    return _reflex_test(_moments(angle, torque, stretches, core, rate))


def _reflex_test(sums: _Moments) -> ReflexTest:
    positive, negative = _answers()
    models = [(), (positive + negative,), (positive, negative), (positive,), (negative,)]
    none, linear, both, *directed = (sums.weights_of_others(sums.columns(*late)) for late in models)
    errors = [sums.errors(weights) for weights in directed]
    direction = 1 if np.sum(np.log(errors[1] / errors[0])) >= 0 else -1
    over_none, least_over_none = _above_zero(sums.added(none, directed[0 if direction > 0 else 1]))
    over_linear, least_over_linear = _above_zero(sums.added(linear, both))
    free = np.eye(2 * SHAPES)[:SHAPES] if direction > 0 else np.eye(2 * SHAPES)[SHAPES:]
    stiffness = [float(sums.mean @ sums.weights(sums.columns(*late))[: len(sums.mean)]) for late in ((), free)]
    return ReflexTest(
        direction=direction,
        over_none=min(1.0, 2 * over_none),  # each of two directions may add to none by chance
        over_linear=over_linear,
        share=min(least_over_none, least_over_linear),
        stiffness=(stiffness[0], stiffness[1]),
    )


def _answers() -> tuple[Array, Array]:
    """Heights of the triangles of both velocities that make up a usual muscle's answer to the one, and to the other."""
    frequency, damping = USUAL_MUSCLE
    late = np.linspace(0, LATEST - SOONEST, SHAPES)
    usual = np.exp(-damping * frequency * late) * np.sin(frequency * math.sqrt(1 - damping**2) * late)
    return np.concatenate([usual, 0 * usual]), np.concatenate([0 * usual, usual])


def predicts_better(errors: Array, others: Array) -> tuple[float, float]:
    """Probability that squared errors are so much smaller than others by chance, and how much they are so at least.

    Of the same realizations, which neither was fitted to; in logarithms, as some realizations are louder than others.
    """
    return _above_zero(np.log(others / errors))


def _above_zero(scores: Array) -> tuple[float, float]:
    """Probability that the mean of realizations' scores lies so far above zero by chance, and how large it is at least.

    1 and 0 of too few to judge by, or of such as do not differ.
    """
    count = len(scores)
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
    harmonics = np.concatenate([np.zeros(wide, dtype=np.int64), np.tile(np.arange(1, HARMONICS + 1), 4)])
    return _Moments(grams, moments, np.sum(torque[:, times] ** 2, axis=1), mean, harmonics)


def _windows(signal: Array, width: int, first: int, stop: int) -> Array:
    return sliding_window_view(signal, width, axis=1)[:, first:stop]
