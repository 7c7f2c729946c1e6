"""Identify two linear pathways in parallel, each from what the other leaves of the output."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tvsysid.numerics import Array
from tvsysid.numerics.bases import Basis, evaluate
from tvsysid.numerics.gaussian import Moments, ridge
from tvsysid.numerics.moments import expanded

MAX_TURNS = 30  # of either pathway


# Function that returns the weights (time, lag) of a pathway from gram, cross and square of its
# lagged signal, and the number of realizations.
Solver = Callable[[Array, Array, Array, int], Array]


def alternate(
    angle: Array, past: Array, torque: Array, solver: Solver, min_gain: float
) -> tuple[Array, Array]:
    """Return the weights (time, lag) of the lagged angles, and those of the reflex's lagged drive.

    All have shape (realization, time). The ``angle`` has as much context to either side, and the
    drive as much ``past``, as the lags reach. In each turn, the intrinsic pathway is fitted to the
    torque that the reflex leaves, then the reflex to the torque that the intrinsic pathway leaves.
    The turns end when one explains less than ``min_gain`` more of the torque. Its weights are not
    used.
    """
    realizations, times = torque.shape
    lags = angle.shape[1] - times + 1
    views = (
        sliding_window_view(each, each.shape[1] - times + 1, axis=1)[..., ::-1]
        for each in (angle, past)
    )
    columns = np.concatenate([*views], axis=2).transpose(1, 2, 0)
    gram, cross = columns @ columns.swapaxes(1, 2), (columns @ torque.T[..., None])[..., 0]
    square = np.sum(torque**2, axis=0)
    best, explained = np.zeros(cross.shape), -np.inf
    for _ in range(MAX_TURNS):
        weights = best.copy()
        for own in slice(lags), slice(lags, None):
            weights[:, own] = 0.0
            left = cross - np.einsum("tij,tj->ti", gram, weights)
            # |y|² - |y - X w|² = wᵀ (c + c - G w)
            unexplained = square - np.sum(weights * (cross + left), axis=1)
            weights[:, own] = solver(gram[:, own, own], left[:, own], unexplained, realizations)
        left = cross - np.einsum("tij,tj->ti", gram, weights)
        share = float(np.sum(weights * (cross + left)) / np.sum(square))
        if not share >= explained + min_gain:
            break
        best, explained = weights, share
    return best[:, :lags], best[:, lags:]


def solve_by_basis(
    basis: Basis, gram: Array, cross: Array, square: Array, realizations: int
) -> Array:
    """Return weights (time, lag) that change by a basis. One prior holds for all coefficients."""
    functions = evaluate(basis, len(cross))
    samples = realizations * len(functions)
    products = expanded(gram, functions), (cross.T @ functions).ravel()
    coefficients = ridge(Moments(*products, float(square.sum()), samples)).mean
    return np.asarray(functions @ coefficients.reshape(-1, functions.shape[1]).T)
