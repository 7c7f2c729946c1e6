"""Coloured noise: what its autocorrelation does to the variance of a least-squares fit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.linalg import toeplitz
from scipy.signal import welch

Array = NDArray[np.float64]

ROUNDING = 1e-9
"""Share of a regressor's power that is rounding."""


def autocovariance(x: Array, lags: int) -> Array:
    r"""Mean product of samples that lie so many samples apart.

    .. math:: c(d) = \frac{1}{R (N - d)} \sum_r \sum_i x_r(i)\, x_r(i + d)

    Parameters
    ----------
    x
        Shape (realization, time); no mean is subtracted.
    lags
        Largest d; beyond the last sample it is 0.

    Returns
    -------
    Array
        Shape (lags + 1,).

    Examples
    --------
    >>> autocovariance(np.array([[1.0, 2.0, 3.0]]), 1).round(9)
    array([4.66666667, 4.        ])
    """
    count = x.shape[1]
    size = next_fast_len(count + lags, real=True)
    spectrum = rfft(x, size, axis=1)
    power = np.einsum("rf,rf->f", spectrum.real, spectrum.real) + np.einsum("rf,rf->f", spectrum.imag, spectrum.imag)
    products = irfft(power, size)[: lags + 1]
    pairs = len(x) * np.maximum(count - np.arange(lags + 1), 1)
    return np.asarray(np.where(np.arange(lags + 1) < count, products / pairs, 0.0))


def cross_covariance(x: Array, y: Array, lags: int) -> Array:
    r"""Mean product of a sample and one of another signal that lies so many samples later.

    .. math:: c(d) = \frac{1}{R (N - |d|)} \sum_r \sum_i x_r(i)\, y_r(i + d), \qquad -n \le d \le n

    Parameters
    ----------
    x, y
        Shape (realization, time); no mean is subtracted.
    lags
        n.

    Returns
    -------
    Array
        Shape (2 n + 1,), from lag -n on.

    Examples
    --------
    >>> cross_covariance(np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 2.0, 0.0]]), 1).round(9) + 0.0
    array([0., 0., 1.])
    """
    count = x.shape[1]
    size = next_fast_len(count + lags, real=True)
    product = np.einsum("rf,rf->f", rfft(x, size, axis=1).conj(), rfft(y, size, axis=1))
    offsets = np.arange(-lags, lags + 1)
    pairs = len(x) * np.maximum(count - np.abs(offsets), 1)
    return np.asarray(np.where(np.abs(offsets) < count, irfft(product, size)[offsets] / pairs, 0.0))


def regressor_correlation(filters: Array, angle: Array, lags: int) -> Array:
    r"""How alike regressors are that lie so many samples apart.

    .. math:: \frac1M \mathrm{tr}\left(S^{-1} F C_d F^T\right), \qquad (C_d)_{jk} = c(d + j - k)

    for M regressors :math:`s_m(i) = \sum_j F_{mj} u(i - j)` with moments :math:`S = F C_0 F^T`. A least-squares fit
    takes products of the noise with itself at this distance away in this proportion.

    Parameters
    ----------
    filters
        F, shape (regressor, lag).
    angle
        Autocovariance of the angle from lag 0 on; at least as many as filters and lags have together.
    lags
        Largest d.

    Returns
    -------
    Array
        Shape (lags + 1,); 1 at lag 0.
    """
    scaled, inverse = _scaled(filters, angle)
    # tr(S^-1 F C_d F^T) is a sum over the diagonals of F^T S^-1 F, each with its own lag of the angle.
    kernel = scaled.T @ inverse @ scaled
    width = filters.shape[1]
    diagonals = np.array([np.trace(kernel, offset) for offset in range(-width + 1, width)])
    near = angle[np.abs(np.arange(-width + 1, lags + width))]
    return np.asarray(np.correlate(near, diagonals, mode="valid") / len(filters))


