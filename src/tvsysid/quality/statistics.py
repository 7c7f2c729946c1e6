"""Test over realizations, predict by least squares, and whiten; arrays only."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import convolve1d
from scipy.special import stdtrit

from tvsysid.methods.cascade.reflex_test import MIN_TESTED_REALIZATIONS
from tvsysid.numerics.pseudoinverse import solve_regularized
from tvsysid.signals import Array

SIGNIFICANT = 1e-5  # p-value
FOLDS = 4  # of cross-validation
TINY = np.finfo(float).tiny


def is_significant(mean: float, error: float, count: int) -> bool:
    """Test a mean over independent realizations (Student's t, two-sided).

    ``error`` is the standard error of the mean. Too few realizations show nothing.
    """
    limit = -error * stdtrit(count - 1, SIGNIFICANT / 2)
    return count >= MIN_TESTED_REALIZATIONS and bool(abs(mean) > limit)


def is_mean_significant(scores: Array) -> bool:
    """Test the mean of scores, shape (realization,)."""
    count = len(scores)
    return is_significant(scores.mean(), scores.std(ddof=1) / math.sqrt(count), count)


def lagged(signal: Array, lags: Iterable[int], start: int, stop: int) -> Array:
    """Return samples ``start`` to ``stop`` of a signal as they were so many samples earlier.

    The shape is (lag, realization, time).
    """
    return np.stack([signal[:, start - lag : stop - lag] for lag in lags])


def gains(target: Array, regressors: Array) -> Array:
    """Return by how much regressors lower the sum of squares of each held-out realization.

    The target has shape (realization, time), and the regressors (regressor, realization, time).
    The gain is negative where they predict nothing.
    """
    rows = regressors.transpose(1, 0, 2)
    grams = rows @ rows.transpose(0, 2, 1)
    moments = (rows @ target[..., None])[..., 0]
    gain = np.empty(len(target))
    # Neighbours are held out together, because slow noise is alike in them.
    for out in np.array_split(np.arange(len(target)), FOLDS):
        others = (np.delete(each, out, axis=0).sum(axis=0) for each in (grams, moments))
        weights = solve_regularized(*others)
        gain[out] = (2 * moments[out] - grams[out] @ weights) @ weights
    return gain


def gained_share(target: Array, regressors: Array, known: Array | None = None) -> float:
    """Return the share of a signal that regressors predict in held-out realizations.

    With ``known`` regressors, both are first adjusted for these.
    """
    if known is not None:
        target, regressors = (without(each, known) for each in (target, regressors))
    return float(gains(target, regressors).sum() / (np.sum(target**2) + TINY))


def without(target: Array, regressors: Array) -> Array:
    """Return a signal (..., realization, time) less what regressors explain of it."""
    rows = regressors.reshape(len(regressors), -1)
    weights = solve_regularized(rows @ rows.T, rows @ target.reshape(-1, rows.shape[1]).T)
    return target - (weights.T @ rows).reshape(target.shape)


def whitener(signal: Array, order: int) -> Array:
    """Return the filter that leaves what the past of a signal does not predict, (order + 1,)."""
    rows = sliding_window_view(signal, order + 1, axis=1).reshape(-1, order + 1)
    gram = rows.T @ rows
    return np.append(1.0, -solve_regularized(gram[:-1, :-1], gram[:-1, -1])[::-1])


def filtered(signal: Array, taps: Array) -> Array:
    """Return a signal (..., time) through a causal filter, where all its samples are known."""
    known = convolve1d(signal, taps, axis=-1, origin=-(len(taps) // 2))
    return known[..., len(taps) - 1 :]


def over_usual(values: Array, quantile: float) -> Array:
    """Return values over one of their quantiles, or zero where that is zero."""
    usual = np.quantile(values, quantile)
    return values / usual if usual > 0 else np.zeros_like(values)
