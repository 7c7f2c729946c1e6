"""Whether a stretch reflex shows: joints with and without one are fitted, and judged by what they predict."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.special import stdtr, stdtrit

from tvsysid.errors import InputError
from tvsysid.numerics.moments import row_blocks
from tvsysid.numerics.pseudoinverse import solve_regularized
from tvsysid.numerics.stretch import recorded_velocity, stretch
from tvsysid.signals import Array, Ensemble

MIN_TESTED_REALIZATIONS = 8  # fewer do not show the scatter that a test needs
ENOUGH = 1e-4  # probability below which it is not taken for chance
SURE = 0.95  # probability with which the share that a reflex predicts is larger than the one given
# of neighbouring realizations, each predicted from the others: slow noise is alike in neighbours
BLOCKS = 5
HARMONICS = 8  # of the realization's duration with which stiffness and viscosity vary
SLOWEST = 2  # harmonics by which a change is found
REACH = 0.04  # s to either side that the intrinsic response lasts
SOONEST, LATEST, SHAPES = (
    0.04,
    0.33,
    8,
)  # lags in s of the reflex's response, and the triangles that make it up
USUAL_MUSCLE = (
    16.0,
    0.8,
)  # frequency in rad/s and damping of the muscle of the reflex that is tested for
LEAST_SAMPLES = 20  # of a realization at which all lags must be known
SLOW_TERMS = (
    4  # powers of time that are left out of each realization where they are most of the torque
)
ROUNDING = 1e-12  # share of the torque's power that rounding leaves
_TESTED: WeakKeyDictionary[Ensemble, ReflexTest] = WeakKeyDictionary()


class ReflexTest(NamedTuple):
    """What a stretch reflex adds to the prediction of torque in realizations that it was not fitted to.

    ``direction`` is 1 for a reflex to positive velocity and -1 for one to negative velocity,
    whichever predicts better. ``over_none`` and ``over_linear`` are the probabilities that it
    adds so much to no reflex, and to a late answer that is the same in both directions, by
    chance. ``share`` is how much of the squared error of either it takes at least, with a
    probability of 95 %; below zero where that is not sure. ``stiffness`` is the mean in N·m/rad
    without a reflex and with it.
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


class _Fit(NamedTuple):
    """Weights of the regressors (block, regressor), from the other blocks.

    Each realization's gram times its own.
    """

    weights: Array
    products: Array


class _Moments(NamedTuple):
    """Products of regressors and torque, as a ``whole`` (regressor + 1, regressor + 1), and without what is slow.

    The latter are those of ``blocks`` of realizations (block, regressor + 1, regressor + 1), and of
    the torque of each realization with regressors (moments) and itself (squares); ``block`` says in
    which block it is. The ``products`` of a realization are made anew whenever they are needed: all
    together take many times the memory of the data.

    The first regressors are the joint's, ``mean`` of which gives its mean stiffness, modulated
    by these ``harmonics`` of the realization's duration; then come those of late answers to
    positive velocity, and to negative velocity: the triangles, from which any response is made.
    """

    blocks: Array
    moments: Array
    squares: Array
    block: NDArray[np.intp]
    whole: Array
    products: Callable[[], Iterator[tuple[Array, Array]]]
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

    def weights(self, columns: Array, left_out: int | None = None) -> Array:
        """Weights of the regressors, fitted to all realizations but a block.

        Or to all, and to what is slow.
        """
        sums = (
            self.whole if left_out is None else np.delete(self.blocks, left_out, axis=0).sum(axis=0)
        )
        gram, moments = columns.T @ sums[:-1, :-1] @ columns, sums[-1, :-1] @ columns
        power = gram.diagonal()
        size = np.sqrt(np.where(power > 0, power, 1.0))
        return np.asarray(
            columns @ (solve_regularized(gram / np.outer(size, size), moments / size) / size)
        )

    def fits(self, *models: Array) -> list[_Fit]:
        """Models of these columns, each fitted to all but a block of realizations, which it is to predict."""
        weights = [
            np.stack([self.weights(columns, block) for block in range(BLOCKS)])
            for columns in models
        ]
        products = np.empty((len(models), *self.moments.shape))
        for each, (_, fast) in enumerate(self.products()):
            for model, of_blocks in enumerate(weights):
                products[model, each] = fast[:-1, :-1] @ of_blocks[self.block[each]]
        return [_Fit(*each) for each in zip(weights, products, strict=True)]

    def errors(self, fit: _Fit) -> Array:
        """Squared error of each realization."""
        left = self.squares + np.sum(
            fit.weights[self.block] * (fit.products - 2 * self.moments), axis=1
        )
        return np.asarray(np.maximum(left, ROUNDING * self.squares) + np.finfo(float).tiny)

    def added(self, fit: _Fit, further: _Fit) -> Array:
        """Product of the first fit's error with what another predicts further, over that error's square."""
        change = (further.weights - fit.weights)[self.block]
        product = np.sum(change * (self.moments - fit.products), axis=1)
        return np.where(np.abs(product) > ROUNDING * self.squares, product / self.errors(fit), 0.0)


