r"""Regression of torque on angle with a stiffness that is free at each time.

.. math:: y_r(t) = k(t)\,\theta_r(t) + b\,\dot\theta_r(t) + I\,\ddot\theta_r(t) + e_r(t)

Realizations r are summed first, so that everything else is arrays over time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import solve_triangular, toeplitz
from scipy.ndimage import convolve1d

from tvsysid.methods.adaptive.evidence import FreeEstimate
from tvsysid.methods.adaptive.posterior import Mixture
from tvsysid.methods.adaptive.prior import DECIMATOR_REACH, USUAL_TAPS, Axis
from tvsysid.methods.adaptive.signals import Signals
from tvsysid.numerics import Array
from tvsysid.numerics.decimation import decimation_weights
from tvsysid.numerics.gaussian import Moments, solve
from tvsysid.signals import Ensemble

LOW_BAND = decimation_weights(1 / 0.6, 21)  # what aliasing and decimation do not change
STILL = 1e-9  # share of the mean power below which a signal is still
MISFIT_TIME = 0.05  # s over which misfit is correlated, and the strength of the noise is pooled
POOLED_TIME = 0.5  # s of all realizations but one together over which it is pooled at least
MAX_PREDICTION = 0.25  # s from which the noise is predicted
COLLINEAR = 1e-6  # share of power that is added where velocity and acceleration are collinear
WHITE_SHARE = 0.01  # of the noise's variance that is white at least: the rest may be misfit
MIN_NOISE = 1e-8  # share of the torque's power that is taken as noise
MISFIT_SHARE = 30.0  # the same where the residual is misfit
MAX_EXCESS = 1.5  # of the variance of the products with velocity up to which noise is whitened
UNKNOWN = 1e4  # standard error, in sizes, of the coefficient of a signal that is still
U, V, A = range(3)  # angle, velocity, acceleration; further regressors follow, the torque is last


class FreeEstimates:
    """Stiffness and viscosity of an ensemble, free at each time, and the constants beside them.

    ``coefficients`` (regressor, time) are the latest ones, which give the noise. ``products``
    (time, signal, signal) are sums over realizations.
    """

    constants: Constants
    coefficients: Array
    misfit: Array

    def __init__(self, ensemble: Ensemble, signals: Signals) -> None:
        self.ensemble, self.signals, self.whitens = ensemble, signals, True
        at_times = np.ascontiguousarray(signals.columns.transpose(2, 0, 1))
        self.products = at_times @ at_times.transpose(0, 2, 1)
        recorded = ensemble.recorded_angle
        self.axis = Axis(
            len(at_times),
            periodic=2 * len(ensemble.runs) <= len(ensemble) and not any(signals.edges),
            taps=USUAL_TAPS if recorded is None else DECIMATOR_REACH / recorded.shape[-1],
            realizations=at_times.shape[-1],
        )
        white = Weighted.by(signals.columns, np.eye(len(at_times)), low_band=False)
        self.weights = white, white
        self._solve(signals.prior_precision)

    def stiffness(self, viscosity: Mixture | None) -> FreeEstimate:
        """Estimate stiffness beside a viscosity, which is a constant if it is None."""
        signals, columns = self.signals, self.signals.columns.copy()
        known, variance = np.zeros((2, self.axis.times))
        if viscosity is not None:
            self.coefficients[V] = known = viscosity.mean()
            variance = viscosity.variance()
            columns[-1] -= known * columns[V]
        precision = signals.prior_precision / self._weigh(columns)
        precision[0] += (viscosity is not None) * UNKNOWN**2 * self.weights[0].constants[0, 0]
        free, values = self._solve(precision), self.coefficients[U]
        self.coefficients[V] += known
        self.misfit = np.zeros((2, self.axis.times, self.axis.times))
        if not self.whitens:
            lags = np.arange(self.axis.times) / self.ensemble.sampling_rate
            variances = misfit_variances(self.products, self.coefficients, signals.independent)
            self.misfit = np.multiply.outer(variances, toeplitz(np.exp(-lags / MISFIT_TIME)))
        other = signals.change_covariance + np.diag(variance) + self.misfit[0]
        return self._estimate(
            U, values, free.error(self.constants.covariance, other, self.misfit[1])
        )

    def viscosity(self, stiffness: Mixture) -> FreeEstimate:
        """Estimate viscosity beside the stiffness that was estimated last."""
        free, constants = FreeCoefficient.of(V, *self.weights), self.constants
        known = self.coefficients[V] - constants.values[0]
        values = known + free.values(constants.values[1:]) - free.moved @ stiffness.mean()
        other = np.diag(stiffness.variance())
        error = free.error(constants.covariance[1:, 1:], other, self.misfit[1])
        return self._estimate(V, values, error)

    def _solve(self, precision: Array) -> FreeCoefficient:
        """Estimate the constants, and stiffness beside them. Return that of the angle."""
        weighted, sandwich = self.weights
        free = FreeCoefficient.of(U, weighted, sandwich)
        power, true_power = (np.diag(each.constants) for each in self.weights)
        beside = weighted.constants - weighted.low @ free.solved
        found = fit_constants(beside, power, precision)
        stronger = np.sqrt(true_power / np.maximum(power, np.finfo(float).tiny))
        covariance = found.covariance * np.outer(stronger, stronger)
        self.constants = found._replace(covariance=covariance)
        constants = np.repeat(found.values[:, None], self.axis.times, axis=1)
        self.coefficients = np.vstack([free.values(found.values), constants])
        return free

    def _weigh(self, columns: Array) -> float:
        """Set the weights from the residual, and return the mean variance of the noise.

        The weights are products that give the estimates, and products that give their covariance,
        which is the inverse of the first ones around these, a sandwich. Where the noise is
        whitened, both are the same. Whitening would amplify misfit. So where the residual's
        products with velocity show misfit, they are weighted almost alike.
        """
        signals, times = self.signals, self.axis.times
        residual = signals.residual(self.coefficients)
        covariance = residual.T @ residual / max(signals.independent - 1, 1)
        torque_power = float(self.products[:, -1, -1].mean()) / len(self.ensemble)
        noise = float(np.trace(covariance)) / times + MIN_NOISE * torque_power

        def filters_with(white_share: float) -> Array:
            more = covariance + white_share * noise * np.eye(times)
            rate, periodic = self.ensemble.sampling_rate, self.axis.periodic
            return whitening_filters(more, signals.independent, rate, periodic)

        # A reflex's differences take up what decimation does to the acceleration.
        low_band, filters = signals.reflex is None, filters_with(WHITE_SHARE)
        self.whitens = self.whitens and excess_variance(signals, filters, residual) < MAX_EXCESS
        if self.whitens:
            self.weights = (Weighted.by(columns, filters, low_band),) * 2
        else:
            mild = filters_with(MISFIT_SHARE)
            coloured = np.asarray(np.linalg.inv(filters).T @ (mild.T @ mild), dtype=np.float64)
            weighted, sandwich = (Weighted.by(columns, each, low_band) for each in (mild, coloured))
            self.weights = weighted, sandwich
        return noise

    def _estimate(self, signal: int, values: Array, error: Array) -> FreeEstimate:
        """Return the free estimate of a signal's coefficient, with its error.

        Its size is the mean weighted by the signal's power, and never 0. Where the signal does not
        move, the error is very large, however small the noise.
        """
        own = self.products[:, signal, signal]
        power = floored(own)
        mean = float(values @ power / np.sum(power))
        least = 1e-6 * float(np.sqrt(np.mean(self.products[:, -1, -1]) / np.mean(power)))
        size, still = max(abs(mean), least), own < power
        whitener = size * inverse_root(error + np.diag(still * (UNKNOWN * size) ** 2))
        estimate = FreeEstimate(self.axis, np.where(still, mean, values) / size, whitener, size)
        return estimate if self.whitens else estimate.with_misfit()


class Constants(NamedTuple):
    """Constant coefficients beside stiffness: viscosity, inertia and further ones.

    If they are not ``identifiable``, signals are collinear. The coefficients are then 0 in the
    directions that the data do not determine.
    """

    values: Array
    covariance: Array
    identifiable: bool


def fit_constants(products: Array, power: Array, precision: Array) -> Constants:
    """Estimate the constants from products (constant, signal) of what stiffness leaves of them.

    The last signal is the torque. ``power`` (constant,) is that of the signals as they are,
    ``precision`` (constant,) the prior's, times the variance of the noise.
    """
    size = np.sqrt(np.maximum(power + precision, np.finfo(float).tiny))
    gram, cross = products[:, :-1], products[:, -1]
    gram = (gram + gram.T) / 2 + np.diag(precision)
    eigenvalues, vectors = np.linalg.eigh(gram / np.outer(size, size))
    kept = eigenvalues > STILL
    root = vectors[:, kept] / size[:, None] / np.sqrt(eigenvalues[kept])
    covariance = root @ root.T
    return Constants(covariance @ cross, covariance, bool(kept.all()))


def floored(power: Array) -> Array:
    """Return the power (..., time), at least a small share of its mean over time."""
    least = STILL * power.mean(axis=-1, keepdims=True) + np.finfo(float).tiny
    return np.asarray(np.maximum(power, least))


def inverse_root(matrix: Array) -> Array:
    """Return W with WᵀW the inverse of a positive definite matrix."""
    none = np.zeros(len(matrix))
    return solve(Moments(matrix, none, 0.0, 0.0), none).inverse_factor


class Weighted(NamedTuple):
    r"""Sums over realizations of products of signals with a weight W (time, time) between them.

    ``squares`` (2, 2, time, time) are products of angle and velocity, such as
    :math:`W \circ \sum_r \theta_r \dot\theta_r^T`. ``free`` (2, signal, time) are products at each
    time of angle and velocity with every signal but the angle, such as :math:`\sum_r \theta_r \circ
    W \ddot\theta_r`. In the low band, ``constants`` (constant, signal) are products with every
    signal but the angle, and ``low`` (constant, time) those with the angle at each time.
    """

    squares: Array
    free: Array
    constants: Array
    low: Array

    @classmethod
    def by(cls, columns: Array, filters: Array, low_band: bool) -> Weighted:
        """Return the products whose weights are those of filters (time, time), squared."""
        both, whole = columns[: V + 1], filters.T @ filters
        weighted = columns[V:] @ whole
        slow = weighted[:-1]
        if low_band:
            low = convolve1d(filters, LOW_BAND, mode="constant")
            slow = columns[V:-1] @ (low.T @ low)
        squares = both.swapaxes(1, 2)[:, None] @ both * whole
        for own in (squares[U, U], squares[V, V]):
            np.fill_diagonal(own, floored(np.diag(own)))
        return cls(
            squares,
            np.einsum("frt,irt->fit", both, weighted),
            np.tensordot(slow, columns[V:], ((1, 2), (1, 2))),
            np.einsum("rt,irt->it", columns[U], slow),
        )


class FreeCoefficient(NamedTuple):
    """Coefficient of angle or velocity that is free at each time, for given other coefficients.

    ``solved`` (time, signal) is the coefficient that explains each further signal, the last of
    which is the torque. ``of_inertia`` (time,) is its change for a unit of inertia, ``moved``
    (time, time) that for the other free coefficient, and ``covariance`` (time, time) that from
    noise.
    """

    solved: Array
    of_inertia: Array
    moved: Array
    covariance: Array

    @classmethod
    def of(cls, signal: int, weighted: Weighted, sandwich: Weighted) -> FreeCoefficient:
        """Return the coefficient of a signal, U or V.

        ``sandwich`` are products with the covariance of the noise.
        """
        root = inverse_root(weighted.squares[signal, signal])
        inverse = covariance = root.T @ root
        if sandwich is not weighted:
            covariance = inverse @ sandwich.squares[signal, signal] @ inverse
        solved = inverse @ weighted.free[signal, signal:].T
        moved = inverse @ weighted.squares[signal, 1 - signal]
        return cls(solved, solved[:, A - V - signal], moved, covariance)

    def values(self, constants: Array) -> Array:
        """Return the coefficient (time,) beside constants."""
        return np.asarray(self.solved @ np.append(-constants, 1.0))

    def error(self, constants: Array, other: Array, inertia: Array) -> Array:
        """Return the covariance (time, time) of the values.

        ``constants`` is the covariance of the constants, ``other`` (time, time) that of the other
        free coefficient, and ``inertia`` (time, time) that of misfit of the inertia.
        """
        solved = self.solved[:, :-1]
        error = self.covariance + solved @ constants @ solved.T + self.moved @ other @ self.moved.T
        return np.asarray(error + inertia * np.outer(self.of_inertia, self.of_inertia))


def excess_variance(signals: Signals, filters: Array, residual: Array) -> float:
    """Return the variance of the residual's products with velocity, relative to its expectation.

    The expectation is that of noise that filters (time, time) make white.
    """
    weights, (angles, velocities) = filters.T @ filters, signals.columns[: V + 1] ** 2
    power = floored(velocities.sum(axis=0))
    taken = np.sum(angles * velocities, axis=0) / (floored(angles.sum(axis=0)) * power)
    share = np.maximum(1 - taken, 1e-3) * signals.independent / len(residual)
    expected = np.sum(power * np.diag(weights) * share)
    return float(np.sum(velocities * (residual @ weights) ** 2) / expected)


def misfit_variances(products: Array, coefficients: Array, independent: int) -> Array:
    """Return variances by which viscosity and inertia seem to change, beyond the noise, (2,).

    This is misfit that all realizations share: a response that is not of second order. At each time
    the residual of the ``coefficients`` (regressor, time) is regressed on velocity and
    acceleration. The regression coefficients vary more than by chance where there is misfit.
    """
    mixed, powers = products[:, V:, U], floored(np.einsum("tii->it", products))
    beside = products[:, V:, V:] - mixed[:, :, None] * mixed[:, None] / powers[U, :, None, None]
    weights = np.concatenate([-coefficients[1:], np.ones((1, len(products)))]).T
    residual = np.einsum("tij,tj->ti", beside, weights)
    # Where both signals are collinear, their coefficients are uncertain, and count little.
    ridge = np.eye(2) * COLLINEAR * powers[V : A + 1].T[:, :, None]
    inverse = np.linalg.inv(beside[:, :2, :2] + ridge)
    change = np.einsum("tij,tj->ti", inverse, residual[:, :2])
    left = np.sum(weights * residual, axis=1) - np.sum(change * residual[:, :2], axis=1)
    variance = np.einsum("tii->ti", inverse)
    by_chance = variance * np.maximum(left, 0.0)[:, None] / max(independent - 5, 1)
    return np.maximum(np.average(change**2 - by_chance, axis=0, weights=1 / variance), 0.0)


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
    strength = convolve1d(np.sum(filters @ covariance * filters, axis=1), window, mode=mode)
    strength /= convolve1d(np.ones(times), window, mode=mode)
    return np.asarray(filters / np.sqrt(strength)[:, None])


def prediction_errors(covariance: Array, lags: int, independent: int) -> Array:
    """Return filters (time, time) that give the noise less its prediction, with unit variance.

    The first samples are predicted from the few before them.
    """
    times, size = len(covariance), lags + 1
    mean = np.einsum("ttij->ij", sliding_window_view(covariance, (size, size)))
    # The last sample comes first, which is predicted from those after it.
    factor = np.linalg.cholesky(mean[::-1, ::-1])
    first = solve_triangular(factor, np.eye(size)[0], lower=True)
    variances, samples = 1 / np.cumsum(first**2), independent * (times - lags)
    criterion = samples * np.log(variances) + np.arange(size) * np.log(samples)
    out = np.zeros((times, times))
    for order in range(int(np.argmin(criterion)) + 1):
        own = factor[: order + 1, : order + 1]
        weights = solve_triangular(own, first[: order + 1], lower=True, trans=1)[::-1]
        for time in range(order, times):
            out[time, time - order : time + 1] = weights * np.sqrt(variances[order])
    return out
