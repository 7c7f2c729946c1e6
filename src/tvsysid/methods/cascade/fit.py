"""Fit both pathways in one regression. Gauss-Newton steps find the shape of the reflex."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property, lru_cache
from typing import Any

import attrs
import numpy as np
from scipy.linalg import toeplitz

from tvsysid.methods.cascade.columns import (
    Columns,
    Modulated,
    convolved,
    deviations,
    muscle,
    products,
)
from tvsysid.methods.cascade.data import MAX_WINDOW, Data
from tvsysid.methods.cascade.evidence import (
    USUAL_PARAMETERS,
    Prior,
    decays_off,
    log_evidence,
    ridge,
)
from tvsysid.methods.cascade.reflex_test import predicts_better
from tvsysid.numerics import Array
from tvsysid.numerics.bases import FourierSeries
from tvsysid.numerics.gaussian import Moments, Posterior, solve
from tvsysid.numerics.noise import autocorrelation

CACHED_DELAYS = 4  # of the basis of the gain

DEFAULT: Any = attrs.NOTHING  # a field with this value is computed anew

# A reflex's shape is log frequency (rad/s), log damping, threshold (rad/s) and delay (s).
NUMBERS = ("frequency", "damping", "threshold", "delay")
FREQUENCY, DAMPING, THRESHOLD, DELAY = range(4)
IS_LOG = np.arange(4) < THRESHOLD
# Mean and standard deviation of the prior, bounds, and step of numerical derivatives.
MEAN, SPREAD, LOWEST, HIGHEST, STEP = np.array(
    [
        (math.log(16), 0.6, math.log(3), math.log(60), 1e-3),
        (math.log(0.8), 0.5, math.log(0.2), math.log(3), 1e-3),
        (0.0, 0.3, 0.0, 2.0, 0.02),
        (0.045, 0.010, 0.035, 0.075, 1e-4),
    ]
).T
MAX_STEPS, MAX_HALVINGS, ROUNDS = 8, 6, 2
SMALLEST_STEP = 0.02  # in standard deviations of the prior


@attrs.frozen(eq=False)
class Fit:
    """Posterior of the coefficients for a shape of the reflex and hyperparameters.

    Parameters
    ----------
    data
        Torque and intrinsic signals.
    drive
        Rows (realization, history + time) that drive the reflex for a threshold, as deviations
        from their mean over realizations; 0 where nothing was recorded. None without a reflex.
    free
        Numbers of the shape that are estimated.
    shape
        Shape of the reflex.
    positive
        The products of the coefficients with each row are not negative, shape (row, column).
    products
        Products of the torque, which is first, and all columns.
    parameters
        Hyperparameters; by default those of greatest evidence.
    """

    data: Data
    drive: Callable[[float], Array] | None
    free: list[int]
    shape: Array
    positive: Array | None = None
    products: Array = attrs.field()
    parameters: Array = attrs.field()
    posterior: Posterior = attrs.field(init=False)

    @products.default
    def _all_products(self) -> Array:
        known = np.sum(self.data.fold_products, axis=0)
        return products(self._columns(), self.data.windows, known)

    @parameters.default
    def _tuned_parameters(self) -> Array:
        return self.prior.tuned(self.moments, USUAL_PARAMETERS)

    @posterior.default
    def _posterior(self) -> Posterior:
        spread = self.prior.spread(self.moments, self.parameters)
        return ridge(self.moments, spread, self.positive)

    @property
    def prior(self) -> Prior:
        """Return the prior of the coefficients."""
        sizes = np.diff([*self.data.starts, self.data.own]).tolist()
        return Prior.of(tuple(sizes), 0 if self.drive is None else self._units)

    @property
    def moments(self) -> Moments:
        """Return the moments of all columns."""
        return _moments(self.products, self.data.number)

    @property
    def objective(self) -> float:
        """Return the log evidence, and the log densities of shape and hyperparameters."""
        shape = ((self.shape - MEAN) / SPREAD)[self.free]
        squares = np.sum(shape**2) + np.sum(decays_off(self.parameters) ** 2)
        return log_evidence(self.posterior, self.moments.square) - 0.5 * float(squares)

    @property
    def _units(self) -> int:
        return 2 * self.data.gain.harmonics + 1

    def _driven(self, shape: Array) -> tuple[Array, Array, Array]:
        """Return the drive, the functions of the gain at the times of arrival, and the muscle."""
        assert self.drive is not None
        data, drive = self.data, self.drive(float(shape[THRESHOLD]))
        times = data.times.stop - drive.shape[1], data.times.stop
        gain = _arriving(data.gain, *times, data.rate, float(shape[DELAY]), data.period)
        return drive, gain, muscle(shape, drive.shape[1], data.rate)

    def reflex(self, shape: Array, coefficients: Array) -> Array:
        """Return the reflex torque (realization, time) as a deviation from its mean.

        The gain is that at the time of arrival.
        """
        drive, gain, response = self._driven(shape)
        torque = convolved(drive * (gain @ coefficients), response)
        torque = torque[:, -self.data.torque.shape[1] :]
        return deviations(torque) if len(torque) == 1 else torque

    def _columns(self) -> list[Columns]:
        """Return the torque and all columns."""
        if self.drive is None:
            return self.data.columns
        if self._units == 1 or self.data.are_few:
            return [*self.data.columns, self.reflex_columns()]
        drive, gain, response = self._driven(self.shape)
        times = self.data.torque.shape[1]
        history, longest = drive.shape[1] - times, min(times, MAX_WINDOW)
        response = np.pad(response, (0, history + longest))
        later = response[history : history + longest]
        matrix = toeplitz(later, np.pad(response[history::-1], (0, longest - 1)))
        return [*self.data.columns, Modulated(drive, gain, matrix)]

    def torques(self, coefficients: Array | None = None) -> tuple[Array, Array]:
        """Return intrinsic and reflex torque (realization, time), less their means."""
        data = self.data
        coefficients = self.posterior.mean if coefficients is None else coefficients
        own, gain = np.split(coefficients, [data.own])
        torque = np.einsum("ts,srt->rt", data.over_time(own)[data.times], data.signals)
        intrinsic = deviations(torque) if len(torque) == 1 else torque
        reflex = np.zeros_like(torque) if self.drive is None else self.reflex(self.shape, gain)
        return intrinsic, reflex

    @property
    def left(self) -> Array:
        """Return the residual torque (realization, time)."""
        return np.asarray(self.data.torque - np.sum(self.torques(), axis=0))

    @cached_property
    def held_out(self) -> Array:
        """Return the residual torque (realization, time) of coefficients of the other folds.

        NaN if there is a single fold.
        """
        data, left = self.data, np.full_like(self.data.torque, np.nan)
        spread = self.prior.spread(self.moments, self.parameters)
        for known, rows in zip(data.fold_products, data.folds, strict=True):
            if len(data.folds) > 1:
                own = products(self._columns(), data.windows, known, rows)
                share = 1 - len(data.torque[rows]) / len(data.torque)
                others = _moments(self.products - own, share * data.number)
                torques = self.torques(ridge(others, spread, self.positive).mean)
                left[rows] = (data.torque - np.sum(torques, axis=0))[rows]
        return left

    def share(self) -> float:
        """Return the share of the held-out torque's square that the fit predicts."""
        return 1 - float(np.sum(self.held_out**2) / np.sum(self.data.torque**2))

    def better_than(self, other: Fit) -> float:
        """Return the probability that this fit predicts so much better by chance."""
        squares = self.data.squares
        return predicts_better(squares(self.held_out), squares(other.held_out))

    def _moved(self, numbers: list[int], values: Array) -> Array:
        """Return the shape with other numbers, kept within their bounds."""
        shape = self.shape.copy()
        shape[numbers] = np.clip(values, LOWEST[numbers], HIGHEST[numbers])
        return shape

    def reflex_columns(self) -> Array:
        """Return the columns of the reflex (column, realization, time)."""
        return np.stack([self.reflex(self.shape, unit) for unit in np.eye(self._units)])

    def slopes(self) -> Array:
        """Return the derivatives (number, realization, time) of the reflex torque by its shape."""
        coefficients, slopes = self.posterior.mean[self.data.own :], []
        for number in self.free:
            steps = self.shape[number] + STEP[number] * np.array([-1, 1])
            ends = [self._moved([number], step) for step in steps]
            earlier, later = (self.reflex(end, coefficients) for end in ends)
            slopes.append((later - earlier) / (ends[1] - ends[0])[number])
        return np.array(slopes).reshape(-1, *self.data.torque.shape)

    def moments_with_slopes(self, true: Array | None = None) -> Moments:
        """Return the moments of all columns, and of the torque's derivatives by the shape.

        With the noise's ``true`` autocorrelation they are those of the sandwich covariance.
        """
        known = self.products if true is None else np.zeros((0, 0))
        windows = self.data.windows if true is None else self.data.weights(true)
        parts = self._columns() + [self.slopes()] * bool(self.free)
        return _moments(products(parts, windows, known), self.data.number)

    @property
    def freedom(self) -> float:
        """Return the degrees of freedom of the noise variance."""
        return max(1.0, self.data.number - self.posterior.effective - len(self.free))

    @cached_property
    def covariance(self) -> Array:
        r"""Return the sandwich covariance of the coefficients and the free numbers of the shape.

        .. math:: H^{-1} \left(\Phi^T Q \Sigma Q \Phi + \sigma^4 P^{-1}\right) H^{-1}, \qquad
                  H = \Phi^T Q \Phi + \sigma^2 P^{-1}

        The derivatives by the shape are among the columns. P is the prior's covariance, Q the
        weights of the samples, and :math:`\Sigma` the noise's autocovariance within a realization,
        from the residual.
        """
        left, precision = self.left, self.precision()
        inverse = solve(self.moments_with_slopes(), precision).covariance
        coloured = self.moments_with_slopes(autocorrelation(left, 0.0)).gram
        variance = float(np.sum(left**2)) / self.freedom
        prior = self.posterior.noise_variance * (inverse * precision) @ inverse
        return np.asarray(variance * inverse @ coloured @ inverse + prior)

    def precision(self) -> Array:
        """Return the prior precision of coefficients and shape, times the noise variance."""
        own = np.concatenate([self.posterior.precision, SPREAD[self.free] ** -2])
        return np.asarray(self.posterior.noise_variance * own)

    def improved(self) -> Fit:
        """Return the fit after some Gauss-Newton steps, each halved until it is better.

        A step of the free numbers is solved for with all coefficients.
        """
        fit, free = self, self.free
        for _ in range(MAX_STEPS if free else 0):
            moments = fit.moments_with_slopes()
            away = np.zeros(len(moments.cross))
            away[-len(free) :] = (MEAN - fit.shape)[free]
            shifted = moments._replace(cross=moments.cross - moments.gram @ away)
            step = (solve(shifted, fit.precision()).mean + away)[-len(free) :]
            if np.max(np.abs(step) / SPREAD[free]) < SMALLEST_STEP:
                break
            numbers = fit.shape[free]
            shapes = (fit._moved(free, numbers + step / 2**n) for n in range(MAX_HALVINGS))
            tried = (attrs.evolve(fit, shape=shape, products=DEFAULT) for shape in shapes)
            better = next((each for each in tried if each.objective > fit.objective), None)
            if better is None:
                break
            fit = better
        return fit

    def refined(self) -> Fit:
        """Return the fit with hyperparameters and shape improved in turn."""
        fit = self
        for _ in range(ROUNDS if self.free else 0):
            fit = fit.improved()
            fit = attrs.evolve(fit, parameters=fit.prior.tuned(fit.moments, fit.parameters))
        return fit


@lru_cache(CACHED_DELAYS)
def _arriving(
    gain: FourierSeries, start: int, stop: int, rate: float, delay: float, period: float
) -> Array:
    """Return the functions of the gain at the times of arrival."""
    return gain((np.arange(start, stop) / rate + delay) / period)


def _moments(products: Array, number: float) -> Moments:
    """Return the moments of columns that follow the torque."""
    return Moments(products[1:, 1:], products[1:, 0], float(products[0, 0]), number)
