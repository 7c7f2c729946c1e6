"""Filters that make noise white: an autoregressive model of its covariance over time."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import convolve1d

from tvsysid.numerics import Array

MISFIT_TIME = 0.05  # s over which misfit is correlated, and the strength of the noise is pooled
POOLED_TIME = 0.5  # s, over independent realizations less one: least reach of the pooling
MAX_PREDICTION = 0.25  # s before a sample from which its noise is predicted


def pooling_reach(independent: int, rate: float) -> int:
    """Return the samples to either side over which the strength of the noise is pooled."""
    return round(max(MISFIT_TIME, POOLED_TIME / (independent - 1)) * rate)


def whitening_filters(covariance: Array, independent: int, rate: float, periodic: bool) -> Array:
    """Return filters (time, time) that make noise of a covariance white, with unit variance.

    They predict the noise from the samples before, and divide the prediction error by its strength,
    which is pooled over time.
    """
    times = len(covariance)
    lags = min(round(MAX_PREDICTION * rate), times // 4)
    filters = prediction_errors(covariance, lags, independent)
    reach = min(pooling_reach(independent, rate), (times - 1) // 2)
    window = np.ones(2 * reach + 1)
    mode = "wrap" if periodic else "constant"
    strength = convolve1d(np.sum(filters @ covariance * filters, axis=1), window, mode=mode)
    strength /= convolve1d(np.ones(times), window, mode=mode)
    return filters / np.sqrt(strength)[:, None]


def prediction_errors(covariance: Array, lags: int, independent: int) -> Array:
    """Return filters (time, time) that give noise less its prediction, relative to its error.

    The Bayesian information criterion gives the number of samples that predict the next one. The
    first samples are predicted from the few before them.
    """
    times = len(covariance)
    counts = range(1, lags + 2)
    summed = np.einsum("ttij->ij", sliding_window_view(covariance, (lags + 1, lags + 1)))
    # The last column of the inverse gives the weights, and the prediction error's precision.
    filters = [np.linalg.solve(summed[-each:, -each:], np.eye(each)[-1]) for each in counts]
    samples = independent * (times - lags)
    precisions = [each[-1] for each in filters]
    criterion = np.log(samples) * np.array(counts) - samples * np.log(precisions)
    best = int(np.argmin(criterion))
    out = np.zeros((times, times))
    for time in range(times):
        own = filters[min(time, best)]
        out[time, time + 1 - len(own) : time + 1] = own / np.sqrt(own[-1])
    return out
