"""Least squares on the columns of all terms at once, and the choice of orders by held-out folds."""

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
from tvsysid.methods.scheduled.terms import AnyTerm, Schedule, columns_of
from tvsysid.numerics import Array
from tvsysid.numerics.noise import autocovariance
from tvsysid.signals import Ensemble

FOLDS = 5  # stretches of consecutive time, each predicted from the others
RIDGE = 1e-6  # added to each column, relative to its power; for columns that are nearly collinear
MAX_COLOUR_S = 0.4  # lag at which the noise's autocorrelation has faded out
MIN_SAMPLES = 2  # for each column
TIED = 0.5  # standard errors over folds by which lower orders may predict worse
CONSTANT = 1e-12  # relative variance below which a column is constant


Orders = tuple[int, int]  # of the intrinsic and of the reflex pathway


class Rows(NamedTuple):
    """Samples in the order of time at which all signals are known.

    ``values`` (column + 2, sample) are the columns of all ``terms``, the torque, and ones.
    ``owner`` and ``degree`` (column,) tell the term of each column, and the degree of its
    polynomial. ``variable`` is the scheduling variable. ``position`` (sample,) is that in one long
    record, with gaps longer than the noise's colour where realizations do not follow each other.
    """

    terms: tuple[AnyTerm, ...]
    schedule: Schedule
    values: Array
    owner: NDArray[np.int64]
    degree: NDArray[np.int64]
    variable: Array
    position: NDArray[np.int64]

    @classmethod
    def of(cls, terms: tuple[AnyTerm, ...], schedule: Schedule, ensemble: Ensemble) -> Rows:
        """Return the rows of an ensemble."""
        torque, variable = (
            ensemble.signal(name)[None, :, ensemble.core] for name in ("torque", schedule.name)
        )
        parts = columns_of(terms, ensemble, schedule)
        rows = np.concatenate([*parts, torque, np.ones_like(torque), variable])
        rows = rows[:, np.concatenate(ensemble.runs)].reshape(len(rows), -1)
        run = np.repeat(np.arange(len(ensemble.runs)), list(map(len, ensemble.runs)))
        gaps = np.repeat(run, ensemble.samples) * round(MAX_COLOUR_S * ensemble.sampling_rate)
        known = np.isfinite(rows).all(axis=0)
        rows, position = rows[:, known], (np.arange(rows.shape[1]) + gaps)[known]
        owner = np.repeat(np.arange(len(terms)), list(map(len, parts)))
        degrees = [
            np.arange(len(own)) % (term.order + 1) for term, own in zip(terms, parts, strict=True)
        ]
        return cls(terms, schedule, rows[:-1], owner, np.concatenate(degrees), rows[-1], position)

    @property
    def torque(self) -> Array:
        """Return the torque, shape (sample,)."""
        return np.asarray(self.values[-2])

    @property
    def folds(self) -> list[slice]:
        """Return the samples of each fold."""
        ends = np.linspace(0, len(self.variable), FOLDS + 1).astype(int)
        return [slice(first, last) for first, last in pairwise(ends)]

    def moments(self) -> Array:
        """Return the products of columns, torque and ones in each fold."""
        return np.stack([self.values[:, fold] @ self.values[:, fold].T for fold in self.folds])


class Fit(NamedTuple):
    """Least-squares solution.

    ``coefficients`` (column,), and the ``inverse`` of the columns' moments. ``held_out`` (fold,) is
    the variance of the torque in each fold accounted for by the fit to the others, in per cent.
    ``tried`` holds it for all orders that were tried, of the intrinsic and of the reflex pathway.
    """

    rows: Rows
    coefficients: Array
    inverse: Array
    held_out: Array
    tried: dict[Orders, Array]

    @classmethod
    def of(cls, rows: Rows, tried: dict[Orders, Array] | None = None) -> Fit:
        """Fit the torque with all columns."""
        moments = rows.moments()
        gram, cross, scale = _scaled(moments.sum(axis=0))
        inverse = np.linalg.inv(gram) / np.outer(scale, scale)
        return cls(rows, inverse @ (cross * scale), inverse, held_out(moments), tried or {})

    @property
    def vaf(self) -> float:
        """Return the mean variance accounted for in the folds, in per cent."""
        return float(self.held_out.mean())

    @property
    def orders(self) -> Orders:
        """Return the orders of the intrinsic and of the reflex pathway."""
        _, intrinsic, *others = self.rows.terms
        return intrinsic.order, others[-1].order if others else 0

    def covariance(self, rate: float, freedom: float) -> Array:
        r"""Return the covariance of the coefficients under coloured noise.

        .. math:: A^{-1} X \Sigma X^T A^{-1}

        with :math:`\Sigma` the autocovariance of the residual under a half Hann window, times
        the number of samples for each degree of ``freedom``.
        """
        lags, position, columns = (
            round(MAX_COLOUR_S * rate),
            self.rows.position,
            self.rows.values[:-2],
        )
        line = np.zeros((len(columns) + 1, int(position[-1]) + 1))
        line[:-1, position] = columns
        line[-1, position] = self.rows.torque - self.coefficients @ columns
        half = autocovariance(line[-1:], lags) * line.shape[1] / freedom
        half *= (1 + np.cos(np.pi * np.arange(lags + 1) / (lags + 1))) / 2
        kernel = np.concatenate([half[:0:-1], half])[None]
        coloured = scipy.signal.oaconvolve(line[:-1], kernel, mode="same", axes=1) @ line[:-1].T
        return np.asarray(self.inverse @ (coloured + coloured.T) @ self.inverse / 2)


