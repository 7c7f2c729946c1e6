"""Coloured noise: what its autocorrelation does to the variance of a least-squares fit."""

from __future__ import annotations

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from tvsysid.numerics import Array
from tvsysid.numerics.moments import diagonal_moments

ROUNDING = 1e-9  # share of a regressor's power that is rounding
SAMPLES = 40  # samples of noise needed for each lag of its autocorrelation
FLOOR = 0.01  # power of white noise that is added, as a share of the noise's power
FAINT = 1e-13  # power of a filtered angle that is rounding, as a share of the largest possible


def autocovariance(x: Array, lags: int) -> Array:
    r"""Return the autocovariance of x (realization, time) from lag 0 to ``lags`` samples.

    .. math:: c(d) = \frac{1}{R N} \sum_r \sum_i x_r(i)\, x_r(i + d), \qquad 0 \le d \le lags

    The divisor is N, not the number N - d of pairs. The Toeplitz matrices then have no negative
    eigenvalue, so no filter of the noise has a negative power. The mean over pairs has less bias at
    long lags, but may give the acceleration of a short realization a negative power.
    """
    count = x.shape[1]
    size = next_fast_len(count + lags, real=True)
    power = np.sum(np.abs(rfft(x, size, axis=1)) ** 2, axis=0)
    products = irfft(power, size)[: lags + 1]
    return np.where(np.arange(lags + 1) < count, products / x.size, 0.0)


