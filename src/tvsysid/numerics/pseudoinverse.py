"""Least squares from correlations, truncated by minimum description length."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tvsysid.numerics import Array

Order = Literal["natural", "output"]
RIDGE = 1e-9  # share of the regressors' mean power that is added to each


class Solution(NamedTuple):
    """Least-squares solution at each time.

    The ``weights`` (time, lag) are the impulse response times the sample time. They use ``rank``
    (time,) of the ``usable`` singular values, which are above rounding. All usable ones together
    explain the power ``explained`` of the output. The rest is noise. The area under the response is
    the product of ``area`` (time, lag) with ``phi_uy``.
    """

    weights: Array
    rank: NDArray[np.int64]
    area: Array
    usable: NDArray[np.int64]
    explained: Array


def truncated(
    phi_uu: Array,
    phi_uy: Array,
    y_variance: Array,
    samples: Array | float,
    order: Order = "natural",
) -> Solution:
    r"""Solve by a truncated pseudo-inverse of minimum description length at each time.

    After Lortie & Kearney (2001). With :math:`\Phi = U S U^T`, singular value k explains
    :math:`v_k = (u_k^T \varphi)^2 / s_k` of the output's power. The rank d is the one that
    minimises

    .. math:: MDL(d) = \left(1 + \frac{d \ln L}{L}\right)
              \left(\sigma_y^2 - \sum_{k \le d} v_k\right)

    with L the ``samples`` averaged, one number or (time,). ``phi_uu`` and ``phi_uy`` are those of
    :func:`tvsysid.numerics.moments.lagged_moments`. The order ``"natural"`` takes singular values
    from the largest on, ``"output"`` first those that explain most of the output.
    """
    vectors, projections, reciprocal = _spectrum(phi_uu, phi_uy)
    explained = projections**2 * reciprocal
    if order == "output":
        ranking = np.argsort(-explained, axis=1, kind="stable")
        explained, projections, reciprocal = (
            np.take_along_axis(each, ranking, axis=1)
            for each in (explained, projections, reciprocal)
        )
        vectors = np.take_along_axis(vectors, ranking[:, None], axis=2)
    counts = np.arange(1, explained.shape[1] + 1)
    length = np.reshape(samples, (-1, 1))
    cost = (1 + counts * np.log(length) / length) * (
        y_variance[:, None] - np.cumsum(explained, axis=1)
    )
    cost[counts > np.count_nonzero(reciprocal, axis=1)[:, None]] = np.inf
    return _solution(vectors, projections, reciprocal, np.argmin(cost, axis=1) + 1)


def full(phi_uu: Array, phi_uy: Array) -> Solution:
    r"""Solve :math:`\Phi w = \varphi` at each time in all directions that are determined.

    Every singular value above rounding is used.
    """
    vectors, projections, reciprocal = _spectrum(phi_uu, phi_uy)
    return _solution(vectors, projections, reciprocal, np.count_nonzero(reciprocal, axis=1))


def _spectrum(phi_uu: Array, phi_uy: Array) -> tuple[Array, Array, Array]:
    """Return eigenvectors, projections of phi_uy and reciprocals of the eigenvalues.

    The largest eigenvalue comes first. The reciprocal of an eigenvalue is 0 if it is rounding.
    """
    values, vectors = np.linalg.eigh(phi_uu)
    values, vectors = values[:, ::-1], vectors[:, :, ::-1]
    usable = values > values.shape[1] * np.finfo(float).eps * values[:, :1]
    return (
        vectors,
        (phi_uy[:, None, :] @ vectors)[:, 0],
        np.where(usable, 1 / np.where(usable, values, 1.0), 0.0),
    )


def _solution(
    vectors: Array, projections: Array, reciprocal: Array, rank: NDArray[np.int64]
) -> Solution:
    """Return the solution from the first ``rank`` eigenvalues."""
    kept = np.where(np.arange(reciprocal.shape[1]) < rank[:, None], reciprocal, 0.0)
    # The product of the pseudo-inverse with phi_uy, and with ones
    products = np.stack([projections, vectors.sum(axis=1)], axis=-1) * kept[..., None]
    weights, area = np.moveaxis(vectors @ products, -1, 0)
    explained = np.sum(projections**2 * reciprocal, axis=1)
    return Solution(weights, rank, area, np.count_nonzero(reciprocal, axis=1), explained)


def solve_regularized(gram: Array, cross: Array) -> Array:
    """Solve least squares from second moments, also where regressors are nearly the same."""
    ridge = RIDGE * np.trace(gram) / len(gram) + np.finfo(float).tiny
    return np.linalg.solve(gram + ridge * np.eye(len(gram)), cross)
