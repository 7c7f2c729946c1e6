"""Least squares on all columns at once, what it predicts of times that it has not seen, and how sure it is."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import oaconvolve

from tvsysid.errors import InputError
from tvsysid.methods.scheduled.structure import Structure
from tvsysid.numerics import Array
from tvsysid.numerics.noise import autocovariance
from tvsysid.signals import Ensemble

FOLDS = 5  # stretches of consecutive time that are predicted from the others
RIDGE = 1e-6  # share of a column's power that is added to it, for columns that are alike
COLOUR = 0.4  # seconds up to which the noise's autocorrelation counts, less and less
FEWEST = 2  # samples for each column below which nothing is fitted
EMPTY = 1e-12  # share of its mean square below which a column does not vary


class Rows(NamedTuple):
    """Samples in the order of time at which everything is known.

    The ``columns`` (column, row), of which the first has so many ``parts`` rest, intrinsic and reflex columns; the
    ``torque`` and the ``variable`` (row,); and on which sample of one long record each lies, ``place`` (row,): the
    stretches of time that the ensemble holds, with gaps between them that are longer than the noise's colour. Which of
    the ensemble's samples the rows are, is ``known`` (sample,).
    """

    columns: Array
    parts: tuple[int, ...]
    torque: Array
    variable: Array
    place: NDArray[np.int64]
    known: NDArray[np.bool_]

    @classmethod
    def of(cls, structure: Structure, ensemble: Ensemble) -> Rows:
        """Rows of an ensemble; raises InputError where they are too few."""
        order = np.concatenate(ensemble.runs)
        parts = structure.parts(ensemble)
        columns = _in_order(np.concatenate(parts), ensemble)
        torque, variable = (
            ensemble.signal(name)[order, ensemble.core].ravel() for name in ("torque", structure.variable)
        )
        gap = round(COLOUR * ensemble.sampling_rate)
        gaps = np.repeat(np.arange(len(ensemble.runs)) * gap, [len(run) * ensemble.samples for run in ensemble.runs])
        known = np.asarray(np.isfinite(columns).all(axis=0))
        if known.sum() < FEWEST * len(columns):
            raise InputError(
                f"{known.sum()} samples, at which all lags and the reflex's memory were recorded, are too few for "
                f"{len(columns)} coefficients; give a longer record, more context, a lower order or a shorter memory"
            )
        place = np.arange(columns.shape[1]) + gaps
        columns = columns if known.all() else columns[:, known]
        return cls(columns, tuple(map(len, parts)), torque[known], variable[known], place[known], known)

    @property
    def folds(self) -> list[slice]:
        """Rows of each fold."""
        ends = np.linspace(0, len(self.torque), FOLDS + 1).astype(int)
        return [slice(first, last) for first, last in pairwise(ends)]


def _in_order(columns: Array, ensemble: Ensemble) -> Array:
    """Columns (column, realization, time) in the order of time, (column, sample)."""
    return columns[:, np.concatenate(ensemble.runs)].reshape(len(columns), -1)


class Fit(NamedTuple):
    """Solution: its ``coefficients`` and the ``inverse`` of their moments, for columns as they are.

    ``held_out`` (fold,): variance of the torque in each fold accounted for by the fit to the others, in per cent.
    """

    structure: Structure
    rows: Rows
    coefficients: Array
    inverse: Array
    held_out: Array

    @property
    def parameters(self) -> float:
        """Number of coefficients, but for columns that are nothing."""
        return float(np.count_nonzero(self.coefficients))


def fitted(structure: Structure, ensemble: Ensemble) -> Fit:
    """Fit of the torque, and of each fold's by the others."""
    return _fitted(structure, Rows.of(structure, ensemble))


def with_rest(fit: Fit, ensemble: Ensemble, degrees: int) -> Fit:
    """Fit of the same ensemble whose torque at rest has a polynomial with so many degrees."""
    structure, rows = replace(fit.structure, rest=degrees), fit.rows
    rest = _in_order(structure.at_rest(ensemble), ensemble)[:, rows.known]
    columns = np.concatenate([rest, rows.columns[rows.parts[0] :]])
    return _fitted(structure, rows._replace(columns=columns, parts=(degrees, *rows.parts[1:])))


def _fitted(structure: Structure, rows: Rows) -> Fit:
    both = np.concatenate([rows.columns, rows.torque[None], np.ones((1, len(rows.torque)))])
    moments = [both[:, fold] @ both[:, fold].T for fold in rows.folds]
    whole = np.sum(moments, axis=0)
    coefficients, inverse = _solved(whole)
    held_out = [_explained(own, _solved(whole - own)[0]) for own in moments]
    return Fit(structure, rows, coefficients, inverse, np.array(held_out))


def _solved(moments: Array) -> tuple[Array, Array]:
    """Coefficients of the columns at unit standard deviation, with a slight ridge; and the inverse of their moments.

    The ``moments`` are of the columns, the torque and a one, with each other.
    """
    gram, cross, total, count = moments[:-2, :-2], moments[:-2, -2], moments[:-2, -1], moments[-1, -1]
    square = np.diag(gram) / count
    spread = square - (total / count) ** 2
    scale = np.sqrt(np.where(spread > EMPTY * square, spread, np.where(square > 0, square, 1.0)))
    scaled = gram / np.outer(scale, scale) + RIDGE * count * np.eye(len(gram))
    inverse = np.linalg.inv(scaled) / np.outer(scale, scale)
    return inverse @ cross, inverse


def _explained(moments: Array, coefficients: Array) -> float:
    """Variance of the torque that coefficients account for, in per cent; both about their means."""
    weights = np.append(-coefficients, 1.0)
    count, total = moments[-1, -1], moments[:-1, -1]
    left = weights @ moments[:-1, :-1] @ weights - (weights @ total) ** 2 / count
    return 100 * (1 - float(left / (moments[-2, -2] - total[-1] ** 2 / count)))


def covariance_of(fit: Fit, rate: float, freedom: float) -> Array:
    r"""Covariance of the coefficients, (coefficient, coefficient), under noise of the residual's colour.

    .. math:: A^{-1} X \Sigma X^T A^{-1}

    with :math:`\Sigma` the autocovariance of what the fit leaves, under a half Hann window, as many times
    larger as there are samples for each degree of ``freedom``.
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
    coloured = oaconvolve(line, np.concatenate([half[:0:-1], half])[None], mode="same", axes=1) @ line.T
    return np.asarray(fit.inverse @ (coloured + coloured.T) @ fit.inverse / 2)
