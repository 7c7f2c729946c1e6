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
RIDGE = 1e-6  # added to the power of each column, relative to it
MAX_COLOUR_S = 0.4  # lag at which the noise's autocorrelation has faded out
MIN_SAMPLES = 2  # for each coefficient
TIED = 0.5  # standard errors over folds by which lower orders may predict worse


class Regression(NamedTuple):
    """Signals of an ensemble in one line of time.

    ``values`` (column + 2, sample) are the regressors of all parts of the torque, divided by their
    ``scale`` (column,), which is their standard deviation, the torque, and ones. They are 0 where
    one of them is not known. ``part`` and ``degree`` (column,) are the position in :class:`Orders`
    of each regressor's part and the degree of its polynomial.
    ``moments`` (fold, column + 2, column + 2) are the products of the values in each fold.
    """

    part: NDArray[np.int64]
    degree: NDArray[np.int64]
    scale: Array
    values: Array
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
        rows = np.concatenate([*columns, torque, np.ones_like(torque)])
        values = rows[:, np.concatenate(ensemble.runs)].reshape(len(rows), -1)
        known = np.isfinite(values).all(axis=0)
        samples, count = np.flatnonzero(known), len(values) - 2
        if len(samples) < MIN_SAMPLES * count:
            raise InputError(
                f"{len(samples)} samples, at which all lags and the reflex's memory were recorded, "
                f"are too few for {count} coefficients; give a longer record, more context, a "
                "lower order or a shorter memory"
            )
        scale = values[:-2].std(axis=1, where=known)
        scale[scale == 0] = 1.0  # the constant
        values[:-2] /= scale[:, None]
        values[:, ~known] = 0.0
        edges = np.linspace(0, len(samples), FOLDS + 1).astype(int)[1:-1]
        folds = np.split(values, samples[edges], axis=1)
        return cls(
            np.repeat([Orders._fields.index(name) for name in parts], list(map(len, columns))),
            np.concatenate(
                [np.indices(each.regressors.shape[:2])[1].ravel() for each in parts.values()]
            ),
            scale,
            values,
            np.stack([fold @ fold.T for fold in folds]),
        )

    @property
    def total(self) -> Array:
        """Return the products of the values in all folds."""
        return np.asarray(self.moments.sum(axis=0))

    @property
    def coefficients(self) -> Array:
        """Return the least-squares coefficients of the values (column,)."""
        return self.solve(self.total, np.arange(len(self.scale)))

    def regularized(self, gram: Array) -> Array:
        """Return products of columns with a slight ridge, for columns that are nearly collinear."""
        return np.asarray(gram + RIDGE * self.total[-1, -1] * np.eye(gram.shape[-1]))

    def solve(self, moments: Array, kept: NDArray[np.int64]) -> Array:
        """Return least-squares coefficients of the values (…, column), 0 of those not kept."""
        coefficients = np.zeros((*moments.shape[:-2], len(self.scale)))
        gram, cross = moments[..., kept[:, None], kept], moments[..., kept, -2, None]
        coefficients[..., kept] = np.linalg.solve(self.regularized(gram), cross)[..., 0]
        return coefficients

    def held_out(self, orders: Orders) -> Array:
        """Return the VAF (fold,) of each fold by a fit to the others, in per cent."""
        kept = np.flatnonzero(self.degree <= np.array(orders)[self.part])
        return explained(self.moments, self.solve(self.total - self.moments, kept))

    def best_orders(self, orders: Sequence[Orders]) -> tuple[Orders, float]:
        """Return the lowest orders that predict folds as well as the best do, and their VAF.

        The intrinsic order, that of the reflex, and the former again are chosen beside the best of
        the other, from the first of the ``orders`` on.
        """
        best, vaf = orders[0], {}
        for fixed in ("reflex", "intrinsic", "reflex"):
            for each in orders:
                if each not in vaf and getattr(each, fixed) == getattr(best, fixed):
                    vaf[each] = self.held_out(each)
            best = max(vaf, key=lambda each: float(vaf[each].mean()))
        losses = {each: vaf[best] - own for each, own in vaf.items()}
        as_good = [
            each
            for each, loss in losses.items()
            if loss.mean() <= TIED * loss.std(ddof=1) / math.sqrt(FOLDS)
        ]
        chosen = min(as_good, key=sum)
        return chosen, float(vaf[chosen].mean())

    def covariance(self, rate: float, freedom: float) -> Array:
        r"""Return the covariance of the coefficients of the values under coloured noise.

        .. math:: A^{-1} X \Sigma X^T A^{-1}

        with :math:`\Sigma` the autocovariance of the residual under a half Hann window, times
        the number of samples for each degree of ``freedom``.
        """
        columns, lags = self.values[:-2], round(MAX_COLOUR_S * rate)
        residual = self.values[-2] - self.coefficients @ columns
        taper = (1 + np.cos(np.pi * np.arange(lags + 1) / (lags + 1))) / 2
        inverse = np.linalg.inv(self.regularized(self.total[:-2, :-2]))
        coloured = coloured_moments(columns, residual, taper)
        return np.asarray(inverse @ coloured @ inverse * len(residual) / freedom)

    def readout(self, part: str, weights: Array) -> Array:
        """Return the matrix (degree, column) that turns all coefficients into those of a quantity.

        The quantity is a weighted sum of the signals of a part, by ``weights`` (signal,).
        """
        own = self.part == Orders._fields.index(part)
        matrix = np.zeros((np.max(self.degree[own]) + 1, len(own)))
        matrix[:, own] = np.kron(weights, np.eye(len(matrix)))  # columns are (signal, degree)
        return matrix / self.scale


def explained(moments: Array, coefficients: Array) -> Array:
    """Return the variance of the torque that coefficients (…, column) account for, in per cent.

    The ``moments`` (…, column + 2, column + 2) are those of columns, torque and ones.
    """
    size = coefficients.shape[-1]

    def variance(weights: Array) -> Array:
        products = (moments @ weights[..., None])[..., 0]
        mean_square = np.sum(products * weights, axis=-1)
        return np.asarray(mean_square - products[..., -1] ** 2 / moments[..., -1, -1])

    left = np.insert(-coefficients, [size, size], [1.0, 0.0], axis=-1)
    return 100 * (1 - variance(left) / variance(np.eye(size + 2)[-2]))
