"""Limits and statistics that readers, methods and the diagnosis share, beside those of the catalogue; arrays only."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tvsysid.quality.catalogue import FAULTS
from tvsysid.quality.statistics import LEAST_REALIZATIONS, SIGNIFICANT, p_value, p_value_of
from tvsysid.signals import Array

STILL = 1e-6
"""Share of the angle's mean power over realizations below which it does not move."""
LEAST_POWER = 0.01
"""Share of the angle's power below which a band of frequencies counts as not excited."""
MOSTLY_NEGATIVE = 0.9
"""Share of the samples at which a stiffness must be negative for the torque's sign to be in question."""
TOLD_BY_FEW = 5
"""Realizations below which a mean over them is not judged at all."""


class MeanLeft(NamedTuple):
    """What the mean over realizations is, and what chance would leave of it.

    ``size`` and ``expected`` are RMS values, ``ratio`` is the first over the second, or that of a common offset over
    its standard error if it is more; ``significant`` says whether noise does not explain a ratio beyond the limit.
    """

    size: float
    expected: float
    ratio: float
    significant: bool

    @property
    def found(self) -> bool:
        """Whether a mean is left."""
        return self.significant and self.ratio > FAULTS["mean-torque"].limit


def mean_left(values: Array) -> MeanLeft:
    """Judge the mean over realizations by what chance leaves of it.

    Noise is alike at neighbouring times, so that its mean is not averaged out over time: hence a limit above 1, and a
    test over realizations where there are enough of them.

    Parameters
    ----------
    values
        Shape (realization, time).
    """
    count = len(values)
    mean, offsets = values.mean(axis=0), values.mean(axis=1)
    size = float(np.sqrt(np.mean(mean**2)))
    variance = float(np.mean(np.einsum("rt,rt->t", values, values) - count * mean**2)) / max(count - 1, 1)
    expected = math.sqrt(max(0.0, variance) / count)
    if count < TOLD_BY_FEW:
        return MeanLeft(size, expected, math.nan, False)
    ratio = size / expected if expected > 0 else math.inf
    offset, error = abs(float(offsets.mean())), float(offsets.std(ddof=1)) / math.sqrt(count)
    if offset > 0 and p_value(offset, error, count) < SIGNIFICANT / 10:
        # A common offset shows in the means of realizations long before it does at single times.
        return MeanLeft(size, expected, max(ratio, offset / error if error > 0 else math.inf), True)
    beyond = ratio > FAULTS["mean-torque"].limit
    tested = count < LEAST_REALIZATIONS or (beyond and p_value_of(_by_others(values)) < SIGNIFICANT)
    return MeanLeft(size, expected, ratio, beyond and tested)


def _by_others(values: Array) -> Array:
    """Products of each realization with the mean of the others, less its neighbours: above zero if they share one."""
    count = len(values)
    products = values @ values.T
    near = np.abs(np.subtract.outer(np.arange(count), np.arange(count))) <= 1
    return np.asarray(np.where(near, 0.0, products).sum(axis=1))


def still_samples(angle: Array) -> NDArray[np.intp]:
    """Samples at which the angle, shape (realization, time), does not move in any realization."""
    power = np.einsum("rt,rt->t", angle, angle)
    return np.flatnonzero(power < STILL * power.mean())
