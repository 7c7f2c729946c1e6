"""Fit both pathways in one regression. Gauss-Newton steps find the shape of the reflex."""

from __future__ import annotations

import math
from functools import cached_property

import attrs
import numpy as np
import scipy

from tvsysid.methods.cascade.columns import Data
from tvsysid.methods.cascade.pathways import Stretch
from tvsysid.numerics import Array
from tvsysid.numerics.gaussian import Moments, Posterior, solve
from tvsysid.numerics.noise import autocorrelation

# Constants of stiffness, viscosity and inertia have an almost flat prior, relative to the noise.
FLAT_FAMILIES, FLAT_LOG_SIZE = 3, math.log(1e4)
DECAY_MEAN, DECAY_SPREAD = 1.5, 2.0  # of the weak prior of a decay
# Families are stiffness, viscosity, inertia, differences and reflex gain. The parameters are the
# sizes of their constants and harmonics, and the decays of the latter.
FAMILIES = FLAT_FAMILIES + 2
IS_DECAY = np.repeat([False, False, True], FAMILIES)
BOUNDS = np.where(IS_DECAY[:, None], (0.6, 6.0), (-9.0, 3.0))
BOUNDS[:FLAT_FAMILIES] = FLAT_LOG_SIZE  # these sizes are known
USUAL_PARAMETERS = np.where(IS_DECAY, DECAY_MEAN, 0.0).clip(*BOUNDS.T)
MAX_ITERATIONS = 100  # of the search for the hyperparameters


# A reflex's shape is log frequency (rad/s), log damping, threshold (rad/s) and delay (s).
SHAPE_NAMES = ("frequency", "damping", "threshold", "delay")
THRESHOLD, DELAY = 2, 3
IS_LOG = np.arange(4) < THRESHOLD
# Mean and standard deviation of the prior, bounds, and step of numerical derivatives. The delay
# is known.
MEAN, SPREAD, LOWEST, HIGHEST, STEP = np.array(
    [
        (math.log(16), 0.6, math.log(3), math.log(60), 1e-3),
        (math.log(0.8), 0.5, math.log(0.2), math.log(3), 1e-3),
        (0.0, 0.3, 0.0, 2.0, 0.02),
    ]
).T
MAX_STEPS, MAX_HALVINGS = 8, 6  # of Gauss-Newton, and of each of its steps
SMALLEST_STEP = 0.02  # in standard deviations of the prior
USUAL_DELAY_S = 0.04  # from velocity to torque
USUAL_SHAPE = np.array([*MEAN, USUAL_DELAY_S])


