"""Least squares on all columns at once.

The module also has the prediction of held-out times, and the covariance of the coefficients.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise, product
from typing import NamedTuple

import attrs
import numpy as np
import scipy
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.methods.scheduled.structure import Structure
from tvsysid.numerics import Array
from tvsysid.numerics.noise import autocovariance
from tvsysid.signals import Ensemble

FOLDS = 5  # stretches of consecutive time that are predicted from the others
RIDGE = 1e-6  # share of a column's power that is added to it, for columns that are alike
COLOUR = 0.4  # seconds up to which the noise's autocorrelation counts, less and less
FEWEST = 2  # samples for each column below which nothing is fitted
AS_WELL = 0.5  # standard errors over folds by which lower orders may predict worse
EMPTY = 1e-12  # share of its mean square below which a column does not vary


class Rows(NamedTuple):
    """Samples in the order of time at which all signals are known.

    The ``columns`` (column, row) are the rest, intrinsic and reflex columns, as many of each as
    ``parts`` says. The ``torque`` and the ``variable`` have shape (row,). ``place`` (row,) is
    the position of each row in one long record: the stretches of time that the ensemble holds, with
    gaps between them that are longer than the noise's colour. ``known`` (sample,) says which of the
    ensemble's samples the rows are.
    """

    columns: Array
    parts: tuple[int, ...]
    torque: Array
    variable: Array
    place: NDArray[np.int64]
    known: NDArray[np.bool_]

    @classmethod
    def of(cls, structure: Structure, ensemble: Ensemble) -> Rows:
        """Return the rows of an ensemble."""
        order = np.concatenate(ensemble.runs)
        parts = structure.parts(ensemble)
        columns = _in_order(np.concatenate(parts), ensemble)
        torque, variable = (
            ensemble.signal(name)[order, ensemble.core].ravel()
            for name in ("torque", structure.variable)
        )
        gap = round(COLOUR * ensemble.sampling_rate)
        gaps = np.repeat(
            np.arange(len(ensemble.runs)) * gap,
            [len(run) * ensemble.samples for run in ensemble.runs],
        )
        known = np.asarray(np.isfinite(columns).all(axis=0))
        place = np.arange(columns.shape[1]) + gaps
        columns = columns if known.all() else columns[:, known]
        return cls(
            columns, tuple(map(len, parts)), torque[known], variable[known], place[known], known
        )

    @property
    def folds(self) -> list[slice]:
        """Return the rows of each fold."""
        ends = np.linspace(0, len(self.torque), FOLDS + 1).astype(int)
        return [slice(first, last) for first, last in pairwise(ends)]


def _in_order(columns: Array, ensemble: Ensemble) -> Array:
    """Return columns (column, realization, time) in the order of time, shape (column, sample)."""
    return columns[:, np.concatenate(ensemble.runs)].reshape(len(columns), -1)


class Fit(NamedTuple):
    """Solution: its ``coefficients`` and the ``inverse`` of their moments, for unscaled columns.

    ``held_out`` (fold,): variance of the torque in each fold accounted for by the fit to the
    others, in per cent. ``tried`` holds the same of other orders (order, reflex_order).
    """

    structure: Structure
    rows: Rows
    coefficients: Array
    inverse: Array
    held_out: Array
    tried: dict[tuple[int, int], Array]

    @property
    def parameters(self) -> float:
        """Return the number of coefficients whose columns are not zero."""
        return float(np.count_nonzero(self.coefficients))


def fitted(
    structure: Structure, ensemble: Ensemble, orders: Sequence[int], reflex_orders: Sequence[int]
) -> Fit:
    """Fit the torque with the lowest orders that predict folds as well as the best orders do.

    The orders of both pathways rise together at first. Then each is chosen anew beside the other.
    ``structure`` has the highest of both.

    Raises
    ------
    InputError
        If the samples are too few for the lowest orders.
    """
    rows = Rows.of(structure, ensemble)
    samples, lowest = len(rows.torque), structure.within(orders[0], reflex_orders[0]).sum()
    if samples < FEWEST * lowest:
        raise InputError(
            f"{samples} samples, at which all lags and the reflex's memory were recorded, are too "
            f"few for {lowest} coefficients; give a longer record, more context, a lower order or "
            "a shorter memory"
        )
    moments, tried = _moments(rows), dict[tuple[int, int], Array]()

    def best(pairs: Iterable[tuple[int, int]]) -> tuple[int, int]:
        for pair in pairs:
            kept = structure.within(*pair)
            if pair not in tried and samples >= FEWEST * kept.sum():
                tried[pair] = _held_out(_part(moments, kept))
        return max(tried, key=lambda pair: float(tried[pair].mean()))

    alike = 1 not in (len(orders), len(reflex_orders))
    chosen = best(
        pair for pair in product(orders, reflex_orders) if pair[0] == pair[1] or not alike
    )
    chosen = best([(chosen[0], each) for each in reflex_orders])
    chosen = best([(each, chosen[1]) for each in orders])
    worse = {pair: tried[chosen] - folds for pair, folds in tried.items()}
    as_good = [
        pair
        for pair, by in worse.items()
        if by.mean() <= AS_WELL * by.std(ddof=1) / math.sqrt(FOLDS)
    ]
    chosen = min(as_good, key=lambda pair: (sum(pair), pair))
    kept = structure.within(*chosen)
    own = structure.of_orders(*chosen)
    rows = rows._replace(columns=rows.columns[kept], parts=own.sizes)
    return _fitted(own, rows, _part(moments, kept), tried)


def with_rest(fit: Fit, ensemble: Ensemble, degrees: int) -> Fit:
    """Fit the same ensemble with ``degrees`` polynomials for the torque at rest."""
    structure, rows = attrs.evolve(fit.structure, rest=degrees), fit.rows
    rest = _in_order(structure.at_rest(ensemble), ensemble)[:, rows.known]
    columns = np.concatenate([rest, rows.columns[rows.parts[0] :]])
    rows = rows._replace(columns=columns, parts=structure.sizes)
    return _fitted(structure, rows, _moments(rows), {})


def _fitted(
    structure: Structure, rows: Rows, moments: Array, tried: dict[tuple[int, int], Array]
) -> Fit:
    coefficients, inverse = _solved(moments.sum(axis=0))
    return Fit(structure, rows, coefficients, inverse, _held_out(moments), tried)


def _moments(rows: Rows) -> Array:
    """Return the moments of columns, torque and a constant with each other, in each fold."""
    both = np.concatenate([rows.columns, rows.torque[None], np.ones((1, len(rows.torque)))])
    return np.stack([both[:, fold] @ both[:, fold].T for fold in rows.folds])


def _part(moments: Array, kept: NDArray[np.bool_]) -> Array:
    """Return the moments of some columns, the torque and a constant."""
    place = np.append(np.flatnonzero(kept), [-2, -1])
    return moments[:, place[:, None], place]


def _held_out(moments: Array) -> Array:
    """Return the variance accounted for in each fold by the fit to the others, in per cent."""
    whole = moments.sum(axis=0)
    return np.array([_explained(own, _solved(whole - own)[0]) for own in moments])


def _solved(moments: Array) -> tuple[Array, Array]:
    """Return the coefficients of the columns, and the inverse of their moments.

    The columns are scaled to unit standard deviation, and have a slight ridge. The ``moments`` are
    those of the columns, the torque and a constant with each other.
    """
    gram, cross, total, count = (
        moments[:-2, :-2],
        moments[:-2, -2],
        moments[:-2, -1],
        moments[-1, -1],
    )
    square = np.diag(gram) / count
    spread = square - (total / count) ** 2
    scale = np.sqrt(np.where(spread > EMPTY * square, spread, np.where(square > 0, square, 1.0)))
    scaled = gram / np.outer(scale, scale) + RIDGE * count * np.eye(len(gram))
    inverse = np.linalg.inv(scaled) / np.outer(scale, scale)
    return inverse @ cross, inverse


def _explained(moments: Array, coefficients: Array) -> float:
    """Return the variance of the torque that coefficients account for, in per cent.

    Both variances are about their means.
    """
    weights = np.append(-coefficients, 1.0)
    count, total = moments[-1, -1], moments[:-1, -1]
    left = weights @ moments[:-1, :-1] @ weights - (weights @ total) ** 2 / count
    return 100 * (1 - float(left / (moments[-2, -2] - total[-1] ** 2 / count)))


def covariance_of(fit: Fit, rate: float, freedom: float) -> Array:
    r"""Return the covariance of the coefficients under coloured noise, (coefficient, coefficient).

    .. math:: A^{-1} X \Sigma X^T A^{-1}

    with :math:`\Sigma` the autocovariance of what the fit leaves, under a half Hann window, as
    many times larger as there are samples for each degree of ``freedom``.
    """
    rows, lags = fit.rows, round(COLOUR * rate)
    left = rows.torque - fit.coefficients @ rows.columns
    length = int(rows.place[-1]) + 1
    line = np.zeros((len(rows.columns), length))
    line[:, rows.place] = rows.columns
    residual = np.zeros((1, length))
    residual[0, rows.place] = left
    half = autocovariance(residual, lags) * length / freedom
    half *= (1 + np.cos(np.pi * np.arange(lags + 1) / (lags + 1))) / 2
    coloured = (
        scipy.signal.oaconvolve(
            line, np.concatenate([half[:0:-1], half])[None], mode="same", axes=1
        )
        @ line.T
    )
    return np.asarray(fit.inverse @ (coloured + coloured.T) @ fit.inverse / 2)
