"""Test over realizations, predict by least squares, and whiten; arrays only."""

from __future__ import annotations

import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import convolve1d
from scipy.special import stdtr

from tvsysid.methods.cascade.reflex_test import MIN_TESTED_REALIZATIONS
from tvsysid.numerics.pseudoinverse import solve_regularized
from tvsysid.signals import Array

SIGNIFICANT = 1e-5  # p-value
FOLDS = 4  # of cross-validation


def p_value(mean: float, error: float, count: int) -> float:
    """Return the two-sided p-value of a mean over independent realizations (Student's t).

    ``error`` is the standard error of the mean. Too few realizations have a p-value of 1.
    """
    if count < MIN_TESTED_REALIZATIONS:
        return 1.0
    if error == 0:
        return float(mean == 0)
    return float(2 * stdtr(count - 1, -abs(mean) / error))


def p_value_of(scores: Array) -> float:
    """Return the two-sided p-value of the mean of scores, shape (realization,)."""
    count = len(scores)
    return p_value(float(scores.mean()), float(scores.std(ddof=1)) / math.sqrt(count), count)


def gains(target: Array, regressors: Array) -> Array:
    """Return by how much regressors lower the sum of squares of each held-out realization.

    The target has shape (realization, time), and the regressors (regressor, realization, time).
    The gain is negative where they predict nothing.
    """
    rows = np.ascontiguousarray(regressors.transpose(1, 0, 2))
    grams, moments = rows @ rows.transpose(0, 2, 1), (rows @ target[..., None])[..., 0]
    gain = np.empty(len(target))
    # Neighbours are held out together, because slow noise is alike in them.
    for out in np.array_split(np.arange(len(target)), FOLDS):
        others = (np.delete(each, out, axis=0).sum(axis=0) for each in (grams, moments))
        weights = solve_regularized(*others)
        gain[out] = (2 * moments[out] - grams[out] @ weights) @ weights
    return gain


def gained_share(target: Array, regressors: Array) -> float:
    """Return the share of a signal that regressors predict in held-out realizations."""
    total = float(np.sum(target**2))
    return float(gains(target, regressors).sum()) / total if total > 0 else math.nan


def without(target: Array, regressors: Array) -> Array:
    """Return a signal (..., realization, time) less what regressors explain of it."""
    rows = regressors.reshape(len(regressors), -1)
    weights = solve_regularized(rows @ rows.T, rows @ target.reshape(-1, rows.shape[1]).T)
    return target - (weights.T @ rows).reshape(target.shape)


def prediction_error(signal: Array, order: int) -> Array:
    """Return the prediction-error filter of a signal (realization, time), shape (order + 1,)."""
    rows = sliding_window_view(signal, order + 1, axis=1).reshape(-1, order + 1)
    gram = rows.T @ rows
    weights = solve_regularized(gram[:order, :order], gram[:order, order])
    return np.concatenate([[1.0], -weights[::-1]])


def filtered(signal: Array, taps: Array) -> Array:
    """Return a signal (..., time) through a causal filter, where all its samples are known."""
    known = convolve1d(signal, taps, axis=-1, origin=-(len(taps) // 2))
    return np.asarray(known[..., len(taps) - 1 :])


def innovations(signal: Array, order: int) -> Array:
    """Return what the past does not predict of a signal, shape (realization, time - order)."""
    return filtered(signal, prediction_error(signal, order))


def over_usual(values: Array, quantile: float) -> Array:
    """Return values over one of their quantiles, or zero where that is zero."""
    usual = float(np.quantile(values, quantile))
    return values / usual if usual > 0 else np.zeros_like(values)
