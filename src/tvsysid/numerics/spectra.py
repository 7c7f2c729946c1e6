"""Spectra from second moments: short-time spectral densities averaged over realizations."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.fft import rfft
from scipy.linalg import hankel

from tvsysid.numerics import Array
from tvsysid.numerics.moments import diagonal_moments

ComplexArray = NDArray[np.complex128]


class ShortTimeSpectra(NamedTuple):
    """Spectral densities (time, frequency) of input, output with input, and output."""

    uu: Array
    yu: ComplexArray
    yy: Array


def short_time_spectra(u: Array, y: Array, length: int) -> ShortTimeSpectra:
    r"""Return spectral densities of Hann-windowed segments, averaged over realizations.

    .. math:: S_{yu}(f, t) = \frac{1}{N R} \sum_r Y_r(f, t)\, U_r^*(f, t)

    (equations 10 and 11 of van de Ruit et al. 2021), where U and Y are the Fourier transforms of
    the windowed segments of N = ``length`` samples. No mean is subtracted. Row 0 belongs to sample
    N // 2; for an even N the segment about t is t - N/2 ... t + N/2 - 1. The densities are the
    Fourier transforms of the segments' correlations at each distance, which follow from the second
    moments.
    """
    window = hann(length)
    taper = window * hankel(window)  # of a sample and the one that comes d later, shape (d, sample)
    turns = 2 * np.pi / length * np.outer(np.arange(length), np.arange(length // 2 + 1))
    twice = np.where(np.arange(length) == 0, 1.0, 2.0)[:, None]

    def correlation(moments: Array) -> Array:
        """Return products of windowed samples and later ones, summed, shape (time, lag)."""
        windows = sliding_window_view(moments, length, axis=0)
        return np.einsum("tdj,dj->td", windows, taper) / length

    uu, later, earlier, yy = (
        correlation(diagonal_moments(a, b, length - 1)) for a, b in ((u, u), (u, y), (y, u), (y, y))
    )
    yu = (later + earlier) @ (0.5 * twice * np.cos(turns)) - 1j * (
        (later - earlier) @ np.sin(turns)
    )
    uu, yy = (each @ (twice * np.cos(turns)) for each in (uu, yy))
    return ShortTimeSpectra(uu, yu, yy)


def hann(length: int) -> Array:
    """Return a Hann window that is symmetric about, and peaks at, sample length // 2."""
    odd = length % 2
    return 0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(length) + odd) / (length + odd))


def power_spectrum(x: Array) -> Array:
    """Return the power of x (realization, time) at each frequency, summed over realizations.

    The window is Hann's.
    """
    centred = x - x.mean(axis=1, keepdims=True)
    power = np.abs(rfft(centred * hann(x.shape[1]), axis=1)) ** 2
    return power.sum(axis=0)


def power_share(x: Array, sampling_rate: float, low: float) -> float:
    """Return the share of the variance of x (realization, time) from ``low`` in Hz on."""
    power = power_spectrum(x)
    frequency = np.fft.rfftfreq(x.shape[1], 1 / sampling_rate)
    total = float(power.sum())
    inside = float(power[frequency >= low].sum())
    return inside / total if total > 0 else 0.0
