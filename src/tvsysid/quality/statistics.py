"""Tests over realizations, least squares and linear prediction; arrays only."""

from __future__ import annotations

import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import lfilter
from scipy.special import stdtr

from tvsysid.signals import Array

LEAST_REALIZATIONS = 8
"""Fewer have no scatter to judge by."""
SIGNIFICANT = 1e-5
"""Probability below which noise is not taken for the cause of what is seen."""
FOLDS = 4
RIDGE = 1e-9
"""Share of the regressors' mean power that keeps their fit from falling apart."""


def p_value(mean: float, error: float, count: int) -> float:
    """Probability of so large a mean of independent realizations by chance, from its standard error (Student's t).

    One where there are fewer than eight realizations.
    """
    if count < LEAST_REALIZATIONS:
        return 1.0
    if error == 0:
        return float(mean == 0)
    return float(2 * stdtr(count - 1, -abs(mean) / error))


def p_value_of(scores: Array) -> float:
    """Probability that scores of independent realizations, shape (realization,), have so large a mean by chance."""
    count = len(scores)
    if count < LEAST_REALIZATIONS:
        return 1.0
    return p_value(float(scores.mean()), float(scores.std(ddof=1)) / math.sqrt(count), count)


def gained(target: Array, regressors: Array) -> tuple[float, float]:
    """Share of a signal's variance that regressors predict in realizations they were not fitted to, and its p-value.

    The signal is of shape (realization, time), regressors of shape (regressor, realization, time). The share is below
    zero where they predict nothing; the p-value comes from the scatter of the gain over realizations.
    """
    if len(target) < LEAST_REALIZATIONS or not target.shape[1]:
        return math.nan, 1.0
    gain = gains(target, regressors)
    total = float(np.sum(target**2))
    return float(gain.sum()) / total if total > 0 else math.nan, p_value_of(gain)


def gains(target: Array, regressors: Array) -> Array:
    """Sum of squares that regressors take from each realization, fitted to others; shapes as above."""
    count = len(target)
    rows = np.ascontiguousarray(regressors.transpose(1, 0, 2))
    grams = rows @ rows.transpose(0, 2, 1)
    moments = (rows @ target[..., None])[..., 0]
    taken = np.empty(count)
    # Neighbours are left out together: slow noise is alike in them.
    for out in np.array_split(np.arange(count), FOLDS):
        kept = np.setdiff1d(np.arange(count), out)
        weights = solved(grams[kept].sum(axis=0), moments[kept].sum(axis=0))
        taken[out] = 2 * moments[out] @ weights - np.einsum("a,rab,b->r", weights, grams[out], weights)
    return taken


def without(target: Array, regressors: Array) -> Array:
    """Signal less what regressors explain of it; shapes (..., realization, time) and (regressor, realization, time)."""
    rows = regressors.reshape(len(regressors), -1)
    weights = solved(rows @ rows.T, rows @ target.reshape(-1, rows.shape[1]).T)
    return target - (weights.T @ rows).reshape(target.shape)


def solved(gram: Array, moments: Array) -> Array:
    """Least squares from second moments, safe where regressors are nearly the same."""
    ridge = RIDGE * np.trace(gram) / len(gram) + np.finfo(float).tiny
    return np.asarray(np.linalg.solve(gram + ridge * np.eye(len(gram)), moments))


def prediction_error(signal: Array, order: int) -> Array:
    """Filter that leaves what so many samples of the past do not predict of a signal (realization, time)."""
    rows = sliding_window_view(signal, order + 1, axis=1).reshape(-1, order + 1)
    gram = rows.T @ rows
    return np.concatenate([[1.0], -solved(gram[:order, :order], gram[:order, order])[::-1]])


def innovations(signal: Array, order: int) -> Array:
    """What so many samples of a signal's past do not predict, shape (realization, time - order)."""
    return np.asarray(lfilter(prediction_error(signal, order), 1.0, signal, axis=1)[:, order:])


def over_usual(values: Array, quantile: float) -> Array:
    """Values over one of their quantiles; zero where that is."""
    usual = float(np.quantile(values, quantile))
    return values / usual if usual > 0 else np.zeros_like(values)
