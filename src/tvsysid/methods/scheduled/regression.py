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
from tvsysid.numerics.gaussian import Moments, Posterior, solve
from tvsysid.numerics.noise import coloured_moments
from tvsysid.signals import Ensemble

FOLDS = 5  # stretches of consecutive time, each predicted from the others
RIDGE = 1e-6  # added to the power of each column, relative to it
MAX_COLOUR_S = 0.4  # lag at which the noise's autocorrelation has faded out
MIN_SAMPLES = 2  # for each coefficient
TIED = 0.5  # standard errors over folds by which lower orders may predict worse


class Regression(NamedTuple):
    """Signals of an ensemble in one line of time.

    ``values`` (column + 2, sample) are the columns of the regression, which are the regressors of
    all parts of the torque, then the torque, and ones. They are 0 where one of them is not known.
    ``part`` and ``degree`` (column,) are the name of each regressor's part, as in
    :class:`Orders`, and the degree of its polynomial.
    ``ridge`` (column,) is added to the regressors' squares, for columns that are nearly collinear.
    ``moments`` (fold, column + 2, column + 2) are the products of the values in each fold.
    """

    part: NDArray[np.str_]
    degree: NDArray[np.int64]
    ridge: Array
    values: Array
    moments: Array

    @classmethod
    def of(cls, parts: Parts, ensemble: Ensemble) -> Regression:
        """Return the regression of an ensemble, whose realizations are in the order of time."""
        torque = ensemble.torque[None, :, ensemble.core]
        columns = [each.regressors.reshape(-1, *torque.shape[1:]) for each in parts.values()]
        values = np.concatenate([*columns, torque, np.ones_like(torque)])
        values = values.reshape(len(values), -1)
        # Polynomials of all degrees are known at the same samples
        lowest = np.concatenate([each.regressors[:, 0] for each in parts.values()])
        known = np.isfinite(lowest).all(axis=0).ravel()
        values[:, ~known] = 0.0
        samples = np.flatnonzero(known)
        edges = np.linspace(0, len(samples), FOLDS + 1).astype(int)[1:-1]
        folds = np.split(values, samples[edges], axis=1)
        moments = np.stack([fold @ fold.T for fold in folds])
        total = moments.sum(axis=0)
        power = (total.diagonal() - total[-1] ** 2 / len(samples))[:-2]
        return cls(
            np.repeat(list(parts), list(map(len, columns))),
            np.concatenate(
                [np.indices(each.regressors.shape[:2])[1].ravel() for each in parts.values()]
            ),
            RIDGE * np.where(power > 0, power, len(samples)),  # the constant has no power
            values,
            moments,
        )

    def columns(self, orders: Orders) -> NDArray[np.int64]:
        """Return the indices of the columns of lower orders."""
        return np.flatnonzero(self.degree <= [getattr(orders, name) for name in self.part])

    def subset(self, orders: Orders) -> Regression:
        """Return the regression with lower orders."""
        columns = self.columns(orders)
        rows = np.append(columns, [-2, -1])
        return Regression(
            self.part[columns],
            self.degree[columns],
            self.ridge[columns],
            self.values[rows],
            self.moments[:, rows[:, None], rows],
        )

    @property
    def total(self) -> Array:
        """Return the products of the values in all folds."""
        return self.moments.sum(axis=0)

    @property
    def posterior(self) -> Posterior:
        """Return the least-squares coefficients and their inverse factor."""
        return solve(Moments.of(self.total[:-1, :-1], self.total[-1, -1]), self.ridge)

    def held_out(self, orders: Orders, part: str) -> Array:
        """Return the VAF (degree, fold) of each fold by a fit to the others, in per cent.

        The degrees of one ``part`` are those from 0 to its order.
        """
        columns = self.columns(orders)
        degree = self.degree[columns] * (self.part[columns] == part)
        columns = columns[np.argsort(degree, kind="stable")]
        rows = np.append(columns, [-2, -1])
        moments = self.moments[:, rows[:, None], rows]
        others = moments.sum(axis=0) - moments
        # An inverse Cholesky factor makes columns orthonormal in their order. So the fit to the
        # first of them is a partial sum.
        fits = (solve(Moments.of(each[:-1, :-1], 0.0), self.ridge[columns]) for each in others)
        factors = np.stack([each.inverse_factor for each in fits])
        terms = factors * (factors @ others[:, :-2, -2:-1])
        last = np.cumsum(np.bincount(degree)) - 1
        return explained(moments, np.cumsum(terms, axis=1)[:, last]).T

    def best_orders(self, orders: Sequence[Orders], reflex: str) -> tuple[Orders, float]:
        """Return the lowest orders that predict folds as well as the best do, and their VAF.

        Choose the intrinsic order, that of the ``reflex``, and the intrinsic one again, each beside
        the best other, from the first of the ``orders`` on.

        Raises
        ------
        InputError
            If the samples are too few for the last orders.
        """
        samples, count = int(self.total[-1, -1]), len(self.columns(orders[-1]))
        if samples < MIN_SAMPLES * count:
            raise InputError(
                f"{samples} samples, at which all lags and the reflex's memory were recorded, are "
                f"too few for {count} coefficients; give a longer record, more context, a lower "
                "order or a shorter memory"
            )
        best, vaf = orders[0], dict[Orders, Array]()
        for part in ("intrinsic", reflex, "intrinsic"):
            tried = [
                each for each in orders if each == best._replace(**{part: getattr(each, part)})
            ]
            if not vaf.keys() >= set(tried):
                held_out = self.held_out(tried[-1], part)
                vaf |= {each: held_out[getattr(each, part)] for each in tried}
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
        r"""Return the covariance of the coefficients under coloured noise.

        .. math:: A^{-1} X \Sigma X^T A^{-1}

        A are the products of the columns X plus the ridge, :math:`\Sigma` is the autocovariance of
        the residual under a half Hann window, times the number of samples for each degree of
        ``freedom``.
        """
        columns, lags = self.values[:-2], round(MAX_COLOUR_S * rate)
        residual = self.values[-2] - self.posterior.mean @ columns
        taper = (1 + np.cos(np.pi * np.arange(lags + 1) / (lags + 1))) / 2
        inverse = self.posterior.covariance
        coloured = coloured_moments(columns, residual, taper)
        return inverse @ coloured @ inverse * len(residual) / freedom

    def readout(self, part: str, weights: Array) -> Array:
        """Return the matrix (degree, column) that turns all coefficients into those of a quantity.

        The quantity is a weighted sum of the signals of a part, by ``weights`` (signal,).
        """
        own = self.part == part
        matrix = np.zeros((np.max(self.degree[own]) + 1, len(own)))
        matrix[:, own] = np.kron(weights, np.eye(len(matrix)))  # columns are (signal, degree)
        return matrix


def explained(moments: Array, coefficients: Array) -> Array:
    """Return the variance of the torque that each fit accounts for, in per cent.

    The ``coefficients`` have shape (…, fit, column). The ``moments`` (…, column + 2, column + 2)
    are those of columns, torque and ones.
    """
    size = coefficients.shape[-1]

    def spread(weights: Array) -> Array:  # sum of squares about the mean
        products = weights @ moments
        squares = np.sum(products * weights, axis=-1)
        return squares - products[..., -1] ** 2 / moments[..., -1:, -1]

    left = np.insert(-coefficients, [size, size], [1.0, 0.0], axis=-1)
    return 100 * (1 - spread(left) / spread(np.eye(size + 2)[-2:-1]))
