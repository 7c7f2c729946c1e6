"""Errors of the stiffness estimated in repeated trials, against the truth or about their own mean."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tvsysid.errors import InputError

Array = NDArray[np.float64]


def _trials(estimates: ArrayLike) -> tuple[Array, NDArray[np.bool_]]:
    """Estimates as (trial, time), and the times at which every trial has one."""
    values = np.asarray(estimates, dtype=np.float64)
    if values.ndim != 2 or values.size == 0:
        raise InputError(f"estimates: expected an array of axes (trial, time), got shape {values.shape}")
    return values, np.asarray(np.isfinite(values).all(axis=0))


def _against(estimates: ArrayLike, truth: ArrayLike) -> tuple[Array, Array]:
    values, known = _trials(estimates)
    true = np.asarray(truth, dtype=np.float64)
    if true.shape != values.shape[1:]:
        raise InputError(f"truth: expected one value for each of {values.shape[1]} times, got shape {true.shape}")
    return values[:, known], true[known]


def _root_mean_square(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else math.nan


def left_out(estimates: ArrayLike) -> int:
    """Times that the errors leave out, because some trial has no estimate there (NaN).

    Parameters
    ----------
    estimates
        Shape (trial, time).

    Examples
    --------
    >>> left_out([[np.nan, 1.0, 2.0], [np.nan, 1.0, np.nan]])
    2
    """
    return int(np.count_nonzero(~_trials(estimates)[1]))


def bias_error(estimates: ArrayLike, truth: ArrayLike) -> float:
    r"""Root mean square over time of the mean estimate's error.

    .. math:: \sqrt{\frac1T \sum_i \left(\overline{\hat K}(i) - K(i)\right)^2}

    Equation 22 of van de Ruit et al. 2021. With M trials its square contains the random error's square over M.

    Parameters
    ----------
    estimates
        Shape (trial, time).
    truth
        Shape (time,).

    Returns
    -------
    float
        In the unit of the estimates; NaN if no time has an estimate in every trial.

    Examples
    --------
    >>> bias_error([[1.0, 2.0], [3.0, 4.0]], [0.0, 3.0])
    1.4142135623730951
    """
    values, true = _against(estimates, truth)
    return _root_mean_square(values.mean(axis=0) - true)


def debiased_bias_error(estimates: ArrayLike, truth: ArrayLike) -> float:
    r"""Bias error without what the random error contributes to it.

    .. math:: \sqrt{\max\left(0, Err_{bias}^2 - Err_{random}^2 / (M - 1)\right)}

    The mean of M trials has their variance over M, and the random error, which divides by M, is that variance times
    (M - 1) / M. Parameters and result are those of :func:`bias_error`; NaN for a single trial, which does not tell, and
    where no time has an estimate in every trial.
    """
    trials = len(_trials(estimates)[0])
    squared = bias_error(estimates, truth) ** 2
    if trials < 2 or math.isnan(squared):
        return math.nan
    return math.sqrt(max(0.0, squared - random_error(estimates) ** 2 / (trials - 1)))


def random_error(estimates: ArrayLike) -> float:
    r"""Root mean square, over time and trials, of the deviation from the mean estimate.

    .. math:: \sqrt{\frac{1}{M T} \sum_{i, r} \left(\hat K(i, r) - \overline{\hat K}(i)\right)^2}

    Equation 23 of van de Ruit et al. 2021.

    Parameters
    ----------
    estimates
        Shape (trial, time).

    Returns
    -------
    float
        In the unit of the estimates; NaN if no time has an estimate in every trial.

    Examples
    --------
    >>> random_error([[1.0, 2.0], [3.0, 4.0]])
    1.0
    """
    values, known = _trials(estimates)
    return _root_mean_square(values[:, known] - values[:, known].mean(axis=0))


def total_error(estimates: ArrayLike, truth: ArrayLike) -> float:
    r"""Root mean square, over time and trials, of the error; its square is that of bias plus that of random error.

    .. math:: \sqrt{\frac{1}{M T} \sum_{i, r} \left(\hat K(i, r) - K(i)\right)^2}

    Equation 24 of van de Ruit et al. 2021. Parameters and result are those of :func:`bias_error`.

    Examples
    --------
    >>> total_error([[1.0, 2.0], [3.0, 4.0]], [0.0, 3.0])
    1.7320508075688772
    """
    values, true = _against(estimates, truth)
    return _root_mean_square(values - true)


def rise_time(
    time: ArrayLike,
    estimates: ArrayLike,
    low: float = 60.0,
    high: float = 140.0,
    switch: float = 0.5,
    within: float = 0.4,
) -> float:
    """Time from where the mean estimate first exceeds one level to where it first exceeds another.

    Searched around the known upward switch only, and the lower crossing is the last one before the upper, for noise
    makes early crossings that mean nothing (van de Ruit et al. 2021, section 3.3).

    Parameters
    ----------
    time
        In s, shape (time,).
    estimates
        Shape (trial, time).
    low, high
        Levels, 10 and 90 % of the step.
    switch
        Time of the true upward switch in s.
    within
        Seconds about the switch that are searched.

    Returns
    -------
    float
        In s; NaN if a level is not crossed there.

    Examples
    --------
    >>> time = np.arange(5) / 10 + 0.3
    >>> rise_time(time, [[50.0, 50.0, 70.0, 130.0, 150.0]])
    0.2
    """
    values, _ = _trials(estimates)
    times = np.asarray(time, dtype=np.float64)
    if times.shape != values.shape[1:]:
        raise InputError(f"time: expected one value for each of {values.shape[1]} estimates, got shape {times.shape}")
    near = np.abs(times - switch) <= within + 1e-9
    times, mean = times[near], values[:, near].mean(axis=0)
    above = np.flatnonzero(mean > high)
    if not len(above):
        return math.nan
    below = np.flatnonzero(mean[: above[0]] <= low)
    if not len(below):
        return math.nan
    return round(float(times[above[0]] - times[below[-1] + 1]), 12)
