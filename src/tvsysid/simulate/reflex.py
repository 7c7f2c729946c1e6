"""The stretch reflex, and a joint that has one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import bilinear, lfilter

from tvsysid.simulate.setup import positive

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StretchReflex:
    r"""Torque of a muscle that answers stretch some time later.

    .. math:: \ddot r(t) + 2 \zeta \omega\, \dot r(t) + \omega^2\, r(t) = \omega^2\, g(t)\, \max(v(t - d), 0)

    Parameters
    ----------
    delay
        d in s, rounded to a sample.
    frequency, damping
        Natural frequency of the muscle in rad/s, and its damping ratio.
    """

    delay: float = 0.040
    frequency: float = 15.6
    damping: float = 0.62

    def __post_init__(self) -> None:
        positive("StretchReflex", delay=self.delay, frequency=self.frequency, damping=self.damping)

    def torque(self, velocity: Array, gain: float | Array, rate: float) -> Array:
        """Torque in N·m that answers a velocity in rad/s, the gain (N·m·s/rad) being that of its arrival; (time,)."""
        late, square = round(self.delay * rate), self.frequency**2
        stretch = np.zeros_like(velocity)
        stretch[late:] = np.maximum(velocity[: len(velocity) - late], 0.0)
        muscle = bilinear([square], [1.0, 2 * self.damping * self.frequency, square], fs=rate)
        return np.asarray(lfilter(*muscle, gain * stretch))
