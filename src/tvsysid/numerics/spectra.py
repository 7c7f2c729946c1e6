"""Spectra from second moments: short-time spectral densities averaged over realizations."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.fft import rfft

from tvsysid.numerics.moments import BLOCK, window_moments

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

TRANSFORMS = 4.0
"""Time of a segment's transform, R N log N, over that of the moments, N³ (measured)."""
SEGMENTS = 2**18
"""Samples of segments that are transformed at once, so that they stay in the cache."""


class ShortTimeSpectra(NamedTuple):
    """Spectral densities, shape (time, frequency): input, output with input, output."""

    uu: Array
    yu: ComplexArray
    yy: Array


def short_time_spectra(u: Array, y: Array, length: int) -> ShortTimeSpectra:
    r"""Spectral densities of Hann-windowed segments about each time, averaged over realizations.

    .. math:: S_{yu}(f, t) = \frac{1}{N R} \sum_r Y_r(f, t)\, U_r^*(f, t)

    (equations 10 and 11 of van de Ruit et al. 2021), where U and Y are the Fourier transforms of the windowed
    segments; no mean is subtracted. For short segments of many realizations they follow from the second moments of the
    samples in the window: with :math:`F` the windowed Fourier matrix and :math:`M(t)` those moments,
    :math:`S(f, t) = (F M(t) F^H)_{ff} / N`, which costs as :math:`N^3`. Otherwise every segment is transformed, which
    costs as :math:`R N \log N`. Both give the same to rounding; the quicker is taken.

    Parameters
    ----------
    u, y
        Input and output, shape (realization, time).
    length
        Samples of a segment, N. For an even one the segment about t is t - N/2 ... t + N/2 - 1, and the periodic
        Hann window peaks at t; for an odd one segment and window are symmetric.

    Returns
    -------
    ShortTimeSpectra
        Shape (time - N + 1, N // 2 + 1); row 0 belongs to sample N // 2.
    """
    quicker_apart = length**2 > TRANSFORMS * len(u) * math.log2(max(length, 2))
    return _from_segments(u, y, length) if quicker_apart else _from_moments(u, y, length)


def _from_moments(u: Array, y: Array, length: int) -> ShortTimeSpectra:
    window = hann(length)
    transform = np.fft.rfft(np.diag(window), axis=1)  # (sample, frequency)
    stacked = np.concatenate([transform.real, -transform.imag], axis=1)
    before, after = length // 2, length - 1 - length // 2
    frequencies = transform.shape[1]

    def density(a: Array, b: Array) -> ComplexArray:
        centres = a.shape[1] - length + 1
        out = np.empty((centres, frequencies), dtype=np.complex128)
        for start in range(0, centres, BLOCK):
            stop = min(start + BLOCK, centres)
            columns = slice(start, stop + length - 1)
            moments = window_moments(a[:, columns], b[:, columns], before, after)
            half = (moments.reshape(-1, length) @ stacked).reshape(stop - start, length, 2 * frequencies)
            real, imaginary = half[..., :frequencies], half[..., frequencies:]
            out.real[start:stop] = np.einsum("tjf,jf->tf", real, transform.real) - np.einsum(
                "tjf,jf->tf", imaginary, transform.imag
            )
            out.imag[start:stop] = np.einsum("tjf,jf->tf", real, transform.imag) + np.einsum(
                "tjf,jf->tf", imaginary, transform.real
            )
        out /= length
        return out

    return ShortTimeSpectra(density(u, u).real, density(y, u), density(y, y).real)


def _from_segments(u: Array, y: Array, length: int) -> ShortTimeSpectra:
    window, centres = hann(length), u.shape[1] - length + 1
    shape = (centres, length // 2 + 1)
    out = ShortTimeSpectra(np.empty(shape), np.empty(shape, dtype=np.complex128), np.empty(shape))
    segments = [sliding_window_view(signal, length, axis=1) for signal in (u, y)]
    step = max(1, SEGMENTS // (len(u) * length))
    for start in range(0, centres, step):
        block = slice(start, start + step)
        a, b = (rfft(each[:, block] * window, axis=2) for each in segments)
        out.uu[block] = np.sum(a.real**2 + a.imag**2, axis=0)
        out.yu[block] = np.sum(b * a.conj(), axis=0)
        out.yy[block] = np.sum(b.real**2 + b.imag**2, axis=0)
    samples = len(u) * length
    return ShortTimeSpectra(out.uu / samples, out.yu / samples, out.yy / samples)


def half_cosine_spectrum(half_cycles: int, length: int, low: int, high: int) -> ComplexArray:
    r"""Fourier transform of so many half-cycles of a cosine over a record, without transforming it.

    .. math:: \sum_{n=0}^{N-1} \cos\frac{\pi q (n + 1/2)}{N}\, e^{-2\pi j k n / N}, \qquad low \le k < high

    a geometric series for each k.

    Parameters
    ----------
    half_cycles
        q.
    length
        Samples of the record, N.
    low, high
        First bin, and the one after the last.

    Returns
    -------
    ComplexArray
        Shape (high - low,).
    """
    bins = np.arange(low, high)
    total = np.zeros(high - low, dtype=np.complex128)
    for sign in (1, -1):
        start = 0.5 * np.exp(0.5j * np.pi * sign * half_cycles / length)
        if half_cycles % 2:  # e^{jN(...)} is -1
            total += start * -2 / np.expm1(1j * np.pi * (sign * half_cycles - 2 * bins) / length)
        else:  # orthogonal to all bins but one
            total += start * length * ((2 * bins - sign * half_cycles) % (2 * length) == 0)
    return total


def hann(length: int) -> Array:
    """Hann window that is symmetric about sample length // 2; shape (length,).

    Examples
    --------
    >>> hann(4)
    array([0. , 0.5, 1. , 0.5])
    """
    if length % 2 == 0:
        return np.asarray(0.5 - 0.5 * np.cos(2 * np.pi * np.arange(length) / length))
    return np.asarray(0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(length) + 1) / (length + 1)))


def power_share(x: Array, sampling_rate: float, low: float, high: float) -> float:
    """Share of the variance of x, shape (realization, time), that lies from low to high (Hz)."""
    centred = x - x.mean(axis=1, keepdims=True)
    power = np.sum(np.abs(np.fft.rfft(centred * hann(x.shape[1]), axis=1)) ** 2, axis=0)
    frequencies = np.fft.rfftfreq(x.shape[1], 1 / sampling_rate)
    inside = (frequencies >= low) & (frequencies <= high)
    return float(power[inside].sum() / power.sum()) if power.sum() > 0 else 0.0
