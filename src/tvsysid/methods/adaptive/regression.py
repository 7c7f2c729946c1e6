r"""Regression of torque on angle with a stiffness that is free at each time.

.. math:: y_r(t) = k(t)\,\theta_r(t) + b\,\dot\theta_r(t) + I\,\ddot\theta_r(t) + e_r(t)

Realizations r are summed first, so that everything else is arrays over time.
"""

from __future__ import annotations

from typing import NamedTuple

import attrs
import numpy as np
from numpy.lib.stride_tricks import as_strided
from scipy.linalg import solve_triangular, toeplitz
from scipy.ndimage import convolve1d

from tvsysid.errors import InputError
from tvsysid.methods.adaptive.evidence import inverse_of
from tvsysid.methods.base import missing_edge
from tvsysid.methods.cascade.cascade import JointCascade
from tvsysid.methods.cascade.columns import readout
from tvsysid.methods.cascade.evidence import nearest_inside
from tvsysid.methods.cascade.reflex_test import MIN_TESTED_REALIZATIONS, reflex_test_of
from tvsysid.methods.cascade.result import JointCascadeModel, model
from tvsysid.methods.shared import HALF_WIDTH, independent_realizations
from tvsysid.numerics import Array
from tvsysid.numerics.decimation import decimation_weights
from tvsysid.signals import Ensemble

MIN_REALIZATIONS = 4
MIN_SAMPLES = 16  # of a realization that have derivatives
LOW_BAND = decimation_weights(1 / 0.6, 21)  # what aliasing and decimation do not change
STILL = 1e-9  # share of the mean power below which a signal is still
MISFIT_TIME = 0.05  # s over which misfit is correlated, and the strength of the noise is pooled
POOLED_TIME = 0.5  # s of all realizations but one together over which it is pooled at least
MAX_PREDICTION = 0.25  # s from which the noise is predicted
COLLINEAR = 1e-6  # determinant of the correlations of velocity and acceleration
U, V, A = range(3)  # angle, velocity, acceleration; further regressors follow, the torque is last


@attrs.frozen(eq=False, kw_only=True)
class Signals:
    """Signals of realizations, and what is known of their coefficients.

    Parameters
    ----------
    columns
        Angle, velocity, acceleration, further regressors, and torque, shape (signal, realization,
        time). The angle's coefficient is free at each time, the others are constants.
    edges
        Samples at either end of a realization that are missing.
    independent
        Number of independent realizations.
    prior_precision
        Precision of the constants' priors, times the variance of the noise, shape (constant,).
    positive
        The products of the constants with each row are not negative, shape (row, constant).
    scale
        Units of angle and torque.
    readout
        Weights (3, regressor) that give stiffness, viscosity and inertia from the coefficients.
    reflex
        Model of the reflex whose columns are among the regressors.
    """

    columns: Array
    edges: tuple[int, int]
    independent: int
    prior_precision: Array
    positive: Array
    scale: tuple[float, float] = (1.0, 1.0)
    readout: Array = attrs.field(factory=lambda: np.eye(3))
    reflex: JointCascadeModel | None = None

    @classmethod
    def of(
        cls, ensemble: Ensemble, emg: str | None, reflex: JointCascadeModel | None = None
    ) -> Signals:
        """Return the signals of an ensemble, with a reflex if held-out realizations show one.

        A channel of EMG may drive the reflex. A known ``reflex`` is not tested.
        """
        return signals_with_reflex(ensemble, emg, reflex) or cls.of_second_order(ensemble)

    @classmethod
    def of_second_order(cls, ensemble: Ensemble) -> Signals:
        """Return the signals of an ensemble in units of their root mean square."""
        edge = missing_edge(HALF_WIDTH, ensemble)
        signals = *ensemble.derivatives(), ensemble.torque[:, ensemble.core]
        scale = [float(np.sqrt(np.mean(x**2))) for x in (ensemble.angle, ensemble.torque)]
        units = np.array([scale[0]] * 3 + [scale[1]])[:, None, None]
        return cls(
            columns=np.stack(signals)[..., edge : ensemble.samples - edge] / units,
            edges=(edge, edge),
            independent=independent_realizations(ensemble),
            prior_precision=np.zeros(2),
            positive=np.zeros((0, 2)),
            scale=(scale[0], scale[1]),
        )

    def residual(self, coefficients: Array) -> Array:
        """Return the residual (realization, time) of coefficients (regressor, time)."""
        fit = np.einsum("krt,kt->rt", self.columns[:-1], coefficients)
        return np.asarray(self.columns[-1] - fit)


