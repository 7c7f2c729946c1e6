"""How many standard deviations a band must be wide: at one time, and at all times together.

A level is a probability between 0 and 1; any other raises :class:`InputError`.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence

import numpy as np
from scipy.special import stdtr, stdtrit

from tvsysid.errors import InputError
from tvsysid.numerics import Array


def critical_value(level: float, freedom: Array) -> Array:
    """Multiple of the standard deviation within which Student's t lies with this probability."""
    _check(level)
    # Quantiles are slow, and most freedoms are the same at all times.
    known, place = np.unique(np.minimum(freedom, 1e9), return_inverse=True)
    return stdtrit(known, 0.5 + level / 2)[place].reshape(np.shape(freedom))


def simultaneous_value(level: float, freedom: Array, arc: float) -> Array:
    r"""Return the multiple of the standard deviation for a band that covers all times at once.

    All times of the estimate lie within the band with probability ``level``. The multiple is the
    smaller of two bounds, which both are on the safe side. Šidák's (1967) takes the times as
    independent: the level at each is :math:`level^{1/T}`. The volume of a tube (Naiman 1986; Sun &
    Loader 1994) uses that a smooth estimate hardly changes by the next sample: the chance to leave
    the band is at most

    .. math:: P(|t_\nu| > c) + \frac{\kappa}{\pi}\left(1 + \frac{c^2}{\nu}\right)^{-\nu/2}

    with :math:`\kappa` the :func:`arc_length`; infinite where it is not known.
    """
    _check(level)
    each = critical_value(level ** (1 / max(len(freedom), 1)), freedom)
    if not math.isfinite(arc):
        return each
    return np.minimum(each, _tube(level, np.minimum(freedom, 1e9), arc))


def arc_length(features: Array, covariance: Array) -> float:
    r"""Return the sum in rad of the angles between the errors of an estimate at successive times.

    The cosine of such an angle is the correlation of the two errors.

    .. math:: \kappa = \sum_i \arccos
              \frac{l_i^T C l_{i+1}}{\sqrt{l_i^T C l_i}\sqrt{l_{i+1}^T C l_{i+1}}}

    with l the ``features`` (time, coefficient) that the coefficients are multiplied by, and C
    their covariance.
    """
    mixed = features @ covariance
    own = np.einsum("tc,tc->t", mixed, features)
    next_one = np.einsum("tc,tc->t", mixed[:-1], features[1:])
    scale = np.sqrt(np.maximum(own[:-1] * own[1:], 0.0))
    cosine = next_one[scale > 0] / scale[scale > 0]
    return float(np.sum(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _tube(level: float, freedom: Array, arc: float) -> Array:
    """Solve for c by bisection, for all degrees of freedom at once."""
    low = np.zeros_like(freedom)
    high = np.full_like(freedom, 1e3)
    for _ in range(60):
        middle = (low + high) / 2
        tube = np.exp(-freedom / 2 * np.log1p(middle**2 / freedom))
        outside = 2 * stdtr(freedom, -middle) + arc / np.pi * tube > 1 - level
        low = np.where(outside, middle, low)
        high = np.where(outside, high, middle)
    return high


def _check(level: float) -> None:
    if isinstance(level, str | bool) or not 0 < level < 1:
        raise InputError(
            f"level: expected a probability between 0 and 1, such as 0.95, got {level!r}"
        )


def half_width(band: Sequence[Array] | Array) -> Array:
    """Return half the distance between the lower and the upper limit of a band."""
    lower, upper = band
    return (upper - lower) / 2


def mean_of(values: Array) -> float:
    """Return the mean of the finite values; NaN if there are none."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else float("nan")


def mean_known(values: Array, axis: int = 0) -> Array:
    """Return the mean over an axis without NaN; NaN if all are."""
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):
        mean = np.asarray(values.mean(axis))
        some = np.isnan(mean)  # few: nanmean copies the values
        mean[some] = np.nanmean(np.moveaxis(values, axis, 0)[:, some], axis=0)
    return mean


def mean_and_spread(values: Array) -> tuple[Array, Array]:
    """Return the mean and the standard deviation over the first axis, without NaN.

    Both are NaN if there is no value, the standard deviation also if there is one.
    """
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):
        return mean_known(values), np.nanstd(values, axis=0, ddof=1)
