"""Low-pass and keep every so-manieth sample."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tvsysid.numerics import Array

TAPS = 31
# taps for each of the factor, of a filter that passes hardly anything from 1.2 times the new
# Nyquist on
SHARP = 20


def decimation_weights(factor: float, taps: int = TAPS) -> Array:
    """Hamming-window low-pass with -6 dB at the new Nyquist frequency, shape (taps,)."""
    weights = np.sinc((np.arange(taps) - taps // 2) / factor) * np.hamming(taps)
    return np.asarray(weights / weights.sum())


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
    return np.asarray(np.einsum("...t,t", windows, decimation_weights(factor, taps)))
