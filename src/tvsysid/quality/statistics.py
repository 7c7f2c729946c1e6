"""Tests over realizations, least squares, linear prediction; what methods judge alike.

Arrays only.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.special import stdtr

from tvsysid.methods.cascade.reflex_test import MIN_TESTED_REALIZATIONS
from tvsysid.numerics.moments import sliding_sum
from tvsysid.numerics.pseudoinverse import RIDGE, solve_regularized
from tvsysid.quality.catalogue import FAULTS
from tvsysid.signals import Array

TOLD_BY_FEW = 5  # realizations below which a mean over them is not judged at all
SIGNIFICANT = 1e-5  # probability below which noise is not taken for the cause of what is seen
FOLDS = 4
STILL = 1e-6  # share of the angle's mean power over realizations below which it does not move
SEVERAL = 20  # realizations that tell how the angle moves
STEP_S, WINDOW_S = (
    0.01,
    0.05,
)  # of the differences that stand for derivatives, and to either side of a time at least


def p_value(mean: float, error: float, count: int) -> float:
    """Return the two-sided p-value of the mean of independent realizations (Student's t).

    ``error`` is the standard error of the mean.
    """
    if count < MIN_TESTED_REALIZATIONS:
        return 1.0
    if error == 0:
        return float(mean == 0)
    return float(2 * stdtr(count - 1, -abs(mean) / error))


def p_value_of(scores: Array) -> float:
    """The same from the scores of the realizations, shape (realization,)."""
    return p_value(
        float(scores.mean()), float(scores.std(ddof=1)) / math.sqrt(len(scores)), len(scores)
    )


def gained(target: Array, regressors: Array) -> tuple[float, float]:
    """Return the variance share that regressors predict in held-out realizations, and its p-value.

    The signal is of shape (realization, time), regressors of shape (regressor, realization,
    time). The share is below zero where they predict nothing; the p-value comes from the scatter
    of the gain over realizations.
    """
    gain = gains(target, regressors)
    total = float(np.sum(target**2))
    return float(gain.sum()) / total if total > 0 else math.nan, p_value_of(gain)


def gains(target: Array, regressors: Array) -> Array:
    """Sum of squares that regressors take from each realization, fitted to others.

    Shapes as above.
    """
    count = len(target)
    rows = np.ascontiguousarray(regressors.transpose(1, 0, 2))
    grams = rows @ rows.transpose(0, 2, 1)
    moments = (rows @ target[..., None])[..., 0]
    taken = np.empty(count)
    # Neighbours are left out together: slow noise is alike in them.
    for out in np.array_split(np.arange(count), FOLDS):
        kept = np.setdiff1d(np.arange(count), out)
        weights = solve_regularized(grams[kept].sum(axis=0), moments[kept].sum(axis=0))
        taken[out] = 2 * moments[out] @ weights - np.einsum(
            "a,rab,b->r", weights, grams[out], weights
        )
    return taken


def without(target: Array, regressors: Array) -> Array:
    """Signal less what regressors explain of it.

    Shapes (..., realization, time) and (regressor, realization, time).
    """
    rows = regressors.reshape(len(regressors), -1)
    weights = solve_regularized(rows @ rows.T, rows @ target.reshape(-1, rows.shape[1]).T)
    return target - (weights.T @ rows).reshape(target.shape)


def prediction_error(signal: Array, order: int) -> Array:
    """Return the prediction-error filter of a signal (realization, time).

    It leaves what ``order`` samples of the past do not predict.
    """
    rows = sliding_window_view(signal, order + 1, axis=1).reshape(-1, order + 1)
    gram = rows.T @ rows
    return np.concatenate(
        [[1.0], -solve_regularized(gram[:order, :order], gram[:order, order])[::-1]]
    )


def innovations(signal: Array, order: int) -> Array:
    """What so many samples of a signal's past do not predict, shape (realization, time - order)."""
    return np.asarray(
        sliding_window_view(signal, order + 1, axis=1) @ prediction_error(signal, order)[::-1]
    )


def over_usual(values: Array, quantile: float) -> Array:
    """Values over one of their quantiles; zero where that is."""
    usual = float(np.quantile(values, quantile))
    return values / usual if usual > 0 else np.zeros_like(values)


class MeanLeft(NamedTuple):
    """The mean over realizations: its RMS, and what chance would leave of it."""

    size: float
    expected: float
    ratio: float
    """Ratio of size to expected, or of a common offset to its standard error if it is more."""
    significant: bool
    """Whether noise does not explain a ratio beyond the limit."""

    @property
    def found(self) -> bool:
        """Whether a mean is left."""
        return self.significant and self.ratio > FAULTS["mean-torque"].limit


def mean_left(values: Array) -> MeanLeft:
    """Judge the mean over realizations by what chance leaves of it.

    Values have shape (realization, time). Noise is alike at neighbouring times, so that its mean is
    not averaged out over time: hence a limit above 1, and a test over realizations where there are
    enough of them.
    """
    count = len(values)
    mean, offsets = values.mean(axis=0), values.mean(axis=1)
    size = float(np.sqrt(np.mean(mean**2)))
    variance = float(np.mean(np.einsum("rt,rt->t", values, values) - count * mean**2)) / max(
        count - 1, 1
    )
    expected = math.sqrt(max(0.0, variance) / count)
    if count < TOLD_BY_FEW:
        return MeanLeft(size, expected, math.nan, False)
    ratio = size / expected if expected > 0 else math.inf
    offset, error = abs(float(offsets.mean())), float(offsets.std(ddof=1)) / math.sqrt(count)
    if offset > 0 and p_value(offset, error, count) < SIGNIFICANT / 10:
        # A common offset shows in the means of realizations long before it does at single times.
        return MeanLeft(size, expected, max(ratio, offset / error if error > 0 else math.inf), True)
    beyond = ratio > FAULTS["mean-torque"].limit
    tested = count < MIN_TESTED_REALIZATIONS or (
        beyond and p_value_of(_by_others(values)) < SIGNIFICANT
    )
    return MeanLeft(size, expected, ratio, beyond and tested)


def _by_others(values: Array) -> Array:
    """Return products of each realization with the mean of the others, neighbours left out.

    They are above zero if the realizations share a mean.
    """
    place = np.arange(len(values))
    near = np.abs(np.subtract.outer(place, place)) <= 1
    return np.asarray(np.where(near, 0.0, values @ values.T).sum(axis=1))


def still_samples(angle: Array) -> NDArray[np.intp]:
    """Samples at which the angle, shape (realization, time), does not move in any realization."""
    power = np.einsum("rt,rt->t", angle, angle)
    return np.flatnonzero(power < STILL * power.mean())


def angle_inflation(angle: Array, sampling_rate: float) -> Array:
    """Return the variance inflation of a regression on the angle by velocity and acceleration.

    The factors have shape (window,). From second moments of the angle (realization, time) over
    realizations and windows, longer where these are few. It is 1 to 10 where noise, pulses or sines
    move a joint, and infinite where it rings freely or moves at one frequency.
    """
    angle = angle[:: max(1, len(angle) // SEVERAL)]
    step = max(1, min(round(STEP_S * sampling_rate), (angle.shape[1] - 1) // 2))
    reach = max(WINDOW_S, 1 / len(angle))
    before, now, after = angle[:, : -2 * step], angle[:, step:-step], angle[:, 2 * step :]
    motion = np.stack([now, after - before, after - 2 * now + before])
    half = max(0, min(round(reach * sampling_rate), (now.shape[1] - 1) // 2))
    moments = sliding_sum(np.einsum("art,brt->tab", motion, motion), half, half)[
        half : now.shape[1] - half : max(1, half)
    ]
    scale = np.sqrt(np.einsum("taa->ta", moments))
    scale[scale == 0] = np.inf
    correlation = moments / (scale[:, :, None] * scale[:, None, :])
    correlation[:, range(3), range(3)] = 1 + RIDGE
    return np.asarray(np.linalg.inv(correlation)[:, 0, 0])
