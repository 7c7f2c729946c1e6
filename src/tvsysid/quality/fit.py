"""The joint's second-order model with free stiffness and viscosity in short bins of time, and what it leaves."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate
from tvsysid.signals import Array

ROWS = 100
"""Samples of all realizations together that a bin should have at least."""
SHORTEST_BIN = 0.05
"""In s."""
MOST_BINS_LONG = 10
"""A bin is no longer than a realization divided by this."""


@dataclass(frozen=True, eq=False)
class SecondOrder:
    r"""Fit of :math:`y = k(t)\theta + b(t)\dot\theta + I\ddot\theta` by least squares.

    Parameters
    ----------
    motion
        Angle, velocity and acceleration, shape (3, realization, time).
    torque
        Shape (realization, time).
    first
        Sample of the ensemble (context counted) that the first one here is.
    bins
        Bin of each sample, shape (time,).
    stiffness, viscosity
        In N·m/rad and N·m·s/rad, shape (bin,).
    inertia
        In kg·m².
    """

    motion: Array
    torque: Array
    first: int
    bins: NDArray[np.int64]
    stiffness: Array
    viscosity: Array
    inertia: float

    @property
    def parts(self) -> Array:
        """Torque of stiffness, viscosity and inertia in N·m, shape (3, realization, time)."""
        out = self.motion.copy()
        out[0] *= self.stiffness[self.bins]
        out[1] *= self.viscosity[self.bins]
        out[2] *= self.inertia
        return out


def known_region(samples: int, context: int) -> slice:
    """Samples of an ensemble, context counted, whose derivatives are known: all but those at the edges of a record."""
    margin = max(context, HALF_WIDTH)
    return slice(margin, max(margin, samples + min(context, 2 * context - HALF_WIDTH)))


def known_samples(samples: int, context: int) -> int:
    """How many samples of a realization these are."""
    region = known_region(samples, context)
    return int(region.stop - region.start)


def time_bins(samples: int, realizations: int, sampling_rate: float) -> NDArray[np.int64]:
    """Bin of each sample, shape (time,): bins are as short as the number of realizations allows."""
    shortest = max(1, round(SHORTEST_BIN * sampling_rate))
    length = max(shortest, min(math.ceil(ROWS / realizations), max(samples // MOST_BINS_LONG, 1)))
    count = max(1, samples // length)
    return np.minimum(np.arange(samples) // length, count - 1)


def fit_second_order(angle: Array, torque: Array, sampling_rate: float, context: int) -> SecondOrder:
    """Fit the model to deviations from the mean, shape (realization, context + time + context).

    Over the samples whose derivatives are known. Stiffness and viscosity are free in each bin of time and the inertia
    is common to all, which is a partitioned least-squares problem: what stiffness and viscosity explain of torque and
    acceleration is taken from both first.
    """
    region = known_region(angle.shape[1] - 2 * context, context)
    motion = differentiate(angle, sampling_rate)[:, :, region.start - HALF_WIDTH : region.stop - HALF_WIDTH]
    return fit_motion(motion, torque[:, region], sampling_rate, region.start)


def fit_motion(motion: Array, torque: Array, sampling_rate: float, first: int) -> SecondOrder:
    """Fit to angle, velocity and acceleration, shape (3, realization, time), and torque; see above."""
    bins = time_bins(torque.shape[1], len(torque), sampling_rate)
    edges = np.flatnonzero(np.diff(bins, prepend=-1))
    signals = [*motion, torque]

    def moment(a: int, b: int) -> Array:
        return np.add.reduceat(np.einsum("rt,rt->t", signals[a], signals[b]), edges)

    gram = np.array([[moment(a, b) for b in range(2)] for a in range(2)]).transpose(2, 0, 1)
    ridge = 1e-12 * np.trace(gram, axis1=1, axis2=2).mean() + np.finfo(float).tiny
    gram = gram + ridge * np.eye(2)
    with_acceleration = np.stack([moment(0, 2), moment(1, 2)], axis=1)
    with_torque = np.stack([moment(0, 3), moment(1, 3)], axis=1)
    by_motion = np.linalg.solve(gram, with_acceleration[..., None])[..., 0]
    by_torque = np.linalg.solve(gram, with_torque[..., None])[..., 0]
    left = float(np.sum(moment(2, 2)) - np.sum(with_acceleration * by_motion))
    inertia = float(np.sum(moment(2, 3)) - np.sum(with_acceleration * by_torque)) / left if left > 0 else 0.0
    stiffness, viscosity = (by_torque - inertia * by_motion).T
    return SecondOrder(motion, torque, first, bins, stiffness, viscosity, inertia)
