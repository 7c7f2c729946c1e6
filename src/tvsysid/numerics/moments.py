"""Second moments over realizations, from which every ensemble method starts.

With realizations in the rows of ``u`` (realization, time), all second moments over realizations
are entries of one matrix, ``G = uᵀu / R``: the matrix of lagged correlations at a time is a
window on its diagonal. One product therefore serves all times, and long realizations are done in
blocks, so that memory grows with their length only.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.lib.stride_tricks import as_strided

from tvsysid.numerics import Array

# samples a block: larger ones waste products far from the diagonal, smaller ones waste calls
BLOCK = 32
CHUNK = 2**22  # values of correlation matrices held at once (32 MiB)


def time_chunks(times: int, unknowns: int) -> Iterator[slice]:
    """Yield consecutive slices of time that are short enough for the memory.

    The (unknowns, unknowns) matrices of all times of a slice can be held at once.
    """
    length = max(16, CHUNK // unknowns**2)
    for start in range(0, times, length):
        yield slice(start, min(start + length, times))


def window_moments(a: Array, b: Array, before: int, after: int) -> Array:
    r"""Return second moments of two signals in a sliding window, shape (centre, place, place).

    The signals have shape (realization, time).

    .. math:: M(i, j, k) = \frac1R \sum_r a_r(i + j)\, b_r(i + k), \qquad
              0 \le j, k \le before + after

    The first centre is sample ``before``, the last one ``after`` samples from the end.
    """
    later = diagonal_moments(a, b, before + after)
    return window_matrices(later, later if b is a else diagonal_moments(b, a, before + after))


def window_matrices(later: Array, earlier: Array) -> Array:
    """Return second moments of two signals in a sliding window, (window centre, sample, sample).

    ``later`` are the moments of the first signal with later samples of the second, ``earlier``
    those of the second with later samples of the first (:func:`diagonal_moments`). The result is a
    read-only view.
    """
    reach = later.shape[1] - 1
    # Products of a sample with the samples from `reach` earlier to `reach` later
    strip = np.zeros((len(later), 2 * reach + 1))
    strip[:, reach:] = later
    for apart in range(1, min(reach + 1, len(later))):
        strip[apart:, reach - apart] = earlier[:-apart, apart]
    row, column = strip.strides
    shape = (len(later) - reach, reach + 1, reach + 1)
    return as_strided(strip[:, reach:], shape, (row, row - column, column), writeable=False)


def diagonal_moments(a: Array, b: Array, reach: int) -> Array:
    r"""Return second moments of each sample and later samples of another signal.

    The result has shape (time, reach + 1).

    .. math:: M(i, d) = \frac1R \sum_r a_r(i)\, b_r(i + d), \qquad 0 \le d \le reach

    b may be longer than a; beyond its last sample the moments are 0.
    """
    times = a.shape[1]
    moments = np.empty((times, reach + 1))
    for start in range(0, times, BLOCK):
        stop = min(start + BLOCK, times)
        product = np.zeros((stop - start, stop - start + reach))
        known = min(stop + reach, b.shape[1]) - start
        np.matmul(a[:, start:stop].T, b[:, start : start + known], out=product[:, :known])
        row, column = product.strides
        moments[start:stop] = as_strided(
            product, (stop - start, reach + 1), (row + column, column), writeable=False
        )
    moments /= len(a)
    return moments


def lagged_moments(u: Array, y: Array, lags: int) -> tuple[Array, Array, Array, Array]:
    r"""Return correlations of lagged inputs, their correlations with the output, and its moments.

    The moments of the output are its mean square and its mean.

    With :math:`x_r(i) = [u_r(i + n), \dots, u_r(i - n)]`, that is, lags from -n to n samples,

    .. math:: \Phi(i) = \frac1R \sum_r x_r(i) x_r(i)^T, \qquad
              \varphi(i) = \frac1R \sum_r x_r(i)\, y_r(i)

    (equations 4 and 6 of van de Ruit et al. 2021, in matrix form). Row 0 of all four belongs to
    sample n; there are time - 2 n.
    """
    phi_uu = window_moments(u, u, lags, lags)[:, ::-1, ::-1]
    inner = y[:, lags : y.shape[1] - lags]
    return (
        phi_uu,
        diagonal_moments(inner, u, 2 * lags)[:, ::-1],
        np.mean(inner * inner, axis=0),
        inner.mean(axis=0),
    )


def expanded(moments: Array, functions: Array) -> Array:
    """Return the Gram matrix of coefficients of lags times functions of time.

    It follows from the moments of the lags at each time.
    """
    unknowns, count = moments.shape[1], functions.shape[1]
    gram = np.zeros((unknowns**2, count**2))
    for chunk in time_chunks(len(functions), unknowns):
        at = functions[chunk]
        both = (at[:, :, None] * at[:, None, :]).reshape(len(at), -1)
        gram += moments[chunk].reshape(len(at), -1).T @ both
    parts = gram.reshape(unknowns, unknowns, count, count)
    return parts.transpose(0, 2, 1, 3).reshape(unknowns * count, -1)


def sliding_sum(x: Array, before: int, after: int) -> Array:
    """Return the sum of x over a sliding window along its first axis.

    It is ``x[max(0, i - before) : i + after + 1].sum(axis=0)`` for each i, by doubling. Nothing is
    subtracted, which would lose digits.
    """
    sums = np.pad(x, [(before, after)] + [(0, 0)] * (x.ndim - 1))
    total, start, span = np.zeros(x.shape), 0, 1
    while span <= before + after + 1:  # sums[i] is the sum of `span` samples from i on
        if before + after + 1 & span:
            total += sums[start : start + len(x)]
            start += span
        sums, span = sums[:-span] + sums[span:], 2 * span
    return total


def convolve_lags(u: Array, response: Array) -> Array:
    r"""Output (realization, time) of a time-varying two-sided impulse response, lags from -n to m.

    .. math:: y_r(i) = \sum_{j=-n}^{m} w(i, j)\, u_r(i - j)

    ``response`` holds the weights w (impulse response times the sample time), shape (time - n -
    m, n + m + 1); row 0 belongs to sample m of the input.
    """
    times, length = response.shape
    out = np.empty((len(u), times))
    for start in range(0, times, BLOCK):
        stop = min(start + BLOCK, times)
        band = np.zeros((stop - start + length - 1, stop - start))
        row, column = band.strides
        as_strided(band, (stop - start, length), (row + column, row))[:] = response[
            start:stop, ::-1
        ]
        np.matmul(u[:, start : stop + length - 1], band, out=out[:, start:stop])
    return out