@attrs.frozen(eq=False)
class Fit:
    """Posterior of the coefficients of both pathways, for a shape and hyperparameters.

    Parameters
    ----------
    data
        Torque and intrinsic signals.
    drive
        Drive of the reflex, with any threshold. None without a reflex.
    shape
        Shape of the reflex, with its threshold.
    free
        How many numbers of the shape are estimated: the first ones.
    parameters
        Hyperparameters; by default those of greatest evidence.
    positive
        Rows (row, column) whose products with the coefficients must not be negative.
    """

    data: Data
    drive: Stretch | None
    shape: Array
    free: int
    parameters: Array = attrs.field()
    positive: Array | None = None

    @parameters.default
    def tuned(self, start: Array = USUAL_PARAMETERS) -> Array:
        """Return the hyperparameters of greatest evidence near a start."""
        _, design = self.prior

        def cost(parameters: Array) -> tuple[float, Array]:
            found = posterior_of(self.moments, self.spread_of(parameters))
            off = decays_off(parameters)
            gradient = 2 * found.variance_gradient @ design - off / DECAY_SPREAD
            evidence = relative_log_evidence(found, self.moments.square)
            return 0.5 * float(off @ off) - evidence, -gradient

        options = {"maxiter": MAX_ITERATIONS, "ftol": 1e-14, "gtol": 1e-7}
        found = scipy.optimize.minimize(
            cost, start, jac=True, method="L-BFGS-B", bounds=BOUNDS, options=options
        )
        return np.asarray(found.x)

    def reflex(self, coefficients: Array) -> Array:
        """Return the torques of a reflex. See :meth:`Data.reflex`."""
        if self.drive is None:
            return np.zeros((0, *self.data.torque.shape))
        return self.data.reflex(self.drive, self.shape, coefficients)

    @cached_property
    def reflex_columns(self) -> Array:
        """Return the columns of the reflex (column, realization, time)."""
        return self.reflex(np.eye(2 * self.data.gain.harmonics + 1))

    @cached_property
    def products(self) -> Array:
        """Return the products (fold, column, column) of columns and torque."""
        return self.data.products(self.reflex_columns)

    @cached_property
    def moments(self) -> Moments:
        """Return the moments of all columns."""
        return Moments.of(self.products.sum(axis=0), self.data.number)

    @cached_property
    def prior(self) -> tuple[Array, Array]:
        r"""Return the log prior standard deviations of the coefficients, as offset and design.

        They are relative to the noise: ``offset + design @ parameters``. Each family of columns has
        three parameters: the size of its constant, and :math:`\log\gamma` and :math:`\nu`, which
        give :math:`\log\gamma - \nu \log h` for its h-th harmonic. Signals beyond the acceleration
        are one family. Sizes are those for columns of unit RMS.
        """
        sizes = [*self.data.sizes, len(self.reflex_columns)]
        order = np.concatenate([np.arange(1, size + 1) // 2 for size in sizes])
        starts = np.cumsum([0, *sizes[:-1]])
        family = [*np.arange(len(sizes) - 1).clip(max=FLAT_FAMILIES), FAMILIES - 1]
        is_own = np.eye(FAMILIES)[np.repeat(family, sizes)]
        weights = order == 0, order > 0, -np.log(order.clip(1))
        design = np.concatenate([is_own * each[:, None] for each in weights], axis=1)
        power = np.diag(self.moments.gram)[np.repeat(starts, sizes)] / self.moments.number
        return -0.5 * np.log(np.where(power > 0, power, 1.0)), design

    def spread_of(self, parameters: Array) -> Array:
        """Return the prior standard deviations of the coefficients relative to the noise."""
        offset, design = self.prior
        return np.asarray(np.exp(offset + design @ parameters))

    @cached_property
    def spread(self) -> Array:
        """Return the prior standard deviations with the hyperparameters of the fit."""
        return self.spread_of(self.parameters)

    @cached_property
    def posterior(self) -> Posterior:
        """Return the posterior of the coefficients."""
        return posterior_of(self.moments, self.spread, self.positive)

    @cached_property
    def objective(self) -> float:
        """Return the log evidence, and the log densities of shape and hyperparameters."""
        shape = (self.shape[: self.free] - MEAN[: self.free]) / SPREAD[: self.free]
        squares = np.sum(shape**2) + np.sum(decays_off(self.parameters) ** 2)
        square = self.moments.square
        return relative_log_evidence(self.posterior, square) - 0.5 * float(squares)

    @property
    def residual(self) -> Array:
        """Return the residual torque (realization, time)."""
        return self.data.residual(self.posterior.mean, self.reflex_columns)

    @cached_property
    def held_out(self) -> Array:
        """Return the residual torque (realization, time) of each fold, fitted to the other folds.

        NaN if there is a single fold.
        """

        def fitted(moments: Moments) -> Array:
            return posterior_of(moments, self.spread, self.positive).mean

        return self.data.held_out(self.products, self.reflex_columns, fitted)

    def share(self) -> float:
        """Return the share of the held-out torque's square that the fit predicts."""
        return 1 - float(np.sum(self.held_out**2) / np.sum(self.data.torque**2))

    def with_shape(self, values: Array) -> Fit:
        """Return the fit with other free numbers of the shape, kept within their bounds."""
        shape = self.shape.copy()
        shape[: self.free] = np.clip(values, LOWEST[: self.free], HIGHEST[: self.free])
        return attrs.evolve(self, shape=shape)

    def slopes(self) -> Array:
        """Return the derivatives (number, realization, time) of the reflex torque by its shape."""
        coefficients, slopes = self.posterior.mean[self.data.intrinsic_count :, None], []
        numbers = self.shape[: self.free]
        for step in np.diag(STEP[: self.free]):
            ends = [self.with_shape(numbers + each) for each in (-step, step)]
            change = ends[1].reflex(coefficients) - ends[0].reflex(coefficients)
            # One number differs, by less than two steps at its bounds.
            slopes.append(change[0] / np.sum(ends[1].shape - ends[0].shape))
        return np.array(slopes).reshape(-1, *self.data.torque.shape)

    @cached_property
    def every_column(self) -> Array:
        """Return the columns of the reflex, and the torque's derivatives by the shape."""
        return np.concatenate([self.reflex_columns, self.slopes()])

    @cached_property
    def inverse(self) -> Array:
        """Return the posterior covariance of coefficients and shape over the noise variance."""
        return solve(self.data.moments(self.every_column), self.precision).covariance

    @property
    def freedom(self) -> float:
        """Return the degrees of freedom of the noise variance."""
        return max(1.0, self.data.number - self.posterior.effective - self.free)

    @cached_property
    def covariance(self) -> Array:
        r"""Return the sandwich covariance of the coefficients and the free numbers of the shape.

        .. math:: H^{-1} \left(\Phi^T Q \Sigma Q \Phi + \sigma^4 P\right) H^{-1}, \qquad
                  H = \Phi^T Q \Phi + \sigma^2 P

        The derivatives by the shape are among the columns. P is the prior precision, Q the
        weights of the samples, and :math:`\Sigma` the noise's autocovariance within a realization,
        from the residual.
        """
        left, inverse = self.residual, self.inverse
        data = attrs.evolve(self.data, true_noise=autocorrelation(left, 0.0))
        coloured = data.moments(self.every_column).gram
        variance = float(np.sum(left**2)) / self.freedom
        prior = self.posterior.noise_variance * (inverse * self.precision) @ inverse
        return np.asarray(variance * inverse @ coloured @ inverse + prior)

    @property
    def precision(self) -> Array:
        """Return the prior precision of coefficients and shape, times the noise variance."""
        own = np.concatenate([self.posterior.precision, SPREAD[: self.free] ** -2])
        return np.asarray(self.posterior.noise_variance * own)

    def improved(self) -> Fit:
        """Return the fit after some Gauss-Newton steps, each halved until it is better.

        The coefficients change with the free numbers of the shape.
        """
        fit, free = self, self.free
        for _ in range(MAX_STEPS if free else 0):
            numbers, own = fit.shape[:free], slice(-free, None)
            weighted, slopes = fit.data.weighted(fit.residual), fit.every_column[own]
            gradient = np.tensordot(slopes, weighted, 2)
            gradient += fit.precision[own] * (MEAN[:free] - numbers)
            step = fit.inverse[own, own] @ gradient
            if np.max(np.abs(step) / SPREAD[:free]) < SMALLEST_STEP:
                break
            tried = (fit.with_shape(numbers + step / 2**n) for n in range(MAX_HALVINGS))
            better = next((each for each in tried if each.objective > fit.objective), None)
            if better is None:
                break
            fit = better
        return fit

    def refined(self) -> Fit:
        """Return the fit with an improved shape, then improved hyperparameters."""
        fit = self.improved()
        return attrs.evolve(fit, parameters=fit.tuned(fit.parameters))


def posterior_of(moments: Moments, spread: Array, positive: Array | None = None) -> Posterior:
    """Return the posterior of coefficients whose prior ``spread`` is relative to the noise.

    The noise variance is the most probable one. The mean has the greatest posterior density of all
    coefficients whose products with each row of ``positive`` (row, coefficient) are not negative.
    """
    found = solve(moments, spread**-2)
    mean, left = found.mean, found.penalized_residual
    if positive is not None:
        # In these coordinates, the density falls with the distance from the free mean.
        free, normals = found.inverse_factor @ moments.cross, found.inverse_factor @ positive.T
        normals /= np.linalg.norm(normals, axis=0)
        size = np.linalg.norm(free)
        step = size * (normals @ scipy.optimize.nnls(normals, -free / size)[0])
        mean, left = mean + step @ found.inverse_factor, left + float(step @ step)
    left = max(left, 1e-14 * moments.square + np.finfo(float).tiny)
    noise = left / moments.number
    return attrs.evolve(
        found,
        mean=mean,
        penalized_residual=left,
        noise_variance=noise,
        precision=found.precision / noise,
    )


def relative_log_evidence(found: Posterior, square: float) -> float:
    r"""Return the log evidence relative to that of a torque that is all noise, without units.

    S is the diagonal matrix of the prior standard deviations relative to the noise.

    .. math:: \log p = -\tfrac n2 \log \frac{y^T (1 + \Phi S^2 \Phi^T)^{-1} y}{y^T y}
              - \tfrac12 \log|S \Phi^T\Phi S + 1|
    """
    misfit = found.number * math.log(found.penalized_residual / square)
    return -0.5 * (misfit + found.log_determinant)


def decays_off(parameters: Array) -> Array:
    """Return the distance of each decay from its mean, in standard deviations."""
    return np.where(IS_DECAY, (parameters - DECAY_MEAN) / DECAY_SPREAD, 0.0)
