"""Errors of estimates in repeated trials, and the coverage of their bands.

Each function takes weights of the trials, one set or many, which also serve for a bootstrap.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tvsysid.errors import InputError
from tvsysid.numerics import Array

Value = Any  # a number; with many sets of weights an array with one for each


def _checked(estimates: ArrayLike, over_time: ArrayLike | None = None) -> tuple[Array, Array]:
    """Return estimates as (trial, time), and what has a value for each time.

    By default, that is the mean over trials.
    """
    values = np.asarray(estimates, dtype=np.float64)
    own = np.mean(values, axis=0) if over_time is None else np.asarray(over_time, np.float64)
    if values.ndim != 2 or values.size == 0 or own.shape != values.shape[1:]:
        raise InputError(
            f"expected estimates of axes (trial, time), got shape {values.shape}, and one value "
            f"for each time, got shape {own.shape}"
        )
    return values, own


def _errors(estimates: ArrayLike, truth: ArrayLike | None = None) -> Array:
    """Return the errors of estimates at times with an estimate in every trial.

    Without a truth, they are the deviations from the mean over trials. If there is no such time,
    each trial has a single NaN.
    """
    values, true = _checked(estimates, truth)
    known = np.isfinite(values).all(axis=0)
    return (values - true)[:, known] if known.any() else np.full((len(values), 1), np.nan)


def weighted_mean(values: ArrayLike, weights: ArrayLike | None = None) -> Array:
    """Return the mean over trials, the first axis, of shape (...).

    Weights of shape (trial,) may have any sum; None weighs all alike. Many sets of weights, of
    shape (draw, trial), give a mean for each, of shape (draw, ...).

    Examples
    --------
    >>> weighted_mean([1.0, 4.0], [[1, 1], [2, 0], [1, 2]])
    array([2.5, 1. , 3. ])
    """
    array = np.asarray(values, dtype=np.float64)
    shares = np.ones(len(array)) if weights is None else np.asarray(weights, dtype=np.float64)
    return (shares / shares.sum(axis=-1, keepdims=True)) @ array


def _mean_square(errors: Array, weights: ArrayLike | None) -> Array:
    """Return the mean over time and trials of the square."""
    return weighted_mean(np.mean(np.square(errors), axis=1), weights)


def _square_of_mean(errors: Array, weights: ArrayLike | None) -> Array:
    """Return the mean over time of the square of the mean over trials."""
    return np.mean(np.square(weighted_mean(errors, weights)), axis=-1)


def bias_error(estimates: ArrayLike, truth: ArrayLike, weights: ArrayLike | None = None) -> Value:
    r"""Return the root mean square over time of the mean estimate's error.

    .. math:: \sqrt{\frac1T \sum_i \left(\overline{\hat K}(i) - K(i)\right)^2}

    Equation 22 of van de Ruit et al. 2021. With M trials its square contains the random error's
    square over M.

    Estimates have the shape (trial, time), the truth (time,), the weights that of
    :func:`weighted_mean`; many sets of weights give one value each. NaN if no time has an estimate
    in every trial.

    Examples
    --------
    >>> float(bias_error([[1.0, 2.0], [3.0, 4.0]], [0.0, 3.0]))
    1.4142135623730951
    """
    return np.sqrt(_square_of_mean(_errors(estimates, truth), weights))[()]


def debiased_bias_error(
    estimates: ArrayLike, truth: ArrayLike, weights: ArrayLike | None = None
) -> Value:
    r"""Return the bias error without the part that the random error adds.

    .. math:: \sqrt{\max\left(0, Err_{bias}^2 - Err_{random}^2 / (M - 1)\right)}

    The mean of M trials has their variance over M. The square of the random error, which divides by
    M, is that variance times (M - 1) / M. Arguments and result are those of :func:`bias_error`; NaN
    for a single trial.
    """
    others = len(_checked(estimates)[0]) - 1 or np.nan
    random_part = np.square(random_error(estimates, weights)) / others
    squares = np.square(bias_error(estimates, truth, weights)) - random_part
    return np.sqrt(np.maximum(0.0, squares))[()]


def mean_bias(estimates: ArrayLike, truth: ArrayLike, weights: ArrayLike | None = None) -> Value:
    """Return the mean over time of the mean estimate's error, with its sign.

    Arguments and result are those of :func:`bias_error`.

    Examples
    --------
    >>> float(mean_bias([[1.0, 2.0], [3.0, 4.0]], [0.0, 3.0]))
    1.0
    """
    return weighted_mean(np.mean(_errors(estimates, truth), axis=1), weights)[()]


def random_error(estimates: ArrayLike, weights: ArrayLike | None = None) -> Value:
    r"""Return the root mean square, over time and trials, of the deviation from the mean estimate.

    .. math:: \sqrt{\frac{1}{M T} \sum_{i, r} \left(\hat K(i, r) - \overline{\hat K}(i)\right)^2}

    Equation 23 of van de Ruit et al. 2021. Arguments and result are those of :func:`bias_error`.

    Examples
    --------
    >>> float(random_error([[1.0, 2.0], [3.0, 4.0]]))
    1.0
    """
    deviations = _errors(estimates)
    squares = _mean_square(deviations, weights) - _square_of_mean(deviations, weights)
    return np.sqrt(np.maximum(0.0, squares))[()]


def total_error(estimates: ArrayLike, truth: ArrayLike, weights: ArrayLike | None = None) -> Value:
    r"""Return the root mean square, over time and trials, of the error.

    Its square is the sum of the squares of bias error and random error.

    .. math:: \sqrt{\frac{1}{M T} \sum_{i, r} \left(\hat K(i, r) - K(i)\right)^2}

    Equation 24 of van de Ruit et al. 2021. Arguments and result are those of :func:`bias_error`.

    Examples
    --------
    >>> float(total_error([[1.0, 2.0], [3.0, 4.0]], [0.0, 3.0]))
    1.7320508075688772
    """
    return np.sqrt(_mean_square(_errors(estimates, truth), weights))[()]


def rise_time(
    time: ArrayLike,
    estimates: ArrayLike,
    low: float = 60.0,
    high: float = 140.0,
    switch: float = 0.5,
    within: float = 0.4,
    weights: ArrayLike | None = None,
) -> Value:
    """Return the time from where the mean estimate exceeds one level to where it exceeds another.

    The levels are by default 10 and 90 % of the step. Only times within so many seconds
    (``within``) of the known upward ``switch`` count, and the lower crossing is the last one before
    the upper, because noise makes early crossings (van de Ruit et al. 2021, section 3.3).

    Times (time,) and result are in s, estimates have the shape (trial, time), weights that of
    :func:`weighted_mean`; many sets of weights give one value each. NaN if a level is not crossed.

    Examples
    --------
    >>> time = np.arange(5) / 10 + 0.3
    >>> float(rise_time(time, [[50.0, 50.0, 70.0, 130.0, 150.0]]))
    0.2
    """
    values, times = _checked(estimates, time)
    near = np.abs(times - switch) <= within + 1e-9
    times, mean = times[near], weighted_mean(values[:, near], weights)
    above = mean > high
    first = np.argmax(above, axis=-1)
    below = (mean <= low) & (np.arange(len(times)) < first[..., None])
    last = len(times) - 1 - np.argmax(below[..., ::-1], axis=-1)
    crossed = above.any(axis=-1) & below.any(axis=-1)
    risen = times[first] - times[np.where(crossed, last + 1, 0)]
    return np.where(crossed, np.round(risen, 12), np.nan)[()]


def coverage(
    lower: ArrayLike, upper: ArrayLike, truth: ArrayLike, weights: ArrayLike | None = None
) -> Value:
    """Return the percentage of trials and times at which a band holds the truth, edges included.

    The band's edges have the shape (trial, time), the truth (time,), the weights that of
    :func:`weighted_mean`. Times at which an edge is NaN are left out in that trial; NaN if there is
    no band at all. The best value is the band's own level: a higher one means too wide a band.

    Raises
    ------
    InputError
        If the shapes do not fit.

    Examples
    --------
    >>> float(coverage([[0.0, 1.0], [2.0, 1.0]], [[2.0, 3.0], [4.0, 3.0]], [1.0, 2.0]))
    75.0
    """
    (low, true), (high, _) = _checked(lower, truth), _checked(upper, truth)
    known = np.isfinite(low) & np.isfinite(high)
    return share_covered(np.where(known, (low <= true) & (true <= high), np.nan), weights)


def share_covered(covered: ArrayLike, weights: ArrayLike | None = None) -> Value:
    """Return the coverage from whether each band holds the truth.

    ``covered`` (trial, time) is 1 where the band holds the truth, 0 where it does not, and NaN
    where there is no band. Weights and result are those of :func:`coverage`.

    Examples
    --------
    >>> float(share_covered([[1.0, 0.0, np.nan], [1.0, 1.0, np.nan]]))
    75.0
    """
    held = np.asarray(covered, dtype=np.float64)
    known = np.isfinite(held)
    counts = weighted_mean(np.stack([np.nansum(held, axis=1), known.sum(axis=1)], axis=-1), weights)
    there = counts[..., 1] > 0
    return np.where(there, 100 * counts[..., 0] / np.where(there, counts[..., 1], 1.0), np.nan)[()]
