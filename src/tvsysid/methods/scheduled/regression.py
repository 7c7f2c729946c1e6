"""Least squares on the columns of all terms at once, and the choice of orders by held-out folds."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tvsysid.dataset_layout import UNITS
from tvsysid.errors import InputError
from tvsysid.methods.scheduled.model import Curve, Design
from tvsysid.numerics import Array
from tvsysid.numerics.noise import coloured_moments
from tvsysid.signals import Ensemble

FOLDS = 5  # stretches of consecutive time, each predicted from the others
RIDGE = 1e-6  # added to each column, relative to its power; for columns that are nearly collinear
MAX_COLOUR_S = 0.4  # lag at which the noise's autocorrelation has faded out
MIN_SAMPLES = 2  # for each coefficient
TIED = 0.5  # standard errors over folds by which lower orders may predict worse
CONSTANT = 1e-12  # relative variance below which a column is constant

Orders = tuple[int, int]  # of the intrinsic and of the reflex pathway


class Regression(NamedTuple):
    """Signals of an ensemble in one line of time.

    ``values`` (column + 2, sample) are the columns of all terms, the torque, and ones. They are 0
    where one of them is not known. ``owner`` (column,) is the position of each column's term, and
    ``degree`` that of its polynomial.
    ``moments`` (fold, column + 2, column + 2) are the products of the values in each fold.
    ``coefficients`` (column,) are those of the least-squares fit.
    """

    design: Design
    owner: NDArray[np.int64]
    degree: NDArray[np.int64]
    values: Array
    moments: Array
    coefficients: Array

    @classmethod
    def of(cls, design: Design, ensemble: Ensemble) -> Regression:
        """Return the regression of an ensemble.

        Raises
        ------
        InputError
            If the samples are too few.
        """
        columns, terms = design.columns(ensemble), design.terms
        torque = ensemble.torque[None, :, ensemble.core]
        rows = np.concatenate([*columns, torque, np.ones_like(torque)])
        values = rows[:, np.concatenate(ensemble.runs)].reshape(len(rows), -1)
        known = np.isfinite(values).all(axis=0)
        values[:, ~known] = 0.0
        samples, count = np.flatnonzero(known), len(values) - 2
        if len(samples) < MIN_SAMPLES * count:
            raise InputError(
                f"{len(samples)} samples, at which all lags and the reflex's memory were recorded, "
                f"are too few for {count} coefficients; give a longer record, more context, a "
                "lower order or a shorter memory"
            )
        edges = np.linspace(0, len(samples), FOLDS + 1).astype(int)[1:-1]
        folds = np.split(values, samples[edges], axis=1)
        moments = np.stack([fold @ fold.T for fold in folds])
        degrees = [
            np.arange(len(own)) % (term.order + 1) for own, term in zip(columns, terms, strict=True)
        ]
        return cls(
            design,
            np.repeat(np.arange(len(terms)), [len(own) for own in columns]),
            np.concatenate(degrees),
            values,
            moments,
            solve(moments.sum(axis=0)),
        )

    def inverse(self) -> Array:
        """Return the inverse of the columns' moments."""
        gram, _, scale = normal_equations(self.moments.sum(axis=0))
        return np.asarray(np.linalg.inv(gram) / np.outer(scale, scale))

    def vaf(self, *parts: str) -> float:
        """Return the variance of the torque that some parts account for, in per cent."""
        counted = np.array([term.part in parts for term in self.design.terms])[self.owner]
        return float(explained(self.moments.sum(axis=0), counted * self.coefficients))

    def covariance(self, rate: float, freedom: float) -> Array:
        r"""Return the covariance of the coefficients under coloured noise.

        .. math:: A^{-1} X \Sigma X^T A^{-1}

        with :math:`\Sigma` the autocovariance of the residual under a half Hann window, times
        the number of samples for each degree of ``freedom``.
        """
        columns, lags = self.values[:-2], round(MAX_COLOUR_S * rate)
        residual = self.values[-2] - self.coefficients @ columns
        taper = (1 + np.cos(np.pi * np.arange(lags + 1) / (lags + 1))) / 2
        coloured = coloured_moments(columns, residual, taper)
        inverse = self.inverse()
        return inverse @ coloured @ inverse * len(residual) / freedom

    def curves(self, covariance: Array, freedom: float = np.inf) -> dict[str, Curve]:
        """Return the curve of each quantity, from the covariance of the coefficients."""
        curves = {}
        for place, term in enumerate(self.design.terms):
            own = self.owner == place
            for name, weights in term.quantities.items():
                readout = np.kron(weights, np.eye(term.order + 1))  # columns are (signal, degree)
                spread = readout @ covariance[np.ix_(own, own)] @ readout.T
                mean = readout @ self.coefficients[own]
                curves[name] = Curve(self.design, UNITS[name], mean, spread, freedom)
        return curves

    def best_orders(self, orders: Sequence[int], reflex_orders: Sequence[int]) -> Orders:
        """Return the lowest orders that predict folds as well as the best do.

        The regression has the highest ones. Both orders rise together at first. Then each is chosen
        anew beside the other.
        """
        tried: dict[Orders, Array] = {}

        def best(pairs: Iterable[Orders]) -> Orders:
            for pair in set(pairs) - tried.keys():
                limits = {"intrinsic": pair[0], "reflex": pair[1]}
                highest = [limits.get(term.part, np.inf) for term in self.design.terms]
                kept = np.flatnonzero(self.degree <= np.array(highest)[self.owner])
                kept = np.append(kept, [-2, -1])
                tried[pair] = held_out(self.moments[:, kept[:, None], kept])
            return max(tried, key=lambda pair: float(tried[pair].mean()))

        chosen = best(zip(orders, reflex_orders, strict=False))
        chosen = best((chosen[0], order) for order in reflex_orders)
        chosen = best((order, chosen[1]) for order in orders)
        losses = {pair: tried[chosen] - each for pair, each in tried.items()}
        as_good = [
            pair
            for pair, loss in losses.items()
            if loss.mean() <= TIED * loss.std(ddof=1) / math.sqrt(FOLDS)
        ]
        return min(as_good, key=lambda pair: (sum(pair), pair))