def coloured_moments(columns: Array, noise: Array, taper: Array) -> Array:
    r"""Return :math:`X \Sigma X^T` (column, column) of columns X (column, time).

    :math:`\Sigma` has the autocovariance of the ``noise`` (time,), times a ``taper`` (lag,) from
    lag 0 on.
    """
    half = autocovariance(noise[None], len(taper) - 1) * taper
    size = next_fast_len(columns.shape[1] + len(half) - 1, real=True)
    density = 2 * rfft(half, size).real - half[0]
    density[1 : (size + 1) // 2] *= 2  # all but two frequencies also represent their negative
    spectra = rfft(columns, size)
    return ((spectra * density) @ spectra.conj().T).real / size


def autocorrelation(noise: Array, floor: float = FLOOR) -> Array:
    """Autocorrelation of noise (realization, time), from lag 0 on, as far as it is well known.

    Noise and lags are tapered by Hann windows, so that the power of slow noise does not leak to
    higher frequencies. White noise of a ``floor`` times the power is added: no frequency is taken
    to be free of noise.
    """
    times = noise.shape[1]
    lags = min(times - 1, noise.size // SAMPLES)
    taper = np.hanning(lags + 3)[1:-1]
    covariance = autocovariance(noise * np.hanning(times + 2)[1:-1], lags)
    covariance *= np.correlate(taper, taper, "full")[lags:]
    covariance[0] *= 1 + floor
    return covariance / max(covariance[0], np.finfo(float).tiny)


def angle_products(angle: Array, width: int, lags: int) -> Array:
    """Return the angle's moments along the diagonals, shape (time, width + lags).

    They reach as far as :func:`regressor_covariances` needs. The angle (realization, time) is
    mirrored at the ends where it is shorter than that.
    """
    missing = max(0, width + lags - angle.shape[1])
    if missing:
        angle = np.pad(
            angle,
            ((0, 0), (missing - missing // 2, missing // 2)),
            mode="reflect",
            reflect_type="odd",
        )
    return diagonal_moments(angle, angle, width - 1 + lags)


def regressor_covariances(filters: Array, products: Array) -> Array:
    r"""Return products of filtered angles d samples apart, shape (d, regressor, regressor).

    .. math:: S_d = \frac{1}{R N} \sum_r \sum_i s_r(i)\, s_r(i + d)^T, \qquad
              s_{r, m}(i) = \sum_j F_{mj}\, u_r(i - j)

    for ``filters`` F (regressor, lag) and the angle's :func:`angle_products`, over the N samples
    at which the filters lie within the angle. As with :func:`autocovariance`, sums of them
    weighted by some noise's autocorrelation have no negative eigenvalue. The angle's own
    autocovariance would not do: its error from the ends of a realization can be as large as the
    power of the acceleration.
    """
    width = filters.shape[1]
    count = len(products) - width + 1
    lags = products.shape[1] - width
    # Sums of u(p) u(p + f) over the N - d samples p at which both filters lie within the angle,
    # from running sums.
    running = np.zeros((len(products) + 1, products.shape[1]))
    np.cumsum(products, axis=0, out=running[1:])
    later = np.arange(lags + 1)[:, None, None]
    lag = np.arange(width)[::-1]
    one, other = lag[:, None], lag + later
    first, apart = np.minimum(one, other), np.abs(one - other)
    sums = running[first + count - later, apart] - running[first, apart]
    covariances = filters @ sums @ filters.T / count
    # A regressor may be rounding only, such as the acceleration of a ramp.
    largest = np.abs(filters).sum(axis=1) ** 2 * products[:, 0].max()
    known = np.diag(covariances[0]) > FAINT * largest
    return np.where(np.outer(known, known), covariances, 0.0)


def regressor_correlation(covariances: Array) -> Array:
    r"""Return the mean correlation of M regressors with themselves d samples later.

    It is :math:`\mathrm{tr}(S_0^{-1} S_d) / M`, 1 at d = 0. A least-squares fit lowers the noise's
    autocovariance at lag d in proportion to it.
    """
    scaled, inverse = _scaled(covariances)
    return np.einsum("jk,dkj->d", inverse, scaled) / len(inverse)


def power_in_band(correlation: Array, low: float, high: float) -> float:
    r"""Mean spectral density from low to high cycles per sample.

    1 for white noise of the same variance.

    .. math:: 1 + 2 \sum_{d > 0} \rho(d)\, \frac{1}{f_2 - f_1} \int_{f_1}^{f_2} \cos(2 \pi f d)\, df
    """
    lags = np.arange(1, len(correlation))
    mean = (np.sin(2 * np.pi * high * lags) - np.sin(2 * np.pi * low * lags)) / (
        2 * np.pi * lags * (high - low)
    )
    return 1 + 2 * float(correlation[1:] @ mean)


def white_share(
    noise: Array, signal: Array, sampling_rate: float, band: tuple[float, float]
) -> float:
    r"""Return how many samples of white noise one sample of this noise is worth, at most 1.

    A factor fitted by least squares to frequencies in the band (Hz) has the variance
    :math:`\sum_f S(f) P(f) / (\sum_f S(f))^2`, with S and P the spectral densities of signal and
    noise, both (realization, time). With white noise of the same power in the band, a share of the
    data gives the same variance: :math:`\bar P\, \sum_f S(f) / \sum_f S(f)\, P(f)`.
    """
    times = noise.shape[1]
    window = 1 - np.cos(2 * np.pi * np.arange(times) / times)
    frequency = np.arange(times // 2 + 1) * sampling_rate / times
    inside = (frequency >= band[0]) & (frequency <= band[1])
    # All other frequencies also represent their negative
    once = (frequency == 0) | (2 * frequency == sampling_rate)
    weight = np.where(once, 1.0, 2.0)[inside]
    power, strength = (
        weight * np.mean(abs(rfft(x * window)) ** 2, axis=0)[inside] for x in (noise, signal)
    )
    product = float(power @ strength)
    return min(1.0, float(power.mean() * strength.sum()) / product) if product > 0 else 1.0


def colour_factors(covariances: Array, noise: Array) -> Array:
    r"""Return the variances of a least-squares fit under coloured noise.

    They are multiples of the variances under white noise of the same power.

    .. math:: f_m = \frac{(S_0^{-1} \tilde S S_0^{-1})_{mm}}{(S_0^{-1})_{mm}}, \qquad
              \tilde S = S_0 + \sum_{d > 0} \rho(d) \left(S_d + S_d^T\right)

    with S the :func:`regressor_covariances` and ``noise`` the autocorrelation :math:`\rho` from
    lag 0 on.
    """
    scaled, inverse = _scaled(covariances)
    half = np.einsum("d,djk->jk", noise, scaled) - scaled[0] / 2
    coloured = inverse @ (half + half.T) @ inverse
    return np.maximum(np.diag(coloured), 0.0) / np.diag(inverse)


def _scaled(covariances: Array) -> tuple[Array, Array]:
    """Scale covariances to unit power of the regressors. Also invert the regressors' moments."""
    power = np.diag(covariances[0])
    scale = np.sqrt(np.where(power > 0, power, 1.0))
    scaled = covariances / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled[0])
    # Regressors may be collinear, which makes an eigenvalue 0.
    return scaled, (vectors / np.maximum(values, ROUNDING)) @ vectors.T