def details_of(fit: Fit) -> dict[str, float]:
    """Return how much of the torque a fit and its pathways explain, its orders, and the limits."""
    part = np.array([term.part for term in fit.rows.terms])[fit.rows.owner]
    own = {"vaf": part != "", "vaf_intrinsic": part == "intrinsic", "vaf_reflex": part == "reflex"}
    torque, columns = fit.rows.torque, fit.rows.values[:-2]
    left = {name: torque - fit.coefficients[each] @ columns[each] for name, each in own.items()}
    details = {name: 100 * float(1 - np.var(each) / np.var(torque)) for name, each in left.items()}
    details |= {"vaf_folds": fit.vaf, "vaf_worst_fold": float(fit.held_out.min())}
    details |= dict(
        zip(("scheduling_low", "scheduling_high"), fit.rows.schedule.limits, strict=True)
    )
    return details | dict(zip(("order", "reflex_order"), map(float, fit.orders), strict=True))


def fit_best_orders(
    terms: tuple[AnyTerm, ...],
    schedule: Schedule,
    ensemble: Ensemble,
    orders: tuple[Sequence[int], Sequence[int]],
) -> Fit:
    """Fit the torque with the lowest orders that predict folds as well as the best ones do.

    ``orders`` are those to try, of the intrinsic and of the reflex pathway; the ``terms`` have the
    highest. Both orders rise together at first. Then each is chosen anew beside the other.

    Raises
    ------
    InputError
        If the samples are too few for the lowest orders.
    """
    rows = Rows.of(terms, schedule, ensemble)
    samples, moments, tried = len(rows.variable), rows.moments(), dict[Orders, Array]()

    def columns(pair: Orders) -> NDArray[np.int64]:
        limits = np.array([limit(term, pair) for term in terms])
        return np.flatnonzero(rows.degree <= limits[rows.owner])

    def best(pairs: Iterable[Orders]) -> Orders:
        for pair in pairs:
            kept = columns(pair)
            if pair not in tried and samples >= MIN_SAMPLES * len(kept):
                kept = np.append(kept, [-2, -1])
                tried[pair] = held_out(moments[:, kept[:, None], kept])
        return max(tried, key=lambda pair: float(tried[pair].mean()))

    intrinsic, reflex = orders
    lowest = len(columns((intrinsic[0], reflex[0])))
    if samples < MIN_SAMPLES * lowest:
        raise InputError(
            f"{samples} samples, at which all lags and the reflex's memory were recorded, are too "
            f"few for {lowest} coefficients; give a longer record, more context, a lower order or "
            "a shorter memory"
        )
    chosen = best((product if 1 in (len(intrinsic), len(reflex)) else zip)(intrinsic, reflex))
    chosen = best([(chosen[0], order) for order in reflex])
    chosen = best([(order, chosen[1]) for order in intrinsic])
    losses = {pair: tried[chosen] - each for pair, each in tried.items()}
    as_good = [
        pair
        for pair, loss in losses.items()
        if loss.mean() <= TIED * loss.std(ddof=1) / math.sqrt(FOLDS)
    ]
    chosen = min(as_good, key=lambda pair: (sum(pair), pair))
    kept = columns(chosen)
    own = rows._replace(
        terms=tuple(attrs.evolve(term, order=limit(term, chosen)) for term in terms),
        values=rows.values[[*kept, -2, -1]],
        owner=rows.owner[kept],
        degree=rows.degree[kept],
    )
    return Fit.of(own, tried)


def limit(term: AnyTerm, orders: Orders) -> int:
    """Return the order of a term, at most that of its pathway."""
    limits = {"rest": term.order, "intrinsic": orders[0], "reflex": orders[1]}
    return min(term.order, limits[term.part])


def held_out(moments: Array) -> Array:
    """Return the variance accounted for in each fold by the fit to the others, in per cent.

    The ``moments`` (fold, column + 2, column + 2) are those of columns, torque and ones. Variances
    are about their means.
    """
    found, whole = [], moments.sum(axis=0)
    for own in moments:
        gram, cross, scale = _scaled(whole - own)
        residual = np.append(-np.linalg.solve(gram, cross) / scale, 1.0)
        count, total = own[-1, -1], own[:-1, -1]
        left = residual @ own[:-1, :-1] @ residual - (residual @ total) ** 2 / count
        found.append(100 * (1 - left / (own[-2, -2] - total[-1] ** 2 / count)))
    return np.array(found)


def _scaled(moments: Array) -> tuple[Array, Array, Array]:
    """Return products of columns of unit variance with each other, with the torque, and the scale.

    The former have a slight ridge.
    """
    gram, cross, total, count = (
        moments[:-2, :-2],
        moments[:-2, -2],
        moments[:-2, -1],
        moments[-1, -1],
    )
    square = np.diag(gram) / count
    variance = square - (total / count) ** 2
    scale = np.sqrt(np.where(variance > CONSTANT * square, variance, square))
    scale[scale == 0] = 1.0
    ridge = RIDGE * count * np.eye(len(gram))
    return gram / np.outer(scale, scale) + ridge, cross / scale, scale
