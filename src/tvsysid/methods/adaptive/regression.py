r"""Regression of torque on angle with a stiffness that is free at each time.

.. math:: y_r(t) = k(t)\,\theta_r(t) + b\,\dot\theta_r(t) + I\,\ddot\theta_r(t) + e_r(t)

The estimates need only :class:`Products`, which are sums over realizations r. New weights between
times need new sums.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple, Self

import attrs
import numpy as np
from scipy.linalg import toeplitz
from scipy.ndimage import convolve1d

from tvsysid.methods.adaptive.averaging import Mixture
from tvsysid.methods.adaptive.evidence import FreeEstimate
from tvsysid.methods.adaptive.prior import DECIMATOR_REACH, USUAL_FILTER_REACH, Axis
from tvsysid.methods.base import missing_edge
from tvsysid.methods.cascade.cascade import JointCascadeModel, joint_model
from tvsysid.methods.cascade.search import Selection
from tvsysid.methods.shared import independent_realizations
from tvsysid.numerics import Array
from tvsysid.numerics.decimation import decimation_weights
from tvsysid.numerics.differentiation import HALF_WIDTH
from tvsysid.numerics.gaussian import Moments, solve
from tvsysid.numerics.whitening import MISFIT_TIME, whitening_filters
from tvsysid.signals import Ensemble

LOW_BAND = decimation_weights(1 / 0.6, 21)  # passes frequencies that decimation leaves as they are
MIN_POWER = 1e-9  # share of the mean power below which a signal counts as zero
COLLINEAR = 1e-6  # share of power that is added where velocity and acceleration are collinear
WHITE_SHARE = 0.01  # white noise that is added to the residual's covariance, in noise variances
MISFIT_SHARE = 30.0  # the same where the residual is misfit
MIN_NOISE = 1e-8  # noise variance at least, as a share of the torque's power
MAX_EXCESS = 1.5  # excess variance (of misfit) up to which the noise is whitened
HOLDING_PRECISION = 1e8  # prior precision that holds a coefficient at 0, relative to its power
U, V, A = range(3)  # angle, velocity, acceleration; constants begin with V, so A - V is inertia


@attrs.frozen(eq=False, kw_only=True)
class Regressors:
    """Regressors and torque of realizations, and what is known of their coefficients.

    Parameters
    ----------
    columns
        Angle, velocity, acceleration, further regressors, and torque, shape (signal, realization,
        time). The angle's coefficient is free at each time. Those of the other regressors are the
        constants.
    edges
        Samples at either end of a realization that are missing.
    independent
        Number of independent realizations.
    prior_precision
        Precision of the constants' priors, times the variance of the noise, shape (constant,).
    reflex
        Model of the reflex whose columns are among the regressors. Its viscosity changes over
        time. The torque of that change about its mean is subtracted from the torque.
    change_covariance
        Covariance (time, time) of that change.
    """

    columns: Array
    edges: tuple[int, int]
    independent: int
    prior_precision: Array
    reflex: JointCascadeModel | None = None
    change_covariance: Array | float = 0.0

    @cached_property
    def lagged(self) -> Array:
        """Return products (2, 2, time, time) of angle and velocity, between any two times."""
        both = self.columns[: V + 1]
        return both.swapaxes(1, 2)[:, None] @ both

    @classmethod
    def of_second_order(cls, ensemble: Ensemble) -> Regressors:
        """Return the signals of an ensemble without a reflex."""
        edge = missing_edge(HALF_WIDTH, ensemble)
        signals = *ensemble.derivatives(), ensemble.torque[:, ensemble.core]
        return cls(
            columns=np.stack(signals)[..., edge : ensemble.samples - edge],
            edges=(edge, edge),
            independent=independent_realizations(ensemble),
            prior_precision=np.zeros(2),
        )

    @classmethod
    def with_reflex(cls, ensemble: Ensemble, selection: Selection) -> Regressors:
        """Return the signals of an ensemble with the selected reflex.

        Three kinds of columns follow the acceleration: differences of the angle of order 3 and more
        (an intrinsic response beyond inertia), responses of the reflex, and derivatives of the
        reflex's torque by the parameters of its shape.
        """
        fit, data = selection.reflex, selection.reflex.data
        first, count = sum(data.sizes[:3]), data.intrinsic_count  # first: after the inertia
        of_viscosity = np.arange(len(data.sizes)) == 1
        change = data.features(of_viscosity)[data.times]
        change = change - change.mean(axis=0)  # the mean is a constant that is estimated again
        torque = data.torque - change @ fit.posterior.mean[:count] * data.signals[1]
        parts = data.signals, fit.late_columns, torque[None]
        return cls(
            columns=np.concatenate(parts),
            edges=(data.times.start, ensemble.samples - data.times.stop),
            independent=len(data.torque) - 1,
            prior_precision=np.concatenate([[0.0, 0.0], fit.precision[first:]]),
            reflex=joint_model(selection),
            change_covariance=change @ fit.covariance[:count, :count] @ change.T,
        )


class FreeRegression:
    """Regressions that give a stiffness or a viscosity at each time, and the constants beside them.

    ``coefficients`` (regressor, time) are those of the last fit, whose residual gives the noise.
    ``products`` (time, signal, signal) are sums over realizations. ``constants`` are the
    coefficients of velocity, acceleration and further regressors, with a ``covariance``.
    ``identifiable`` is False if these signals are collinear. The constants are then 0 in the
    directions that the data do not determine. ``whitens`` is False if the residual is misfit.
    ``misfit`` are then the covariances (2, time, time) of viscosity and inertia that it adds.
    ``weighted`` are products for the estimates, and for their covariance.
    """

    coefficients: Array
    constants: Array
    covariance: Array
    identifiable: bool
    misfit: Array
    whitens: bool

    def __init__(self, ensemble: Ensemble, signals: Regressors) -> None:
        self.ensemble = ensemble
        self.signals = signals
        at_times = np.ascontiguousarray(signals.columns.transpose(2, 0, 1))
        self.products = at_times @ at_times.transpose(0, 2, 1)
        recorded = ensemble.recorded_angle
        reach = USUAL_FILTER_REACH if recorded is None else DECIMATOR_REACH / recorded.shape[-1]
        # A run is a series of realizations that follow each other in the record.
        mostly_follow = 2 * len(ensemble.runs) <= len(ensemble)
        self.axis = Axis(
            len(at_times),
            periodic=mostly_follow and not any(signals.edges),
            filter_reach=reach,
            realizations=at_times.shape[-1],
        )
        white = Products.of(signals, np.eye(len(at_times)), low_band=False)
        self.weighted = white, white
        self._solve(np.zeros(len(at_times)), signals.prior_precision)

    def stiffness(self, viscosity: Mixture | None) -> FreeEstimate:
        """Estimate stiffness beside a viscosity, which is a constant if it is None."""
        signals = self.signals
        times = self.axis.times
        known, variance = np.zeros((2, times))
        if viscosity is not None:
            self.coefficients[V] = known = viscosity.mean()
            variance = viscosity.variance()
        noise = self._weigh()
        precision = signals.prior_precision / noise
        if viscosity is not None:  # it replaces the constant one, which is held at 0
            precision[0] = HOLDING_PRECISION * self.weighted[0].gram[0, 0]
        free = self._solve(known, precision)
        lags = np.arange(times) / self.ensemble.sampling_rate
        variances = misfit_variances(self.products, self.coefficients, signals.independent)
        misfit = np.multiply.outer(variances, toeplitz(np.exp(-lags / MISFIT_TIME)))
        self.misfit = misfit * (not self.whitens)
        other = signals.change_covariance + np.diag(variance) + self.misfit[0]
        return self._estimate(
            U, self.coefficients[U], free.error(self.covariance, other, self.misfit[1])
        )

    def viscosity(self, stiffness: Mixture) -> FreeEstimate:
        """Estimate viscosity beside the stiffness that was estimated last."""
        free = FreeCoefficient.of(V, *self.weighted)
        values = free.values(self.constants[1:], stiffness.mean())  # without the constant viscosity
        other = np.diag(stiffness.variance())
        return self._estimate(V, values, free.error(self.covariance[1:, 1:], other, self.misfit[1]))

    def _solve(self, known: Array, precision: Array) -> FreeCoefficient:
        """Estimate the constants, and stiffness beside them and a ``known`` viscosity (time,).

        ``precision`` (constant,) is the prior's. Return the coefficient of the angle.
        """
        weighted, noise_weighted = self.weighted
        free = FreeCoefficient.of(U, weighted, noise_weighted)
        # Normal equations of the constants, after the free stiffness is eliminated
        normal = weighted.gram - weighted.mixed[U] @ free.explaining
        cross = normal[:, -1] - (weighted.mixed[V] - weighted.mixed[U] @ free.coupling) @ known
        # Not symmetric: constants are estimated in the low band, stiffness is not.
        gram = (normal[:, :-1] + normal[:, :-1].T) / 2 + np.diag(precision)
        power = np.maximum(weighted.gram.diagonal(), np.finfo(float).tiny)
        size = np.sqrt(power + precision)
        eigenvalues, vectors = np.linalg.eigh(gram / np.outer(size, size))
        kept = eigenvalues > MIN_POWER
        root = vectors[:, kept] / size[:, None] / np.sqrt(eigenvalues[kept])
        self.constants = root @ (root.T @ cross)
        self.identifiable = bool(kept.all())
        # An approximate sandwich: for each constant, noise is louder than assumed by this factor.
        louder = np.sqrt(noise_weighted.gram.diagonal() / power)
        self.covariance = root @ root.T * np.outer(louder, louder)
        constants = np.repeat(self.constants[:, None], self.axis.times, axis=1)
        self.coefficients = np.vstack([free.values(self.constants, known), constants])
        self.coefficients[V] += known
        return free

    def _weigh(self) -> float:
        """Weight the products by the residual, and return the mean variance of the noise.

        The first products G of ``weighted`` give the estimates. The second ones S give their
        covariance, the sandwich G⁻¹ S G⁻¹. If the noise is whitened, both are the same. Where the
        residual's products with velocity show misfit, which whitening would amplify, the weights of
        G are almost those of white noise.
        """
        signals = self.signals
        times = self.axis.times
        columns = signals.columns
        residual = columns[-1] - np.einsum("krt,kt->rt", columns[:-1], self.coefficients)
        covariance = residual.T @ residual / (signals.independent - 1)
        torque_power = float(self.products[:, -1, -1].mean()) / len(self.ensemble)
        noise = float(np.trace(covariance)) / times + MIN_NOISE * torque_power

        def filters_with(white_share: float) -> Array:
            more = covariance + white_share * noise * np.eye(times)
            rate = self.ensemble.sampling_rate
            periodic = self.axis.periodic
            return whitening_filters(more, signals.independent, rate, periodic)

        def weighted_by(filters: Array) -> Products:
            # With a reflex, velocity and acceleration are those of the angle as it was recorded,
            # so no low band is needed.
            return Products.of(signals, filters, low_band=signals.reflex is None)

        filters = filters_with(WHITE_SHARE)
        self.whitens = excess_variance(signals, filters, residual) < MAX_EXCESS
        if self.whitens:
            self.weighted = (weighted_by(filters),) * 2
        else:
            mild = filters_with(MISFIT_SHARE)
            # With W the mild weights and N the noise's covariance, S = W N W = FᵀF.
            of_noise = np.linalg.inv(filters).T @ (mild.T @ mild)
            self.weighted = weighted_by(mild), weighted_by(np.asarray(of_noise, dtype=np.float64))
        return noise

    def _estimate(self, signal: int, values: Array, error: Array) -> FreeEstimate:
        """Return the free estimate of a coefficient, relative to its mean weighted by power."""
        size = abs(float(np.average(values, weights=self.products[:, signal, signal])))
        estimate = FreeEstimate(self.axis, values / size, size * inverse_root(error), size)
        return estimate if self.whitens else estimate.with_misfit()


def floored(power: Array) -> Array:
    """Return the power (..., time), at least a small share of its mean over time."""
    floor = MIN_POWER * power.mean(axis=-1, keepdims=True) + np.finfo(float).tiny
    return np.maximum(power, floor)


def inverse_root(matrix: Array) -> Array:
    """Return W with WᵀW the inverse of a positive definite matrix."""
    none = np.zeros(len(matrix))
    return solve(Moments(matrix, none, 0.0, 0.0), none).inverse_factor


class Products(NamedTuple):
    r"""Sums over realizations in the normal equations, with weights W (time, time) between times.

    ``free_gram`` (2, 2, time, time) are for angle and velocity with a coefficient at each time,
    such as :math:`W \circ \sum_r \theta_r \dot\theta_r^T`, and ``free_cross`` (2, signal, time)
    for these and every signal but the angle, such as :math:`\sum_r \theta_r \circ W
    \ddot\theta_r`. ``gram`` (constant, signal): each column that has a constant coefficient, times
    each signal but the angle. ``mixed`` (2, constant, time): the same columns, times angle and
    velocity at each time. The axes of signals and constants begin with the velocity; that of the
    signals ends with the torque.
    """

    free_gram: Array
    free_cross: Array
    gram: Array
    mixed: Array

    @classmethod
    def of(cls, signals: Regressors, filters: Array, low_band: bool) -> Self:
        """Return the products with W = FᵀF of filters F (time, time).

        Those of the constants may be restricted to the ``low_band``.
        """
        columns = signals.columns
        both = columns[: V + 1]  # angle and velocity
        weights = filters.T @ filters
        weighted = columns[V:] @ weights
        fixed = weighted[:-1]  # columns with constant coefficients
        if low_band:
            low = convolve1d(filters, LOW_BAND, mode="constant")
            fixed = columns[V:-1] @ (low.T @ low)
        free_gram = signals.lagged * weights
        for own in (free_gram[U, U], free_gram[V, V]):
            np.fill_diagonal(own, floored(np.diag(own)))
        free_cross, mixed = (np.einsum("frt,irt->fit", both, each) for each in (weighted, fixed))
        gram = np.einsum("irt,jrt->ij", fixed, columns[V:], optimize=True)
        return cls(free_gram, free_cross, gram, mixed)


class FreeCoefficient(NamedTuple):
    """Coefficient of angle or velocity that is free at each time, for given other coefficients.

    Column j of ``explaining`` (time, signal) is the coefficient that would fit signal j in place
    of the torque. The signals are those that follow this one in the columns of
    :class:`Regressors`, the torque last. The coefficient is the torque's column, minus each other
    signal's column times its constant, minus ``coupling`` (time, time) @ the other free
    coefficient.
    ``covariance`` (time, time) is due to noise.
    ``inertia`` is the index of the acceleration among these signals.
    """

    inertia: int
    explaining: Array
    coupling: Array
    covariance: Array

    @classmethod
    def of(cls, signal: int, weighted: Products, noise_weighted: Products) -> Self:
        """Return the coefficient of a signal, U or V.

        ``noise_weighted`` are products with the covariance of the noise.
        """
        root = inverse_root(weighted.free_gram[signal, signal])
        inverse = covariance = root.T @ root
        if noise_weighted is not weighted:
            covariance = inverse @ noise_weighted.free_gram[signal, signal] @ inverse
        # Signals are numbered from V on here: those from ``signal`` on follow this one.
        explaining = inverse @ weighted.free_cross[signal, signal:].T
        coupling = inverse @ weighted.free_gram[signal, 1 - signal]
        return cls(A - 1 - signal, explaining, coupling, covariance)

    def values(self, constants: Array, other: Array) -> Array:
        """Return the coefficient for given constants and the other free coefficient (time,)."""
        return self.explaining @ np.append(-constants, 1.0) - self.coupling @ other

    def error(self, constants: Array, other: Array, inertia: Array) -> Array:
        """Return the covariance (time, time) of the values.

        The covariances are those of the ``constants``, of the ``other`` free coefficient (time,
        time), and of the misfit of the ``inertia`` (time, time).
        """
        by_constants = self.explaining[:, :-1]
        by_inertia = self.explaining[:, self.inertia]
        error = self.covariance + by_constants @ constants @ by_constants.T
        error += self.coupling @ other @ self.coupling.T
        return error + inertia * np.outer(by_inertia, by_inertia)


def excess_variance(signals: Regressors, filters: Array, residual: Array) -> float:
    """Return the variance of the residual's products with velocity, relative to its expectation.

    The expectation is that of noise that filters (time, time) make white.
    """
    weights = filters.T @ filters
    squares = signals.columns[V] ** 2
    power = squares.sum(axis=0) @ np.diag(weights) * signals.independent / len(residual)
    return float(np.sum(squares * (residual @ weights) ** 2) / power)


def misfit_variances(products: Array, coefficients: Array, independent: int) -> Array:
    """Return the variances (2,) over time of viscosity and inertia that noise does not explain.

    All realizations share this misfit: a response not of second order. At each time the residual of
    the ``coefficients`` (regressor, time) is regressed on velocity and acceleration. Where there is
    misfit, the regression coefficients vary more than by chance.
    """
    mixed = products[:, V:, U]
    powers = floored(np.einsum("tii->it", products))
    # Products of what is left of signals after a regression on the angle
    partial = products[:, V:, V:] - mixed[:, :, None] * mixed[:, None] / powers[U, :, None, None]
    # Weights of signals in the residual, and the residual's products with signals
    weights = np.concatenate([-coefficients[1:], np.ones((1, len(products)))]).T[:, :, None]
    cross = partial @ weights
    # Where both signals are collinear, their coefficients are uncertain, and count little.
    ridge = np.eye(2) * COLLINEAR * powers[V : A + 1].T[:, :, None]
    inverse = np.linalg.inv(partial[:, :2, :2] + ridge)
    change = inverse @ cross[:, :2]
    unexplained = np.sum(weights * cross, axis=1) - np.sum(change * cross[:, :2], axis=1)
    variance = np.einsum("tii->ti", inverse)
    # By chance, change**2 has the mean variance * (unexplained / f) * f / (f - 2): Student's t with
    # f = independent - 3 degrees of freedom, for angle, velocity and acceleration.
    by_chance = variance * np.maximum(unexplained, 0.0) / max(independent - 3 - 2, 1)
    excess = change[..., 0] ** 2 - by_chance
    return np.maximum(np.average(excess, axis=0, weights=1 / variance), 0.0)