def signals_with_reflex(
    ensemble: Ensemble, emg: str | None, known: JointCascadeModel | None
) -> Signals | None:
    """Return signals with the columns of a reflex; None if no reflex is shown.

    The columns after the acceleration are the angle's differences of higher order (the intrinsic
    response lasts 40 ms to either side), the reflex's columns, and their derivatives by its shape.
    """
    method = JointCascade(emg=emg)
    try:
        if known is not None:
            chosen = method.refitted(ensemble, known.hyperparameters)
        elif len(ensemble) < MIN_TESTED_REALIZATIONS:
            return None
        elif emg is not None:
            chosen = method.solved(ensemble)
        elif (test := reflex_test_of(ensemble)).shown:
            chosen = method.solved(ensemble, "positive" if test.direction > 0 else "negative")
        else:
            return None
    except InputError:  # realizations are too short
        return None
    found, problem = chosen.fit, chosen.fit.problem
    data = problem.data
    if not chosen.shown or len(data.rows) < MIN_REALIZATIONS or len(data.torque.T) < MIN_SAMPLES:
        return None
    first = data.bases[0].shape[1] + data.bases[1].shape[1] + 1
    gains = problem.positive[:, problem.own :]
    constants = len(data.signals) - 1, len(problem.free)
    return Signals(
        columns=np.concatenate([data.signals, found.columns_and_slopes(), data.torque[None]]),
        edges=(data.times.start, ensemble.samples - data.times.stop),
        independent=len(data.torque) - 1,
        prior_precision=np.concatenate([[0.0, 0.0], found.precision()[first:]]),
        positive=np.pad(gains[gains.any(axis=1)], ((0, 0), constants)),
        readout=readout(chosen.search.lags, ensemble.sampling_rate),
        reflex=model(repr(method), chosen),
    )


class Constants(NamedTuple):
    """Constant coefficients beside stiffness: viscosity, inertia and further ones.

    If they are not ``identifiable``, signals are collinear. The coefficients are then 0 in the
    directions that the data do not determine.
    """

    values: Array
    covariance: Array
    identifiable: bool


def fit_constants(products: Array, power: Array, precision: Array, positive: Array) -> Constants:
    """Estimate the constants from products (constant, signal) of what stiffness leaves of them.

    The last signal is the torque. ``power`` (constant,) is that of the signals as they are. For
    ``precision`` and ``positive`` see :class:`Signals`.
    """
    size = np.sqrt(np.maximum(power + precision, np.finfo(float).tiny))
    gram, cross = products[:, :-1], products[:, -1]
    gram = (gram + gram.T) / 2 + np.diag(precision)
    eigenvalues, vectors = np.linalg.eigh(gram / np.outer(size, size))
    kept = eigenvalues > STILL
    root = vectors[:, kept] / size[:, None] / np.sqrt(eigenvalues[kept])
    values = root @ nearest_inside(cross @ root, (positive @ root).T)
    return Constants(values, root @ root.T, bool(kept.all()))


def floored(power: Array) -> Array:
    """Return the power at each time, at least a small share of its mean."""
    return np.asarray(np.maximum(power, STILL * power.mean() + np.finfo(float).tiny))


def products_at_times(columns: Array) -> Array:
    """Return sums over realizations of products at each time, shape (time, signal, signal)."""
    at_times = np.ascontiguousarray(columns.transpose(2, 0, 1))
    return at_times @ at_times.transpose(0, 2, 1)


def without_angle(products: Array) -> Array:
    """Return the products of all other signals after the angle is regressed out at each time."""
    mixed, power = products[:, 1:, U], floored(products[:, U, U])
    return products[:, 1:, 1:] - mixed[:, :, None] * mixed[:, None] / power[:, None, None]


