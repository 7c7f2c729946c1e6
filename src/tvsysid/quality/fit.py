"""Fit a second-order joint whose stiffness and viscosity vary over time in bins."""

from __future__ import annotations

import math
from functools import cached_property

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid.numerics.second_order import second_order_fit
from tvsysid.signals import Array

MIN_BIN_SAMPLES = 100  # samples of all realizations together
MIN_BIN_S = 0.05
MIN_LONG_BINS = 10  # minimum number of bins in a realization, if they are longer than MIN_BIN_S


@attrs.frozen(eq=False)
class SecondOrderFit:
    r"""Least-squares fit of :math:`y = k(t)\theta + b(t)\dot\theta + I\ddot\theta`.

    ``torque`` is y in N·m, shape (realization, time). ``weights`` are k, b and I in each bin of
    time, shape (bin, 3). ``unexplained`` is the share of the torque's power that the fit does not
    explain, 1 for a torque of zero.
    """

    regressors: Regressors
    torque: Array
    weights: Array
    unexplained: float

    @property
    def motion(self) -> Array:
        """Angle, velocity and acceleration, shape (3, realization, time)."""
        return self.regressors.motion

    @property
    def impedance(self) -> Array:
        """Stiffness, viscosity and inertia at each sample, shape (3, time)."""
        return self.weights[self.regressors.bins].T

    @cached_property
    def parts(self) -> Array:
        """Torque of stiffness, viscosity and inertia in N·m, shape (3, realization, time)."""
        return self.motion * self.impedance[:, None]

    @cached_property
    def residual(self) -> Array:
        """Torque that the fit does not explain in N·m, shape (realization, time)."""
        return np.asarray(self.torque - self.parts.sum(axis=0))

    def of(self, realizations: NDArray[np.int64] | slice) -> SecondOrderFit:
        """Return the fit to some of the realizations."""
        motion = self.motion[:, realizations]
        return Regressors(motion, self.regressors.rate).fit(self.torque[realizations])


class Regressors:
    """Angle, velocity and acceleration (3, realization, time), as regressors of any torque.

    The least-squares problem is partitioned. Each bin has its own stiffness and viscosity, and only
    the inertia is common to all bins. Therefore acceleration and torque are first regressed on the
    angle and velocity of each bin. The inertia is then fitted to the residuals of both.
    """

    def __init__(self, motion: Array, rate: float) -> None:
        self.motion, self.rate = motion, rate
        self.bins = time_bins(motion.shape[2], motion.shape[1], rate)
        self._edges = np.flatnonzero(np.diff(self.bins, prepend=-1))
        self._gram = np.stack([self._moments(each) for each in motion], axis=2)
        inner = self._gram[:, :2, :2]
        ridge = 1e-12 * np.trace(inner, axis1=1, axis2=2).mean() + np.finfo(float).tiny
        self._ridged = inner + ridge * np.eye(2)
        self._acceleration_weights = self._solve(self._gram[:, :, 2])
        self._residual_power = self._residual_product(
            self._gram[:, :, 2], self._acceleration_weights
        )

    def _moments(self, signal: Array) -> Array:
        """Return sums of motion times a signal in each bin, shape (bin, 3)."""
        products = np.einsum("mrt,rt->mt", self.motion, signal)
        return np.add.reduceat(products, self._edges, axis=1).T

    def _solve(self, moments: Array) -> Array:
        """Return weights of angle and velocity in each bin, shape (bin, 2)."""
        return np.asarray(np.linalg.solve(self._ridged, moments[:, :2, None])[..., 0])

    def _residual_product(self, moments: Array, weights: Array) -> float:
        """Return the product of acceleration with the residual of a signal for these weights."""
        return float(np.sum(moments[:, 2]) - np.sum(self._gram[:, :2, 2] * weights))

    def fit(self, torque: Array) -> SecondOrderFit:
        """Fit to a torque, shape (realization, time)."""
        moments, total = self._moments(torque), np.einsum("rt,rt->", torque, torque)
        torque_weights = self._solve(moments)
        product = self._residual_product(moments, torque_weights)
        inertia = product / self._residual_power if self._residual_power > 0 else 0.0
        weights = torque_weights - inertia * self._acceleration_weights
        weights = np.insert(weights, 2, inertia, axis=1)
        fitted = (self._gram @ weights[..., None])[..., 0]
        explained = np.sum(weights * (2 * moments - fitted))
        return SecondOrderFit(self, torque, weights, 1 - explained / total if total > 0 else 1.0)


def time_bins(samples: int, realizations: int, rate: float) -> NDArray[np.int64]:
    """Return the bin of each sample, shape (time,). Few realizations need longer bins."""
    shortest = max(1, round(MIN_BIN_S * rate))
    enough = math.ceil(MIN_BIN_SAMPLES / realizations)
    length = max(shortest, min(enough, max(samples // MIN_LONG_BINS, 1)))
    return np.minimum(np.arange(samples) // length, max(1, samples // length) - 1)


def constant_impedance(motion: Array, torque: Array) -> tuple[Array, Array]:
    """Fit constant stiffness, viscosity and inertia. Return values and standard errors, (3,) each.

    The errors come from the scatter over realizations, so the noise may have any colour. Both are
    NaN if the three are not separately identifiable.
    """
    count = len(torque)
    grams = np.einsum("art,brt->rab", motion, motion)
    cross = np.einsum("art,rt->ra", motion, torque)
    fit = second_order_fit(grams.sum(axis=0)[None], cross.sum(axis=0)[None])
    values = fit.impedance[0]
    influence = (cross - grams @ values) @ fit.inverse[0]
    return values, np.sqrt(np.sum(influence**2, axis=0) * count / max(count - 1, 1))