def held_out(moments: Array) -> Array:
    """Return the VAF of each fold by a fit to the others, from the moments of each, in per cent."""
    return explained(moments, solve(moments.sum(axis=0) - moments))


def explained(moments: Array, coefficients: Array) -> Array:
    """Return the variance of the torque that coefficients (…, column) account for, in per cent.

    The ``moments`` (…, column + 2, column + 2) are those of columns, torque and ones.
    """
    sums, count = moments[..., :-1, -1:], moments[..., -1:, -1:]
    centred = moments[..., :-1, :-1] - sums * sums.swapaxes(-1, -2) / count
    weights = np.insert(-coefficients, coefficients.shape[-1], 1.0, axis=-1)
    left = np.einsum("...i,...ij,...j->...", weights, centred, weights)
    return np.asarray(100 * (1 - left / centred[..., -1, -1]))


def solve(moments: Array) -> Array:
    """Return least-squares coefficients (…, column)."""
    gram, cross, scale = normal_equations(moments)
    return np.asarray(np.linalg.solve(gram, cross[..., None])[..., 0] / scale)


def normal_equations(moments: Array) -> tuple[Array, Array, Array]:
    """Return moments of columns scaled to unit variance, those with the torque, and the scale.

    The former have a slight ridge.
    """
    gram, cross, sums = moments[..., :-2, :-2], moments[..., :-2, -2], moments[..., :-2, -1]
    count = moments[..., -1, -1:]
    square = np.diagonal(gram, axis1=-2, axis2=-1) / count
    variance = square - (sums / count) ** 2
    scale = np.sqrt(np.where(variance > CONSTANT * square, variance, square))
    scale = np.where(scale > 0, scale, 1.0)
    ridge = RIDGE * count[..., None] * np.eye(gram.shape[-1])
    return gram / (scale[..., :, None] * scale[..., None, :]) + ridge, cross / scale, scale