def reflex_test_of(ensemble: Ensemble) -> ReflexTest:
    """Test an ensemble for a stretch reflex, with the velocity rectified at the rate at which the angle was recorded.

    As :func:`reflex_test`, of the deviations from the mean over realizations. It is done once
    for an ensemble: several methods and checks ask.
    """
    if ensemble not in _TESTED:
        _TESTED[ensemble] = _reflex_test(_moments_of(ensemble))
    return _TESTED[ensemble]


def changes(ensemble: Ensemble) -> bool:
    """Return whether stiffness or viscosity change over a realization, beside any reflex.

    The first harmonics of the realization are tested as :func:`reflex_test` tests a reflex.
    False where realizations are too short to tell.
    """
    try:
        sums = _moments_of(ensemble)
    except InputError:
        return False
    every = sums.columns(*_answers())
    constant, changing = sums.fits(
        *(np.delete(every, np.flatnonzero(sums.harmonics > most), axis=1) for most in (0, SLOWEST))
    )
    return _above_zero(sums.added(constant, changing))[0] < ENOUGH


def _moments_of(ensemble: Ensemble) -> _Moments:
    order, recorded = np.concatenate(ensemble.runs), ensemble.angle_as_recorded
    stretches = np.empty((2, *ensemble.angle.shape))
    for some in row_blocks(len(order), recorded[0].size):
        velocity = recorded_velocity(recorded[order[some]], ensemble.sampling_rate)
        for out, direction in zip(stretches, (1, -1), strict=True):
            out[some] = stretch(velocity, recorded.shape[-1], direction=direction)
    angle, torque = (
        _Signal(each, each.mean(axis=0), order) for each in (ensemble.angle, ensemble.torque)
    )
    return _moments(
        angle, torque, (stretches[0], stretches[1]), ensemble.core, ensemble.sampling_rate
    )