class Weighted(NamedTuple):
    r"""Sums over realizations of products of signals with a weight W (time, time) between them.

    ``squares`` (2, 2, time, time) are products of angle and velocity, such as
    :math:`W \circ \sum_r \theta_r \dot\theta_r^T`. ``free`` (2, signal, time) are products at each
    time of angle and velocity with every signal but the angle, such as :math:`\sum_r \theta_r \circ
    W \ddot\theta_r`. In the low band, ``constants`` (constant, signal) are products with every
    signal but the angle, and ``low`` (2, constant, time) those with angle and velocity at each
    time. ``excess`` (2,) is the variance of the residual's products with angle and velocity,
    relative to what W predicts.
    """

    squares: Array
    free: Array
    constants: Array
    low: Array
    excess: Array

    @classmethod
    def by(cls, signals: Signals, filters: Array, residual: Array) -> Weighted:
        """Return the products whose weights are those of filters (time, time), squared."""
        whole = low = filters.T @ filters
        # A reflex's differences take up what decimation does to the acceleration.
        if signals.reflex is None:
            slow = convolve1d(filters, LOW_BAND, mode="constant")
            low = slow.T @ slow
        columns, both = signals.columns, signals.columns[: V + 1]
        weighted = columns[1:] @ whole
        slow_ones = weighted[:-1] if low is whole else columns[1:-1] @ low
        squares = both.swapaxes(1, 2)[:, None] @ both
        power = floored(np.diag(squares[U, U]))
        weighted_squares, excess, scores = squares * whole, [], (residual @ whole) ** 2
        for place, own in enumerate(both):
            own_power = floored(np.diag(squares[place, place]))
            predicted = floored(np.diag(weighted_squares[place, place]))
            np.fill_diagonal(weighted_squares[place, place], predicted)
            taken = np.einsum("rt,rt->t", own**2, both[U] ** 2) / (own_power * power)
            share = np.maximum(1 - taken, 1e-3) * signals.independent / len(own)
            excess.append(np.sum(own**2 * scores) / np.sum(predicted * share))
        return cls(
            weighted_squares,
            np.einsum("frt,irt->fit", both, weighted),
            np.tensordot(slow_ones, columns[1:], ((1, 2), (1, 2))),
            np.einsum("frt,irt->fit", both, slow_ones),
            np.array(excess),
        )


class FreeCoefficient(NamedTuple):
    """Coefficient of angle or velocity that is free at each time, for given other coefficients.

    ``inverse`` (time, time) is that of its products, and ``other`` (time, time) are its products
    with the other free signal. ``solved`` (time, signal) is the coefficient that explains each
    further signal, the last of which is the torque. ``of_inertia`` (time,) is its change for a unit
    of inertia, and ``covariance`` (time, time) that from noise.
    """

    inverse: Array
    other: Array
    solved: Array
    of_inertia: Array
    covariance: Array

    @classmethod
    def of(cls, signal: int, weighted: Weighted, sandwich: Weighted) -> FreeCoefficient:
        """Return the coefficient of a signal, U or V.

        ``sandwich`` are products with the covariance of the noise.
        """
        inverse = covariance = inverse_of(weighted.squares[signal, signal])
        if sandwich is not weighted:
            covariance = inverse @ sandwich.squares[signal, signal] @ inverse
        solved = inverse @ weighted.free[signal, signal:].T
        covariance = covariance * max(weighted.excess[signal], 1.0)
        other = weighted.squares[signal, 1 - signal]
        return cls(inverse, other, solved, solved[:, A - V - signal], covariance)

    def moved(self, other: Array) -> Array:
        """Return the change of the coefficient (time,) because of the other free coefficient."""
        return np.asarray(-self.inverse @ (self.other @ other))

    def values(self, constants: Array, other: Array) -> Array:
        """Return the coefficient (time,) beside constants and the other free coefficient."""
        return np.asarray(self.solved @ np.append(-constants, 1.0) + self.moved(other))

    def error(self, constants: Array, other: Array, inertia: Array) -> Array:
        """Return the covariance (time, time) of the values.

        The others are the covariances of the constants, of the other free coefficient, and of the
        changes of inertia over time that are misfit.
        """
        solved = self.solved[:, :-1]
        error = self.covariance + solved @ constants @ solved.T
        if other.any():
            moved = self.inverse @ self.other
            error += moved @ other @ moved.T
        return np.asarray(error + inertia * np.outer(self.of_inertia, self.of_inertia))


