r"""Predict an angle from a reference: an instrument where noise also moves the angle.

.. math:: \hat u_r(t) = \sum_{p=0}^{2H} \sum_{\tau} c_{p\tau}\, F_p(t)\, d_r(t - \tau)

with d the reference, F the Fourier series of a realization, and lags from -0.04 s (as far as a
decimator's filter reaches) to 0.3 s. A function of the reference alone is independent of the
noise, whatever its coefficients. Its accuracy affects the random error only.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tvsysid.numerics import Array
from tvsysid.numerics.bases import FourierSeries
from tvsysid.numerics.gaussian import Moments, ridge, solve
from tvsysid.numerics.moments import convolve_lags, diagonal_moments, expanded, window_moments

# The angle is predicted from samples of the reference up to so much later, and earlier.
MAX_AFTER_S, MAX_BEFORE_S = 0.04, 0.30
HARMONICS = 4
DECAY_S = 0.08  # lag over which the prior variance of a coefficient falls by a factor e
MIN_VARIANCE = 1e-3  # added to that variance, relative to lag 0, so that long lags keep some
BLOCKS = 5  # groups of realizations, each predicted from the others
# share of the angle that a reference predicts below which short windows cannot use it
MIN_PREDICTED = 0.1


def lag_samples(rate: float) -> tuple[int, int]:
    """Return how many samples the reference needs after the angle, and before it."""
    return round(MAX_AFTER_S * rate), round(MAX_BEFORE_S * rate)


def realization_groups(trials: NDArray[np.int64], onsets: Array) -> NDArray[np.int64]:
    """Return the group of each realization; each group is predicted from the others.

    Consecutive realizations share a group, because the noise of neighbours is alike. A realization
    that was drawn twice is in one group.
    """
    distinct, place = np.unique(np.stack([trials, onsets], axis=1), axis=0, return_inverse=True)
    return place.ravel() * min(BLOCKS, len(distinct)) // len(distinct)


def predicted(
    reference: Array, angle: Array, core: slice, rate: float, groups: NDArray[np.int64]
) -> Array:
    """Return the angle (realization, time) that a reference predicts, at all its samples.

    The reference has as many more samples at either end as the lags need (:func:`lag_samples`).
    The coefficients of a realization are fitted to the ``core`` of the other ``groups``
    (realization,), so its noise does not enter its prediction. Only the size of the ridge is chosen
    for all realizations together, by evidence.
    """
    after, before = lag_samples(rate)
    period = core.stop - core.start
    functions = FourierSeries(HARMONICS)((np.arange(angle.shape[1]) - core.start) / period)
    lags = np.maximum(np.arange(-after, before + 1), 0) / rate
    harmonics = np.r_[0, np.repeat(np.arange(1, HARMONICS + 1), 2)]
    # Relative prior standard deviations of the coefficients, (lag x function,)
    variances = np.outer(np.exp(-lags / DECAY_S) + MIN_VARIANCE, 1 / (1 + harmonics**2))
    deviation = np.sqrt(variances).ravel()
    parts = []
    for group in np.unique(groups):
        own = groups == group
        lagged = reference[own, core.start : core.stop + after + before]
        target = angle[own, core]
        moments = len(target) * window_moments(lagged, lagged, before, after)[:, ::-1, ::-1]
        gram = expanded(moments, functions[core]) * np.outer(deviation, deviation)
        cross = len(target) * diagonal_moments(target, lagged, after + before)[:, ::-1]
        cross = (cross.T @ functions[core]).ravel() * deviation
        parts.append((own, Moments(gram, cross, float(np.vdot(target, target)), target.size)))
    whole = Moments(*(sum(each) for each in zip(*(part for _, part in parts), strict=True)))
    found = ridge(whole)
    power = max(float(found.mean @ found.mean), np.finfo(float).tiny)
    precision = np.full(len(deviation), found.noise_variance * found.effective / power)
    out = np.empty_like(angle)
    for own, part in parts:
        coefficients = solve(whole.without(part), precision).mean * deviation
        weights = functions @ coefficients.reshape(after + before + 1, -1).T
        out[own] = convolve_lags(reference[own], weights)
    return out
