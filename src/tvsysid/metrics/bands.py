"""How often a band holds the truth."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from tvsysid.errors import InputError


def coverage(lower: ArrayLike, upper: ArrayLike, truth: ArrayLike) -> float:
    """Share of trials and times at which a band holds the truth, its edges included.

    Parameters
    ----------
    lower, upper
        Edges of the band in each trial, shape (trial, time); where either is NaN there is no band, and the time is left
        out in that trial.
    truth
        Shape (time,).

    Returns
    -------
    float
        In per cent; NaN where there is no band at all. Best is the band's own level: more says that it is too wide.

    Raises
    ------
    InputError
        If the shapes do not fit.

    Examples
    --------
    >>> coverage([[0.0, 1.0], [2.0, 1.0]], [[2.0, 3.0], [4.0, 3.0]], [1.0, 2.0])
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
    if not known.any():
        return math.nan
    return 100 * float(np.mean(((low <= true) & (true <= high))[known]))
