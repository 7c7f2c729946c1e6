"""Low-pass signals, and keep every n-th sample."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from tvsysid.numerics import Array

TAPS = 31
# taps, divided by the factor, of a filter that stops frequencies above 1.2 times the new Nyquist's
SHARP = 20


def decimation_weights(factor: float, taps: int = TAPS, later: ArrayLike = 0.0) -> Array:
    """Hamming-window low-pass with -6 dB at the new Nyquist frequency, shape (..., taps).

    It gives the value a fraction of a sample ``later`` (...,).
    """
    lags = np.arange(taps) - taps // 2 - np.asarray(later)[..., None]
    weights = np.sinc(lags / factor) * (0.54 + 0.46 * np.cos(np.pi * (2 * lags) / (taps - 1)))
    return weights / weights.sum(axis=-1, keepdims=True)


def windows_about(x: Array, taps: int = TAPS) -> Array:
    """Samples about each sample of x (..., time), shape (..., time, tap); odd reflection at ends.

    There must be as many samples as taps, whose number is odd.
    """
    half = taps // 2
    head = 2 * x[..., :1] - x[..., half:0:-1]
    tail = 2 * x[..., -1:] - x[..., -2 : -2 - half : -1]
    return sliding_window_view(np.concatenate([head, x, tail], axis=-1), taps, axis=-1)


def keep_every(x: Array, factor: int, taps: int = TAPS) -> Array:
    """Every factor-th sample (..., time) of the zero-delay convolution of x with the low-pass.

    The first sample stays the first.
    """
    if factor == 1:
        return x
    windows = windows_about(x, taps)[..., ::factor, :]
    return np.einsum("...t,t", windows, decimation_weights(factor, taps))


def resampled(x: Array, places: NDArray[np.floating], step: float) -> Array:
    """Values of x (realization, time) at ``places``, low-passed as with a factor of ``step``.

    The places (new time,) are positions in samples, and may lie between samples.
    """
    nearest = np.round(places).astype(np.int64)
    weights = decimation_weights(step, later=places - nearest)
    return np.einsum("rtk,tk->rt", windows_about(x)[:, nearest], weights)
