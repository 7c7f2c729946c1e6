"""Least squares on the columns of all parts at once, and the choice of orders by held-out folds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.methods.scheduled.model import Orders, Parts
from tvsysid.numerics import Array
from tvsysid.numerics.noise import coloured_moments
from tvsysid.signals import Ensemble

FOLDS = 5  # stretches of consecutive time, each predicted from the others
RIDGE = 1e-6  # added to each column, relative to its power; for columns that are nearly collinear
MAX_COLOUR_S = 0.4  # lag at which the noise's autocorrelation has faded out
MIN_SAMPLES = 2  # for each coefficient
TIED = 0.5  # standard errors over folds by which lower orders may predict worse


class Regression(NamedTuple):
    """Signals of an ensemble in one line of time.

    ``values`` (column + 1, sample) are the regressors of all parts of the torque, divided by their
    ``scale`` (column,), which is their standard deviation, and the torque. They are 0 where one of
    them is not ``known``. ``part`` and ``degree`` (column,) are the part of each regressor and the
    degree of its polynomial. ``folds`` are slices of samples.
    ``moments`` (fold, column + 1, column + 1) are the products of the values in each fold.
    """

    part: NDArray[np.str_]
    degree: NDArray[np.int64]
    scale: Array
    values: Array
    known: NDArray[np.bool_]
    folds: Sequence[slice]
    moments: Array

    @classmethod
    def of(cls, parts: Parts, ensemble: Ensemble) -> Regression:
        """Return the regression of an ensemble.

        Raises
        ------
        InputError
            If the samples are too few.
        """
        torque = ensemble.torque[None, :, ensemble.core]
        columns = [each.regressors.reshape(-1, *torque.shape[1:]) for each in parts.values()]
        rows = np.concatenate([*columns, torque])
        values = rows[:, np.concatenate(ensemble.runs)].reshape(len(rows), -1)
        known = np.isfinite(values).all(axis=0)
        samples, count = np.flatnonzero(known), len(values) - 1
        if len(samples) < MIN_SAMPLES * count:
            raise InputError(
                f"{len(samples)} samples, at which all lags and the reflex's memory were recorded, "
                f"are too few for {count} coefficients; give a longer record, more context, a "
                "lower order or a shorter memory"
            )
        scale = values[:-1].std(axis=1, where=known)
        scale[scale == 0] = 1.0  # the constant
        values[:-1] /= scale[:, None]
        values[:, ~known] = 0.0
        edges = np.linspace(0, len(samples), FOLDS + 1).astype(int)[1:-1]
        starts = [0, *samples[edges]]
        folds = [slice(*each) for each in zip(starts, [*starts[1:], len(known)], strict=True)]
        return cls(
            np.repeat(list(parts), [len(own) for own in columns]),
            np.concatenate(
                [np.indices(each.regressors.shape[:2])[1].ravel() for each in parts.values()]
            ),
            scale,
            values,
            known,
            folds,
            np.stack([values[:, fold] @ values[:, fold].T for fold in folds]),
        )

    def kept(self, orders: Orders) -> NDArray[np.int64]:
        """Return the columns that remain with these orders."""
        return np.flatnonzero(self.degree <= [getattr(orders, part) for part in self.part])

    @property
    def ridge(self) -> float:
        """Number that is added to the power of each column."""
        return RIDGE * float(self.known.sum())

    def solve(self, moments: Array, kept: NDArray[np.int64]) -> Array:
        """Return least-squares coefficients of the values (…, column), 0 of those not kept."""
        gram = moments[..., kept[:, None], kept] + self.ridge * np.eye(len(kept))
        coefficients = np.zeros((*moments.shape[:-2], len(self.scale)))
        coefficients[..., kept] = np.linalg.solve(gram, moments[..., kept, -1:])[..., 0]
        return coefficients

    @property
    def coefficients(self) -> Array:
        """Least-squares coefficients of the values (column,)."""
        return self.solve(self.moments.sum(axis=0), np.arange(len(self.scale)))

    def vaf(self, coefficients: Array, fold: slice = slice(None)) -> Array:
        """Return the variance of the torque that coefficients (…, column) account for, in %."""
        torque, known = self.values[-1, fold], self.known[fold]
        left = torque - coefficients @ self.values[:-1, fold]
        share = np.var(left, axis=-1, where=known) / np.var(torque, where=known)
        return np.asarray(100 * (1 - share))

    def held_out(self, orders: Sequence[Orders]) -> Array:
        """Return the VAF (orders, fold) of each fold by fits to the others, in per cent."""
        others = self.moments.sum(axis=0) - self.moments
        fits = np.stack([self.solve(others, self.kept(each)) for each in orders], axis=1)
        vaf = [self.vaf(*each) for each in zip(fits, self.folds, strict=True)]
        return np.stack(vaf, axis=1)

    def best_orders(self, orders: Sequence[Orders]) -> tuple[Orders, float]:
        """Return the lowest orders that predict folds as well as the best do, and their VAF."""
        vaf = self.held_out(orders)
        losses = vaf[np.argmax(vaf.mean(axis=1))] - vaf
        allowed = TIED * losses.std(axis=1, ddof=1) / math.sqrt(FOLDS)
        as_good = np.flatnonzero(losses.mean(axis=1) <= allowed).tolist()
        best = min(as_good, key=lambda place: sum(orders[place]))
        return orders[best], float(vaf[best].mean())

    def covariance(self, rate: float, freedom: float) -> Array:
        r"""Return the covariance of the coefficients of the values under coloured noise.

        .. math:: A^{-1} X \Sigma X^T A^{-1}

        with :math:`\Sigma` the autocovariance of the residual under a half Hann window, times
        the number of samples for each degree of ``freedom``.
        """
        columns, lags = self.values[:-1], round(MAX_COLOUR_S * rate)
        residual = self.values[-1] - self.coefficients @ columns
        taper = (1 + np.cos(np.pi * np.arange(lags + 1) / (lags + 1))) / 2
        inverse = np.linalg.inv(columns @ columns.T + self.ridge * np.eye(len(columns)))
        coloured = coloured_moments(columns, residual, taper)
        return np.asarray(inverse @ coloured @ inverse * len(residual) / freedom)

    def readout(self, part: str, weights: Array) -> Array:
        """Return the matrix (degree, column) that turns all coefficients into those of a quantity.

        The quantity is a weighted sum of the signals of a part, by ``weights`` (signal,).
        """
        own = self.part == part
        matrix = np.zeros((np.max(self.degree[own]) + 1, len(own)))
        matrix[:, own] = np.kron(weights, np.eye(len(matrix)))  # columns are (signal, degree)
        return matrix / self.scale
