"""Band-limited signals between their samples."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import correlate1d

from tvsysid.numerics import Array

SINC = 12  # samples to either side that a value between samples is made from


def between(values: Array, later: float) -> Array:
    """Return values a fraction of a sample later, shape (..., time).

    They are interpolated by a windowed sinc, which smooths hardly at all.
    """
    if later == 0:
        return values
    lags = np.arange(-SINC, SINC + 1)
    taps = np.sinc(lags - later) * np.kaiser(2 * SINC + 1, 5.0)
    return correlate1d(values, taps / taps.sum(), axis=-1, mode="nearest")


def advanced(values: Array, samples: float) -> Array:
    """Return values so many samples later, shape (..., time). The last one is repeated."""
    whole, last = round(samples), values.shape[-1] - 1
    return between(values, samples - whole)[..., np.clip(np.arange(last + 1) + whole, 0, last)]
