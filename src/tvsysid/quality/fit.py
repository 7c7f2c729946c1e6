"""Fit a second-order joint whose stiffness and viscosity vary over time in bins."""

from __future__ import annotations

import math
from functools import cached_property

import attrs
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from tvsysid.numerics.second_order import second_order_fit
from tvsysid.quality.statistics import filtered, whitener
from tvsysid.signals import Array

MIN_BIN_SAMPLES = 100  # samples of all realizations together
MIN_BIN_S = 0.05
MIN_LONG_BINS = 10  # minimum number of bins in a realization, if they are longer than MIN_BIN_S
NOISE_PAST_S = 0.1  # from which noise is predicted
# Standard deviation in samples of a low-pass. Near half the sampling rate, noise in the angle, the
# decimator's aliases and the errors of derivatives look like a delay or a smaller inertia.
LOW_PASS_SAMPLES = 1.0


@attrs.frozen(eq=False)
class SecondOrderFit:
    r"""Least-squares fit of :math:`y = k(t)\theta + b(t)\dot\theta + I\ddot\theta`.

    Each bin of time has its own k and b. I is common to all bins.

    Parameters
    ----------
    motion
        Angle, velocity and acceleration, shape (3, realization, time).
    torque
        y in N·m, shape (realization, time).
    rate
        Sampling rate in Hz.
    """

    motion: Array
    torque: Array
    rate: float

    @cached_property
    def bins(self) -> NDArray[np.int64]:
        """Bin of each sample, shape (time,). Few realizations need longer bins."""
        realizations, samples = self.torque.shape
        shortest = max(1, round(MIN_BIN_S * self.rate))
        enough = math.ceil(MIN_BIN_SAMPLES / realizations)
        length = max(shortest, min(enough, max(samples // MIN_LONG_BINS, 1)))
        return np.asarray(np.arange(samples) // length).clip(max=max(1, samples // length) - 1)

    @cached_property
    def impedance(self) -> Array:
        """Stiffness, viscosity and inertia at each sample, shape (3, time).

        The least-squares problem is partitioned: acceleration and torque are first regressed on
        the angle and velocity of each bin, and the inertia is fitted to what is left of both.
        """
        products = np.einsum("art,brt->tab", self.motion, [*self.motion, self.torque])
        sums = np.add.reduceat(products, np.flatnonzero(np.diff(self.bins, prepend=-1)))
        inner, cross = np.split(sums[:, :2], 2, axis=2)  # sums of each bin are (3, 4)
        ridge = 1e-12 * np.trace(inner, axis1=1, axis2=2).mean() + np.finfo(float).tiny
        weights = np.linalg.solve(inner + ridge * np.eye(2), cross)
        left = np.sum(sums[:, 2, 2:], axis=0) - np.einsum("ba,bac->c", cross[..., 0], weights)
        inertia = left[1] / left[0] if left[0] > 0 else 0.0
        weights = weights[..., 1] - inertia * weights[..., 0]
        return np.insert(weights, 2, inertia, axis=1)[self.bins].T

    @cached_property
    def parts(self) -> Array:
        """Torque of stiffness, viscosity and inertia in N·m, shape (3, realization, time)."""
        return self.motion * self.impedance[:, None]

    @cached_property
    def residual(self) -> Array:
        """Torque that the fit does not explain in N·m, shape (realization, time)."""
        return np.asarray(self.torque - self.parts.sum(axis=0))

    @cached_property
    def explained(self) -> float:
        """Share of the torque's power that the fit explains, 0 for a torque of zero."""
        total = float(np.sum(self.torque**2))
        return 1 - float(np.sum(self.residual**2)) / total if total > 0 else 0.0

    @property
    def mean_impedance(self) -> tuple[Array, Array]:
        """Constant stiffness, viscosity and inertia, and their standard errors, shape (3,) each."""
        return constant_impedance(self.motion, self.torque)

    @property
    def smooth_impedance(self) -> tuple[Array, Array]:
        """The same after a low-pass, where noise in the angle hardly lowers the inertia."""
        return constant_impedance(*map(low_passed, (self.motion, self.torque)))

    @cached_property
    def whitening(self) -> int:
        """Samples of the past from which noise is predicted, w; at most a third of all."""
        return int(max(2, min(round(NOISE_PAST_S * self.rate), self.torque.shape[1] // 3)))

    @cached_property
    def _whitener(self) -> Array:
        return whitener(self.residual, self.whitening)

    def whitened(self, signal: Array) -> Array:
        """Return a signal through the filter that whitens the residual, shape (..., time - w).

        Slow noise, such as that of voluntary torque, would hide what single realizations show.
        """
        return filtered(signal, self._whitener)

    @cached_property
    def white_parts(self) -> Array:
        """Whitened torque of stiffness, viscosity and inertia, (3, realization, time - w)."""
        return self.whitened(self.parts)

    @cached_property
    def white_residual(self) -> Array:
        """Whitened residual, shape (realization, time - w)."""
        return self.whitened(self.residual)

    @cached_property
    def correction(self) -> SecondOrderFit:
        """Correction of the fit, in shares of it, by the whitened residual."""
        return SecondOrderFit(self.white_parts, self.white_residual, self.rate)

    @cached_property
    def own_moments(self) -> tuple[Array, Array]:
        """Second moments in each realization, whitened: of the parts, and with the residual.

        Their shapes are (realization, 3, 3) and (realization, 3).
        """
        parts = self.white_parts.transpose(1, 0, 2)
        return parts @ parts.transpose(0, 2, 1), (parts @ self.white_residual[..., None])[..., 0]

    @property
    def relative_stiffness(self) -> Array:
        """Stiffness of each realization over the median, shape (realization,)."""
        grams, moments = self.own_moments
        inverse = np.linalg.pinv(grams, hermitian=True)
        return _over_median(1 + np.einsum("rb,rb->r", inverse[:, 0], moments))

    @property
    def relative_noise(self) -> Array:
        """RMS of the whitened residual of each realization over the median, (realization,)."""
        return _over_median(np.sqrt(np.mean(self.white_residual**2, axis=1)))

    def of(self, realizations: NDArray[np.int64] | slice) -> SecondOrderFit:
        """Return the fit to some of the realizations, as deviations from their own mean."""
        motion, torque = self.motion[:, realizations], self.torque[realizations]
        motion = motion - motion.mean(axis=1, keepdims=True)
        return SecondOrderFit(motion, torque - torque.mean(axis=0), self.rate)


def low_passed(signal: Array, deviation: float = LOW_PASS_SAMPLES) -> Array:
    """Return a signal (..., time) through a Gaussian low-pass of so many samples."""
    return np.asarray(gaussian_filter1d(signal, deviation, axis=-1))


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


def _over_median(values: Array) -> Array:
    usual = np.median(values)
    return np.asarray(values / usual if usual > 0 else values)