def reflex_test(
    angle: Array, torque: Array, stretches: tuple[Array, Array], core: slice, rate: float
) -> ReflexTest:
    r"""Test for a stretch reflex by nested models, each fitted to all but a block of realizations, which it predicts.

    The joint's response lasts 40 ms to either side, and its stiffness and viscosity vary over a
    realization. A reflex adds an answer to the velocity where that is positive, or where it is
    negative, through a usual muscle (16 rad/s, a damping of 0.8) that begins 40 ms later and is
    over after 330 ms. What it adds to a simpler model, without a reflex or with one that is linear,
    is tested by

    .. math:: \sum_t (y - \hat y_0)(\hat y_1 - \hat y_0)

    of each realization over its :math:`\sum_t (y - \hat y_0)^2`: zero on average if the simpler
    model 0 is right. The difference of squared errors has a part on top, which what is fitted in
    vain costs, and half the power. Where a cubic polynomial of time is most of the torque, as of
    slow voluntary torque, it is left out of each realization.

    Parameters
    ----------
    angle, torque
        Deviations from the mean over realizations in rad and N·m, shape (realization, time), in the
        order of recording.
    stretches
        Velocity in rad/s where it is positive, and where it is negative, zero elsewhere; rectified
        before decimation. Each of the angle's shape.
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
    order, still = np.arange(len(angle)), np.zeros(angle.shape[1])
    return _reflex_test(
        _moments(_Signal(angle, still, order), _Signal(torque, still, order), stretches, core, rate)
    )


def _reflex_test(sums: _Moments) -> ReflexTest:
    positive, negative = _answers()
    models = [(), (positive + negative,), (positive, negative), (positive,), (negative,)]
    none, linear, both, *directed = sums.fits(*(sums.columns(*late) for late in models))
    errors = [sums.errors(fit) for fit in directed]
    direction = 1 if np.sum(np.log(errors[1] / errors[0])) >= 0 else -1
    over_none, least_over_none = _above_zero(sums.added(none, directed[0 if direction > 0 else 1]))
    over_linear, least_over_linear = _above_zero(sums.added(linear, both))
    free = np.eye(2 * SHAPES)[:SHAPES] if direction > 0 else np.eye(2 * SHAPES)[SHAPES:]
    stiffness = [
        float(sums.mean @ sums.weights(sums.columns(*late))[: len(sums.mean)])
        for late in ((), free)
    ]
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
    usual = np.exp(-damping * frequency * late) * np.sin(
        frequency * math.sqrt(1 - damping**2) * late
    )
    return np.concatenate([usual, 0 * usual]), np.concatenate([0 * usual, usual])


def predicts_better(errors: Array, others: Array) -> tuple[float, float]:
    """Probability that squared errors are so much smaller than others by chance, and how much they are so at least.

    Of the same realizations, which neither was fitted to; in logarithms, as some realizations
    are louder than others.
    """
    return _above_zero(np.log(others / errors))


def _above_zero(scores: Array) -> tuple[float, float]:
    """Probability that the mean of realizations' scores lies so far above zero by chance, and how large it is at least.

    1 and 0 of too few to judge by, or of such as do not differ.
    """
    count = len(scores)
    spread = (
        float(scores.std(ddof=1)) / math.sqrt(count) if count >= MIN_TESTED_REALIZATIONS else 0.0
    )
    if spread == 0:
        return 1.0, 0.0
    mean = float(scores.mean())
    return float(stdtr(count - 1, -mean / spread)), mean - spread * float(stdtrit(count - 1, SURE))


class _Signal(NamedTuple):
    """Deviations of a signal (realization, time) from a mean over realizations, in an order."""

    values: Array
    mean: Array
    order: NDArray[np.intp]

    def some(self, which: slice) -> Array:
        """Of some realizations."""
        return np.asarray(self.values[self.order[which]] - self.mean)


def _moments(
    angle: _Signal, torque: _Signal, stretches: tuple[Array, Array], core: slice, rate: float
) -> _Moments:
    reach, soonest, latest = (round(seconds * rate) for seconds in (REACH, SOONEST, LATEST))
    start, stop = max(core.start, latest, reach), min(core.stop, len(angle.mean) - reach)
    if stop - start < LEAST_SAMPLES:
        raise InputError(
            f"reflex_test: what was {LATEST:g} s before is known at {max(stop - start, 0)} "
            "samples of a realization, "
            f"it takes {LEAST_SAMPLES}; give longer realizations, or {LATEST:g} s of context"
        )
    times, wide, count = slice(start, stop), 2 * reach + 1, len(angle.order)
    turns = (
        (np.arange(start, stop)[:, None] - core.start)
        / (core.stop - core.start)
        * np.arange(1, HARMONICS + 1)
    )
    waves = np.concatenate([np.cos(2 * np.pi * turns), np.sin(2 * np.pi * turns)], axis=1)
    # The first of a window's samples is the earliest.
    apart = np.abs(
        np.arange(latest, soonest - 1, -1)[:, None] - np.linspace(soonest, latest, SHAPES)
    )
    triangles = np.maximum(0.0, 1 - apart * (SHAPES - 1) / max(latest - soonest, 1))
    still = [each.mean(axis=0) for each in stretches]
    steady = (
        sum(first[times] + second[times] for first, second in zip(*stretches, strict=True)) / count
    )

    slow = np.linalg.qr(np.vander(turns[:, 0], SLOW_TERMS))[0]
    torques = torque.some(slice(None))[:, times]
    if 2 * np.sum((torques @ slow) ** 2) < np.sum(torques**2):
        slow = slow[:, :0]

    def products() -> Iterator[tuple[Array, Array]]:
        """Products of regressors and torque of one realization after the other, and without what is slow."""
        for some in row_blocks(count, 4 * len(angle.mean)):
            near = angle.some(some)
            late = [
                _windows(each[some] - mean, latest - soonest + 1, start - latest, stop - latest)
                for each, mean in zip(stretches, still, strict=True)
            ]
            velocity = (stretches[0][some, times] + stretches[1][some, times] - steady)[:, :, None]
            windows = _windows(near, wide, start - reach, stop - reach)
            for each in range(len(near)):
                varying = [waves * near[each, times, None], waves * velocity[each]]
                parts = [windows[each], *varying, *(drive[each] @ triangles for drive in late)]
                rows = np.concatenate([*parts, torques[some][each, :, None]], axis=1)
                whole, taken = rows.T @ rows, slow.T @ rows
                yield whole, whole - taken.T @ taken

    mean = np.concatenate([np.ones(wide), waves.mean(axis=0), np.zeros(waves.shape[1])])
    edges = [count * block // BLOCKS for block in range(BLOCKS + 1)]
    block = np.repeat(np.arange(BLOCKS), np.diff(edges))
    size = len(mean) + 2 * SHAPES + 1
    blocks, last = np.zeros((BLOCKS, size, size)), np.empty((count, size))
    total = np.zeros_like(blocks[0])
    for each, (whole, fast) in enumerate(products()):
        total += whole
        blocks[block[each]] += fast
        last[each] = fast[-1]
    harmonics = np.concatenate(
        [np.zeros(wide, dtype=np.int64), np.tile(np.arange(1, HARMONICS + 1), 4)]
    )
    return _Moments(blocks, last[:, :-1], last[:, -1], block, total, products, mean, harmonics)


def _windows(signal: Array, width: int, first: int, stop: int) -> Array:
    return sliding_window_view(signal, width, axis=1)[:, first:stop]