def power_in_band(correlation: Array, low: float, high: float) -> float:
    r"""Mean spectral density over a band, as a multiple of that of white noise of the same variance.

    .. math:: 1 + 2 \sum_{d > 0} \rho(d)\, \frac{1}{f_2 - f_1} \int_{f_1}^{f_2} \cos(2 \pi f d)\, df

    Parameters
    ----------
    correlation
        Autocorrelation :math:`\rho` from lag 0 on, 1 at lag 0.
    low, high
        Edges :math:`f_1, f_2` in cycles per sample, 0 to 0.5.

    Examples
    --------
    >>> power_in_band(np.array([1.0, 0.4]), 0.0, 0.25)
    1.5092958178940652
    """
    lags = np.arange(1, len(correlation))
    mean = (np.sin(2 * np.pi * high * lags) - np.sin(2 * np.pi * low * lags)) / (2 * np.pi * lags * (high - low))
    return 1 + 2 * float(correlation[1:] @ mean)


def white_share(noise: Array, signal: Array, sampling_rate: float, band: tuple[float, float]) -> float:
    r"""How many samples of white noise one sample of this noise is worth to a fit of a signal, at most 1.

    A factor fitted by least squares to frequencies in the band has the variance
    :math:`\sum_f S(f) P(f) / (\sum_f S(f))^2`, with S and P the spectral densities of signal and noise. White noise
    of the same power in the band gives as much from a share of the data,

    .. math:: \frac{\bar P\, \sum_f S(f)}{\sum_f S(f)\, P(f)}

    Parameters
    ----------
    noise, signal
        Shape (realization, time).
    sampling_rate
        In Hz.
    band
        Lowest and highest frequency in Hz.
    """
    frequency, power = welch(noise, sampling_rate, nperseg=noise.shape[1], detrend=False, axis=1)
    _, strength = welch(signal, sampling_rate, nperseg=noise.shape[1], detrend=False, axis=1)
    inside = (frequency >= band[0]) & (frequency <= band[1])
    power, strength = power.mean(axis=0)[inside], strength.mean(axis=0)[inside]
    product = float(power @ strength)
    return min(1.0, float(power.mean() * strength.sum()) / product) if product > 0 else 1.0


def colour_factors(filters: Array, angle: Array, noise: Array) -> Array:
    r"""Variances of a least-squares fit under coloured noise, as multiples of those under white noise.

    The regressors are filtered angles, :math:`s_m(i) = \sum_j F_{mj} u(i - j)`. With their moments
    :math:`S = F C F^T` and :math:`\tilde S = F \tilde C F^T`, where C holds the angle's autocovariance c and
    :math:`\tilde C` the same after a passage through the noise's autocorrelation,
    :math:`\tilde c(d) = \sum_e \rho(e)\, c(d + e)`,

    .. math:: f_m = \frac{(S^{-1} \tilde S S^{-1})_{mm}}{(S^{-1})_{mm}}

    Parameters
    ----------
    filters
        F, shape (regressor, lag).
    angle
        Autocovariance of the angle from lag 0 on; at least as many as filters and noise have lags together, less one.
    noise
        Autocorrelation of the noise from lag 0 on, 1 at lag 0.

    Returns
    -------
    Array
        Shape (regressor,); 1 for white noise.
    """
    lags, reach = filters.shape[1], len(noise) - 1
    both = np.concatenate([noise[:0:-1], noise])
    near = angle[np.abs(np.arange(-reach - lags + 1, reach + lags))]
    passed = np.convolve(near, both, mode="valid")[lags - 1 :]
    scaled, inverse = _scaled(filters, angle)
    coloured = inverse @ (scaled @ toeplitz(passed) @ scaled.T) @ inverse
    return np.asarray(np.maximum(np.diag(coloured), 0.0) / np.diag(inverse))


def _scaled(filters: Array, angle: Array) -> tuple[Array, Array]:
    """Filters scaled to unit power of the regressors, and the inverse of the regressors' moments."""
    moments = toeplitz(angle[: filters.shape[1]])
    power = np.einsum("mj,jk,mk->m", filters, moments, filters)
    scaled = filters / np.sqrt(np.where(power > 0, power, 1.0))[:, None]
    values, vectors = np.linalg.eigh(scaled @ moments @ scaled.T)
    # Regressors that are alike to rounding share what they explain.
    return scaled, (vectors / np.maximum(values, ROUNDING)) @ vectors.T