def pooling_reach(independent: int, rate: float) -> int:
    """Return the samples to either side over which the strength of the noise is pooled.

    With few realizations, the strength at a single time is uncertain.
    """
    return round(max(MISFIT_TIME, POOLED_TIME / max(independent - 1, 1)) * rate)


def whitening_filters(covariance: Array, independent: int, rate: float, periodic: bool) -> Array:
    """Return filters (time, time) that make noise of a covariance white, with unit variance.

    They predict the noise from the samples before, and divide the prediction error by its strength,
    which is pooled over time. The Bayesian information criterion gives the number of samples.
    """
    times = len(covariance)
    filters = prediction_errors(
        covariance, min(round(MAX_PREDICTION * rate), times // 4), independent
    )
    reach = min(pooling_reach(independent, rate), (times - 1) // 2)
    window, mode = np.ones(2 * reach + 1), "wrap" if periodic else "constant"
    strength = convolve1d(np.einsum("ti,ti->t", filters @ covariance, filters), window, mode=mode)
    strength /= convolve1d(np.ones(times), window, mode=mode)
    return np.asarray(filters / np.sqrt(strength)[:, None])


def prediction_errors(covariance: Array, lags: int, independent: int) -> Array:
    """Return filters (time, time) that give the noise less its prediction, with unit variance.

    The first samples are predicted from the few before them.
    """
    times, (row, column) = len(covariance), covariance.strides
    shape = times - lags, lags + 1, lags + 1
    windows = as_strided(covariance, shape, (row + column, row, column), writeable=False)
    # The last sample comes first, which is predicted from those after it.
    factor = np.linalg.cholesky(windows.sum(axis=0)[::-1, ::-1])
    first = solve_triangular(factor, np.eye(lags + 1)[0], lower=True)
    variances, samples = 1 / np.cumsum(first**2), independent * shape[0]
    penalties = np.arange(lags + 1) * np.log(samples)
    chosen = int(np.argmin(samples * np.log(variances) + penalties))
    filters = [
        solve_triangular(factor[:stop, :stop], first[:stop], lower=True, trans=1)
        for stop in range(1, chosen + 2)
    ]
    out = np.zeros((times, times))
    for time in range(times):
        order = min(time, chosen)
        out[time, time - order : time + 1] = filters[order][::-1] * np.sqrt(variances[order])
    return out


def misfit_correlation(times: int, rate: float) -> Array:
    """Return the correlation of the misfit at two times, shape (time, time)."""
    return np.asarray(toeplitz(np.exp(-np.arange(times) / (rate * MISFIT_TIME))))


def misfit_variances(products: Array, coefficients: Array, independent: int) -> Array:
    """Return variances by which viscosity and inertia seem to change, beyond the noise, (2,).

    This is misfit that all realizations share: a response that is not of second order. At each time
    the residual of the ``coefficients`` (regressor, time) is regressed on velocity and
    acceleration. The regression coefficients vary more than by chance where there is misfit.
    """
    beside = without_angle(products)
    gram = beside[:, :2, :2]
    powers = floored(products[:, V, V]) * floored(products[:, A, A])
    known = np.linalg.det(gram) > COLLINEAR * powers
    if independent < 6 or known.sum() < 20:
        return np.zeros(2)
    weights = np.concatenate([-coefficients[1:], np.ones((1, len(products)))]).T[known]
    residual = np.einsum("tij,tj->ti", beside[known], weights)
    inverse = np.linalg.inv(gram[known])
    moved = np.einsum("tij,tj->ti", inverse, residual[:, :2])
    left = np.sum(weights * residual, axis=1) - np.sum(moved * residual[:, :2], axis=1)
    share = np.einsum("tii->ti", inverse)
    chance = share * np.maximum(left, 0.0)[:, None] / max(independent - 5, 1)
    weight = 1 / share / np.sum(1 / share, axis=0)
    excess = moved**2 - chance
    mean = np.sum(weight * excess, axis=0)
    variance = np.minimum(
        5 * np.sum((weight * (excess - mean)) ** 2, axis=0),
        10 * np.sum((weight * chance) ** 2, axis=0),
    )
    return np.asarray(np.maximum(mean - 2 * np.sqrt(variance), 0.0))
