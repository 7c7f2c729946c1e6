"""Least squares from correlations, truncated by minimum description length."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

Array = NDArray[np.float64]
Order = Literal["natural", "output"]


class Solution(NamedTuple):
    """Least squares at each time, truncated or not.

    ``weights`` (time, lag) and how many singular values they were built from, ``rank`` (time,); ``inverse`` (time, lag,
    lag) is the pseudo-inverse of the correlations, ``weights = inverse @ phi_uy``. Without truncation there would be
    ``usable`` singular values, those above rounding, which explain the power ``explained`` of the output, both (time,):
    what they leave is noise whichever of them were taken.
    """

    weights: Array
    rank: NDArray[np.int64]
    inverse: Array
    usable: NDArray[np.int64]
    explained: Array


def truncated(
    phi_uu: Array, phi_uy: Array, y_variance: Array, samples: Array | float, order: Order = "natural"
) -> Solution:
    r"""Truncated pseudo-inverse whose rank minimises the description length at each time.

    With :math:`\Phi = U S U^T`, singular value k explains :math:`v_k = (u_k^T \varphi)^2 / s_k` of the output's
    power, and the rank d is the one that minimises

    .. math:: MDL(d) = \left(1 + \frac{d \ln L}{L}\right)
              \left(\sigma_y^2 - \sum_{k \le d} v_k\right)

    Parameters
    ----------
    phi_uu, phi_uy
        Correlations as of :func:`tvsysid.numerics.moments.lagged_moments`, shapes (time, lag, lag) and (time, lag).
    y_variance
        Output variance, shape (time,).
    samples
        How many samples were averaged, L; scalar or shape (time,).
    order
        ``"natural"`` takes singular values from the largest on; ``"output"`` takes first those that explain most of
        the output.

    Returns
    -------
    Solution
        Weights (impulse response times sample time) and ranks.

    References
    ----------
    Lortie & Kearney 2001, Annals of Biomedical Engineering 29.
    """
    values, vectors, projections, usable = _spectrum(phi_uu, phi_uy)
    reciprocal = np.where(usable, 1 / np.where(usable, values, 1.0), 0.0)
    explained = projections**2 * reciprocal
    every = usable.sum(axis=1), explained.sum(axis=1)
    if order == "output":
        ranking = np.argsort(-explained, axis=1, kind="stable")
        explained = np.take_along_axis(explained, ranking, axis=1)
        place = np.argsort(ranking, axis=1)
    else:
        place = np.arange(values.shape[1])[None, :]
    counts = np.arange(1, values.shape[1] + 1)
    length = np.broadcast_to(np.asarray(samples, dtype=float), y_variance.shape)[:, None]
    cost = (1 + counts * np.log(length) / length) * (y_variance[:, None] - np.cumsum(explained, axis=1))
    cost[counts > every[0][:, None]] = np.inf
    rank = np.argmin(cost, axis=1) + 1
    return _solution(vectors, projections, np.where(place < rank[:, None], reciprocal, 0.0), rank, *every)


def full(phi_uu: Array, phi_uy: Array) -> Solution:
    r"""Solve :math:`\Phi w = \varphi` at each time with every singular value above the numerical rank.

    Parameters and result are those of :func:`truncated`.
    """
    values, vectors, projections, usable = _spectrum(phi_uu, phi_uy)
    reciprocal = np.where(usable, 1 / np.where(usable, values, 1.0), 0.0)
    rank = usable.sum(axis=1)
    return _solution(vectors, projections, reciprocal, rank, rank, np.sum(projections**2 * reciprocal, axis=1))


def _solution(
    vectors: Array,
    projections: Array,
    reciprocal: Array,
    rank: NDArray[np.int64],
    usable: NDArray[np.int64],
    explained: Array,
) -> Solution:
    """Solution from eigenvectors and the reciprocals of those eigenvalues that are kept."""
    weights = (vectors @ (projections * reciprocal)[..., None])[..., 0]
    inverse = (vectors * reciprocal[:, None, :]) @ vectors.transpose(0, 2, 1)
    return Solution(weights, rank, inverse, usable, explained)


def _spectrum(phi_uu: Array, phi_uy: Array) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Eigenvalues (largest first), vectors, projections of phi_uy on them, and which are above rounding."""
    values, vectors = np.linalg.eigh(phi_uu)
    values, vectors = values[:, ::-1], vectors[:, :, ::-1]
    projections = (phi_uy[:, None, :] @ vectors)[:, 0]
    usable = values > values.shape[1] * np.finfo(float).eps * values[:, :1]
    return values, vectors, projections, usable


def direct(u: Array, y: Array, lags: int, block: int = 64) -> Solution:
    """Least squares on the lagged inputs themselves at each time, by singular value decomposition.

    Minimum norm where there are fewer realizations than lags.

    Parameters
    ----------
    u, y
        Input and output, shape (realization, time).
    lags
        Lags to either side, n.
    block
        Times decomposed at once; bounds the memory.

    Returns
    -------
    Solution
        Weights, shape (time - 2 n, 2 n + 1), and ranks.

    References
    ----------
    MacNeil, Kearney & Hunter 1992, IEEE Transactions on Biomedical Engineering 39.
    """
    windows = sliding_window_view(u, 2 * lags + 1, axis=1)[:, :, ::-1].transpose(1, 0, 2)
    times = windows.shape[0]
    weights, rank = np.empty((times, 2 * lags + 1)), np.empty(times, dtype=np.int64)
    explained = np.empty(times)
    inverse = np.empty((times, 2 * lags + 1, 2 * lags + 1))
    for start in range(0, times, block):
        stop = min(start + block, times)
        left, values, right = np.linalg.svd(windows[start:stop], full_matrices=False)
        usable = values > max(windows.shape[1:]) * np.finfo(float).eps * values[:, :1]
        output = y[:, lags + start : lags + stop].T[:, None, :]
        projections = (output @ left)[:, 0]
        reciprocal = np.where(usable, 1 / np.where(usable, values, 1.0), 0.0)
        weights[start:stop] = ((projections * reciprocal)[:, None, :] @ right)[:, 0]
        rank[start:stop] = usable.sum(axis=1)
        explained[start:stop] = np.sum(projections**2 * usable, axis=1) / len(u)
        transposed = right.transpose(0, 2, 1)
        inverse[start:stop] = len(u) * (transposed * reciprocal[:, None, :] ** 2) @ right
    return Solution(weights, rank, inverse, rank, explained)
