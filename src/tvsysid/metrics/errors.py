"""Errors of what was estimated in repeated trials, against the truth or about their own mean.

Coverage of bands.

Each takes weights of the trials, one set or many, so that its bootstrap over trials is the same
code.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tvsysid.errors import InputError
from tvsysid.numerics import Array

Value = Any  # a number; with many sets of weights an array with one for each


def _trials(estimates: ArrayLike) -> tuple[Array, NDArray[np.bool_]]:
    """Estimates as (trial, time), and the times at which every trial has one."""
    values = np.asarray(estimates, dtype=np.float64)
    if values.ndim != 2 or values.size == 0:
        raise InputError(
            f"estimates: expected an array of axes (trial, time), got shape {values.shape}"
        )
    return values, np.asarray(np.isfinite(values).all(axis=0))


def _against(estimates: ArrayLike, truth: ArrayLike) -> tuple[Array, Array]:
    values, known = _trials(estimates)
    true = np.asarray(truth, dtype=np.float64)
    if true.shape != values.shape[1:]:
        raise InputError(
            f"truth: expected one value for each of {values.shape[1]} times, got shape {true.shape}"
        )
    return values[:, known], true[known]


def weighted_mean(values: ArrayLike, weights: ArrayLike | None = None) -> Array:
    """Mean over trials, the first axis; shape (...), or (draw, ...) for many sets of weights.

    Weights may have any sum, and the shape (trial,), or (draw, trial) for many sets; None weighs
    all alike.

    Examples
    --------
    >>> weighted_mean([1.0, 4.0], [[1, 1], [2, 0], [1, 2]])
    array([2.5, 1. , 3. ])
    """
    array = np.asarray(values, dtype=np.float64)
    if weights is None:
        return np.asarray(array.mean(axis=0))
    shares = np.asarray(weights, dtype=np.float64)
    return np.asarray((shares / shares.sum(axis=-1, keepdims=True)) @ array)


def _power_of_mean(values: Array, weights: ArrayLike | None) -> Array:
    """Mean over time of the square of the mean over trials; NaN of no time."""
    if not values.shape[1]:
        return np.full(np.shape(weights)[:-1] if weights is not None else (), np.nan)
    if weights is None:
        return np.asarray(np.mean(np.square(values.mean(axis=0))))
    # A quadratic form of the weights, which spares an array of draws times times.
    shares = np.asarray(weights, dtype=np.float64)
    shares = shares / shares.sum(axis=-1, keepdims=True)
    return np.asarray(np.sum((shares @ (values @ values.T / values.shape[1])) * shares, axis=-1))


def _mean_power(values: Array, weights: ArrayLike | None) -> Array:
    """Mean over time and trials of the square; NaN of no time."""
    if not values.shape[1]:
        return _power_of_mean(values, weights)
    return weighted_mean(np.mean(np.square(values), axis=1), weights)


def _root(squares: Array) -> Value:
    return np.sqrt(np.maximum(squares, 0.0))[()]


def left_out(estimates: ArrayLike) -> int:
    """Times that the errors leave out, because some trial of (trial, time) has no estimate there (NaN).

    Examples
    --------
    >>> left_out([[np.nan, 1.0, 2.0], [np.nan, 1.0, np.nan]])
    2
    """
    return int(np.count_nonzero(~_trials(estimates)[1]))


def bias_error(estimates: ArrayLike, truth: ArrayLike, weights: ArrayLike | None = None) -> Value:
    r"""Root mean square over time of the mean estimate's error.

    .. math:: \sqrt{\frac1T \sum_i \left(\overline{\hat K}(i) - K(i)\right)^2}

    Equation 22 of van de Ruit et al. 2021. With M trials its square contains the random error's
    square over M.

    From estimates (trial, time) and truth (time,), in their unit; NaN if no time has an estimate in
    every trial. The weights are those of :func:`weighted_mean`; for many sets of them there is one
    value each.

    Examples
    --------
    >>> float(bias_error([[1.0, 2.0], [3.0, 4.0]], [0.0, 3.0]))
    1.4142135623730951
    """
    values, true = _against(estimates, truth)
    return _root(_power_of_mean(values - true, weights))


def debiased_bias_error(
    estimates: ArrayLike, truth: ArrayLike, weights: ArrayLike | None = None
) -> Value:
    r"""Bias error without what the random error contributes to it.

    .. math:: \sqrt{\max\left(0, Err_{bias}^2 - Err_{random}^2 / (M - 1)\right)}

    The mean of M trials has their variance over M, and the random error, which divides by M, is
    that variance times (M - 1) / M. Arguments and result are those of :func:`bias_error`; NaN
    for a single trial, which does not tell, and where no time has an estimate in every trial.
    """
    trials = len(_trials(estimates)[0])
    if trials < 2:
        return np.full(np.shape(weights)[:-1] if weights is not None else (), np.nan)[()]
    part = np.square(random_error(estimates, weights)) / (trials - 1)
    return np.sqrt(np.maximum(0.0, np.square(bias_error(estimates, truth, weights)) - part))[()]


def mean_bias(estimates: ArrayLike, truth: ArrayLike, weights: ArrayLike | None = None) -> Value:
    """Mean over time of the mean estimate's error, with its sign.

    Arguments and result are those of :func:`bias_error`.

    Examples
    --------
    >>> float(mean_bias([[1.0, 2.0], [3.0, 4.0]], [0.0, 3.0]))
    1.0
    """
    values, true = _against(estimates, truth)
    if not values.shape[1]:
        return _power_of_mean(values, weights)
    return weighted_mean(np.mean(values - true, axis=1), weights)[()]


def random_error(estimates: ArrayLike, weights: ArrayLike | None = None) -> Value:
    r"""Root mean square, over time and trials, of the deviation from the mean estimate.

    .. math:: \sqrt{\frac{1}{M T} \sum_{i, r} \left(\hat K(i, r) - \overline{\hat K}(i)\right)^2}

    Equation 23 of van de Ruit et al. 2021. Arguments and result are those of :func:`bias_error`.

    Examples
    --------
    >>> float(random_error([[1.0, 2.0], [3.0, 4.0]]))
    1.0
    """
    values, known = _trials(estimates)
    deviations = values[:, known] - values[:, known].mean(axis=0)
    return _root(_mean_power(deviations, weights) - _power_of_mean(deviations, weights))


def total_error(estimates: ArrayLike, truth: ArrayLike, weights: ArrayLike | None = None) -> Value:
    r"""Root mean square, over time and trials, of the error.

    Its square is that of bias plus that of random error.

    .. math:: \sqrt{\frac{1}{M T} \sum_{i, r} \left(\hat K(i, r) - K(i)\right)^2}

    Equation 24 of van de Ruit et al. 2021. Arguments and result are those of :func:`bias_error`.

    Examples
    --------
    >>> float(total_error([[1.0, 2.0], [3.0, 4.0]], [0.0, 3.0]))
    1.7320508075688772
    """
    values, true = _against(estimates, truth)
    return _root(_mean_power(values - true, weights))


def rise_time(
    time: ArrayLike,
    estimates: ArrayLike,
    low: float = 60.0,
    high: float = 140.0,
    switch: float = 0.5,
    within: float = 0.4,
    weights: ArrayLike | None = None,
) -> Value:
    """Time from where the mean estimate first exceeds one level to where it first exceeds another.

    Searched only so many seconds (``within``) about the known upward ``switch``, and the lower
    crossing is the last one before the upper, for noise makes early crossings that mean nothing
    (van de Ruit et al. 2021, section 3.3).

    From times in s (time,) and estimates (trial, time), in s; NaN if a level is not crossed there.
    The levels are 10 and 90 % of the step; weights are those of :func:`weighted_mean`, and for many
    sets there is one value each.

    Examples
    --------
    >>> time = np.arange(5) / 10 + 0.3
    >>> float(rise_time(time, [[50.0, 50.0, 70.0, 130.0, 150.0]]))
    0.2
    """
    values, _ = _trials(estimates)
    times = np.asarray(time, dtype=np.float64)
    if times.shape != values.shape[1:]:
        raise InputError(
            f"time: expected one value for each of {values.shape[1]} estimates, got shape "
            f"{times.shape}"
        )
    near = np.abs(times - switch) <= within + 1e-9
    times, mean = times[near], weighted_mean(values[:, near], weights)
    places = np.arange(len(times))
    above = mean > high
    first = np.argmax(above, axis=-1)
    below = (mean <= low) & (places < first[..., None])
    last = len(times) - 1 - np.argmax(below[..., ::-1], axis=-1)
    crossed = above.any(axis=-1) & below.any(axis=-1)
    risen = times[first] - times[np.where(crossed, last + 1, 0)]
    return np.where(crossed, np.round(risen, 12), np.nan)[()]


def coverage(
    lower: ArrayLike, upper: ArrayLike, truth: ArrayLike, weights: ArrayLike | None = None
) -> Value:
    """Share in per cent of trials and times at which a band holds the truth, its edges included.

    The band's edges have the shape (trial, time), the truth (time,). Where either edge is NaN there
    is no band, and the time is left out in that trial; NaN where there is no band at all. Best is
    the band's own level: more says that it is too wide. The weights are those of
    :func:`weighted_mean`.

    Raises
    ------
    InputError
        If the shapes do not fit.

    Examples
    --------
    >>> float(coverage([[0.0, 1.0], [2.0, 1.0]], [[2.0, 3.0], [4.0, 3.0]], [1.0, 2.0]))
    75.0
    """
    low, high = np.asarray(lower, dtype=np.float64), np.asarray(upper, dtype=np.float64)
    true = np.asarray(truth, dtype=np.float64)
    if low.ndim != 2 or low.shape != high.shape or low.size == 0 or true.shape != low.shape[1:]:
        raise InputError(
            "coverage: expected lower and upper of axes (trial, time) and a truth for each time, "
            "got shapes "
            f"{low.shape}, {high.shape} and {true.shape}"
        )
    known = np.isfinite(low) & np.isfinite(high)
    return share_covered(np.where(known, (low <= true) & (true <= high), np.nan), weights)


def share_covered(covered: ArrayLike, weights: ArrayLike | None = None) -> Value:
    """Coverage where it is known already whether each band holds the truth.

    ``covered`` (trial, time) is 1 where it does, 0 where not, NaN where there is no band; weights
    and result are those of :func:`coverage`.

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
