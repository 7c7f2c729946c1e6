"""Stretch reflex: torque of a muscle that responds to the velocity of stretch."""

from __future__ import annotations

import attrs
import numpy as np
import scipy

from tvsysid.numerics import Array
from tvsysid.validators import Validator, not_negative, positive


@attrs.frozen
class StretchReflex:
    r"""Torque of a muscle that responds to the velocity of stretch after a delay.

    .. math:: \ddot r(t) + 2 \zeta \omega\, \dot r(t) + \omega^2\, r(t)
              = \omega^2\, g(t)\, f(t - d), \qquad f = s \max(s\, \dot\theta - c, 0)

    Parameters
    ----------
    delay
        Delay d in s, rounded to a sample.
    frequency
        Natural frequency ω of the muscle in rad/s.
    damping
        Damping ratio ζ of the muscle.
    threshold
        Velocity c in rad/s below which there is no response.
    direction
        Sign s: 1 if a positive velocity stretches the muscle, -1 if a negative one does.
    """

    delay: float = attrs.field(default=0.040, validator=not_negative)
    frequency: float = attrs.field(default=15.6, validator=positive)
    damping: float = attrs.field(default=0.62, validator=positive)
    threshold: float = attrs.field(default=0.0, validator=not_negative)
    direction: int = attrs.field(default=1, validator=Validator("1 or -1", (-1, 1).__contains__))

    def stretch(self, velocity: Array, rate: float, early: float = 0.0) -> Array:
        """Return the stretch f(t - d) in rad/s, ``early`` s before it arrives at the muscle."""
        late = round(max(self.delay - early, 0.0) * rate)
        beyond = np.zeros_like(velocity)
        beyond[late:] = self.direction * velocity[: len(velocity) - late] - self.threshold
        return self.direction * np.maximum(beyond, 0.0)

    def torque(self, velocity: Array, gain: float | Array, rate: float) -> Array:
        """Return the torque r in N·m for a velocity in rad/s and a gain g in N·m·s/rad.

        All have the shape (time,).
        """
        square = self.frequency**2
        muscle = scipy.signal.bilinear(
            [square], [1.0, 2 * self.damping * self.frequency, square], fs=rate
        )
        return scipy.signal.lfilter(*muscle, gain * self.stretch(velocity, rate))
