"""Fit both pathways in one regression. Gauss-Newton steps find the shape of the reflex."""

from __future__ import annotations

import math
from functools import cached_property

import attrs
import numpy as np
import scipy
from scipy.linalg import block_diag

from tvsysid.methods.cascade.columns import HIGHEST, LOWEST, MEAN, SPREAD, STEP, Data
from tvsysid.methods.pathways import Stretch
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
MAX_STEPS, MAX_HALVINGS = 8, 6  # of Gauss-Newton, and of each of its steps
SMALLEST_STEP = 0.02  # in standard deviations of the prior
MAX_LIMITED_TIMES = 500  # about the largest number of times at which signs are limited


@attrs.frozen(eq=False)
class Fit:
    """Posterior of the coefficients of both pathways, for a shape and hyperparameters.

    Parameters
    ----------
    data
        Torque and intrinsic signals.
    drive
        Drive of the reflex, of direction 0 without one.
    shape
        Shape of the reflex, with its threshold.
    free
        How many numbers of the shape are estimated: the first ones.
    parameters
        Hyperparameters. If they are not given, ``tuned`` searches for them when the fit is made.
    positive
        Rows (row, column) whose products with the coefficients must not be negative.
    """

    data: Data
    drive: Stretch
    shape: Array
    free: int
    parameters: Array = attrs.field()
    positive: Array | None = None

    @parameters.default
    def tuned(self, start: Array = USUAL_PARAMETERS) -> Array:
        """Return the hyperparameters of greatest evidence near a start."""
        offset, design = self.prior

        def cost(parameters: Array) -> tuple[float, Array]:
            found = posterior_of(self.moments, np.exp(offset + design @ parameters))
            off = decays_off(parameters)
            gradient = 2 * found.variance_gradient @ design - off / DECAY_SPREAD
            # Relative to the torque's square, so that rounding is the same in all units
            misfit = found.number * math.log(found.penalized_residual / self.moments.square)
            return 0.5 * float(off @ off + misfit + found.log_determinant), -gradient

        options = {"maxiter": MAX_ITERATIONS, "ftol": 1e-14, "gtol": 1e-7}
        found = scipy.optimize.minimize(
            cost, start, jac=True, method="L-BFGS-B", bounds=BOUNDS, options=options
        )
        return found.x

    @cached_property
    def reflex_columns(self) -> Array:
        """Return the columns of the reflex (column, realization, time)."""
        return self.data.reflex(self.drive, self.shape, np.eye(2 * self.data.gain.harmonics + 1))

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
        family = [*np.arange(len(sizes) - 1).clip(max=FLAT_FAMILIES), FAMILIES - 1]
        is_own = np.eye(FAMILIES)[np.repeat(family, sizes)]
        weights = order == 0, order > 0, -np.log(order.clip(1))
        design = np.concatenate([is_own * each[:, None] for each in weights], axis=1)
        power = np.repeat(np.diag(self.moments.gram)[order == 0] / self.moments.number, sizes)
        return -0.5 * np.log(np.where(power > 0, power, 1.0)), design

    @cached_property
    def spread(self) -> Array:
        """Return the prior standard deviations with the hyperparameters of the fit."""
        offset, design = self.prior
        return np.exp(offset + design @ self.parameters)

    def solved(self, moments: Moments) -> Posterior:
        """Return the posterior of the coefficients from moments of all or some realizations."""
        return posterior_of(moments, self.spread, self.positive)

    @cached_property
    def posterior(self) -> Posterior:
        """Return the posterior of the coefficients."""
        return self.solved(self.moments)

    @cached_property
    def objective(self) -> float:
        """Return the log evidence plus the log prior densities of shape and hyperparameters."""
        off = *((self.shape - MEAN) / SPREAD), *decays_off(self.parameters)
        return self.posterior.log_evidence - 0.5 * float(np.sum(np.square(off)))

    @property
    def residual(self) -> Array:
        """Return the residual torque (realization, time)."""
        return self.data.residual(self.posterior.mean, self.reflex_columns)

    @cached_property
    def held_out(self) -> Array:
        """Return the residual torque (realization, time) of each fold, fitted to the other folds.

        NaN if there is a single fold.
        """
        return self.data.held_out(self.products, self.reflex_columns, self.solved)

    def left_share(self) -> float:
        """Return the share of the held-out torque's square that the fit leaves."""
        return float(np.sum(self.held_out**2) / np.sum(self.data.torque**2))

    def moved(self, step: Array) -> Array:
        """Return the shape after a step (number,), kept within its bounds."""
        return np.clip(self.shape + step, LOWEST, HIGHEST)

    @cached_property
    def late_columns(self) -> Array:
        """Return the columns of the reflex, and its torque's derivatives by the free numbers."""
        coefficients, slopes = self.posterior.mean[self.data.intrinsic_count :, None], []
        for step in np.diag(STEP)[: self.free]:
            ends = self.moved(step), self.moved(-step)
            high, low = (self.data.reflex(self.drive, each, coefficients) for each in ends)
            # One number differs, by less than two steps at its bounds.
            slopes.append((high - low) / np.sum(ends[0] - ends[1]))
        return np.concatenate([self.reflex_columns, *slopes])

    @cached_property
    def inverse(self) -> Array:
        """Return the posterior covariance of coefficients and shape, divided by the noise's."""
        return solve(self.data.moments(self.late_columns), self.precision).covariance

    @property
    def quantities(self) -> Array:
        """Return rows (quantity, time, coefficient) of stiffness, viscosity, inertia and gain.

        Their products with the coefficients are the quantities over time.
        """
        data, time = self.data, self.data.ensemble.time
        weights = np.eye(1, len(data.signals)), data.readout[1:]
        impedance = [data.features(each) for each in np.concatenate(weights)]
        gain = data.gain(time / data.ensemble.duration)
        rows = block_diag(np.concatenate(impedance), gain)
        return rows.reshape(-1, len(time), rows.shape[1])

    def limited(self) -> Fit:
        """Return the fit with the same hyperparameters, without negative viscosity and gain.

        Stiffness keeps one sign. The gain of EMG is of either sign.
        """
        step = max(1, len(self.data.ensemble.time) // MAX_LIMITED_TIMES)
        rows = self.quantities[:, ::step] * self.signs[:, None, None]
        return attrs.evolve(self, positive=np.concatenate(rows[self.signs != 0]))

    @property
    def signs(self) -> Array:
        """Return the sign that each quantity keeps, 0 for either."""
        return np.array([np.sign(self.posterior.mean[0]), 1, 0, self.drive.emg is None])

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
        coloured = data.moments(self.late_columns).gram
        variance = float(np.sum(left**2)) / self.freedom
        prior = self.posterior.noise_variance * (inverse * self.precision) @ inverse
        return variance * inverse @ coloured @ inverse + prior

    @property
    def precision(self) -> Array:
        """Return the prior precision of coefficients and shape, times the noise variance."""
        shape = self.posterior.noise_variance / SPREAD[: self.free] ** 2
        return np.concatenate([self.spread**-2, shape])

    def improved(self) -> Fit:
        """Return the fit after some Gauss-Newton steps, each halved until it is better.

        The coefficients change with the free numbers of the shape.
        """
        fit, free = self, self.free
        for _ in range(MAX_STEPS if free else 0):
            own = slice(-free, None)
            gradient = np.tensordot(fit.late_columns[own], fit.data.weighted(fit.residual), 2)
            gradient += fit.precision[own] * (MEAN - fit.shape)[:free]
            step = np.pad(fit.inverse[own, own] @ gradient, (0, len(MEAN) - free))
            if np.max(np.abs(step) / SPREAD) < SMALLEST_STEP:
                break
            tried = (attrs.evolve(fit, shape=fit.moved(step / 2**n)) for n in range(MAX_HALVINGS))
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
        # The mean is u times the inverse factor. The density falls with u's distance from that of
        # the unlimited mean.
        unlimited, normals = found.inverse_factor @ moments.cross, found.inverse_factor @ positive.T
        normals /= np.linalg.norm(normals, axis=0)
        size = np.linalg.norm(unlimited)
        step = size * (normals @ scipy.optimize.nnls(normals, -unlimited / size)[0])
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


def decays_off(parameters: Array) -> Array:
    """Return the distance of each decay from its mean, in standard deviations."""
    return np.where(IS_DECAY, (parameters - DECAY_MEAN) / DECAY_SPREAD, 0.0)
