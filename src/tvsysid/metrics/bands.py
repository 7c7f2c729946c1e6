"""How often a band holds the truth."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tvsysid.errors import InputError
from tvsysid.metrics.errors import weighted_mean


def coverage(lower: ArrayLike, upper: ArrayLike, truth: ArrayLike, weights: ArrayLike | None = None) -> Any:
    """Share of trials and times at which a band holds the truth, its edges included.

    Parameters
    ----------
    lower, upper
        Edges of the band in each trial, shape (trial, time); where either is NaN there is no band, and the time is left
        out in that trial.
    truth
        Shape (time,).
    weights
        Of the trials, see :func:`tvsysid.metrics.weighted_mean`.

    Returns
    -------
    float or Array
        In per cent; NaN where there is no band at all. Best is the band's own level: more says that it is too wide.

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
            "coverage: expected lower and upper of axes (trial, time) and a truth for each time, got shapes "
            f"{low.shape}, {high.shape} and {true.shape}"
        )
    known = np.isfinite(low) & np.isfinite(high)
    return share_covered(np.where(known, (low <= true) & (true <= high), np.nan), weights)


def share_covered(covered: ArrayLike, weights: ArrayLike | None = None) -> Any:
    """Coverage where it is known already whether each band holds the truth.

    Parameters
    ----------
    covered
        1 where it does, 0 where not, NaN where there is no band; shape (trial, time).
    weights
        Of the trials, see :func:`tvsysid.metrics.weighted_mean`.

    Returns
    -------
    float or Array
        As of :func:`coverage`.

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
