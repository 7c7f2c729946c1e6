"""Stretch reflex: torque of a muscle that responds to the velocity of stretch."""

from __future__ import annotations

import attrs
import numpy as np
import scipy

from tvsysid.errors import InputError
from tvsysid.numerics import Array
from tvsysid.simulate.motion import driven_motion
from tvsysid.simulate.profiles import Profile, over_time
from tvsysid.validators import Validator, is_number, not_negative, positive


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
        Natural frequency ω of the muscle in rad/s, or a callable of time.
    damping
        Damping ratio ζ of the muscle.
    threshold
        Velocity c in rad/s below which there is no response.
    direction
        Sign s: 1 if a positive velocity stretches the muscle, -1 if a negative one does.
    gain_after
        Whether the gain g acts after the muscle, not before it.
    """

    delay: float = attrs.field(default=0.040, validator=not_negative)
    frequency: float | Profile = attrs.field(
        default=15.6,
        validator=Validator(
            "a positive number or a callable of time",
            lambda value: callable(value) or (is_number(value) and value > 0),
        ),
    )
    damping: float = attrs.field(default=0.62, validator=positive)
    threshold: float = attrs.field(default=0.0, validator=not_negative)
    direction: int = attrs.field(default=1, validator=Validator("1 or -1", (-1, 1).__contains__))
    gain_after: bool = False

    def stretch(self, velocity: Array, rate: float, early: float = 0.0) -> Array:
        """Return the stretch f(t - d) in rad/s, ``early`` s before it arrives at the muscle."""
        late = round(max(self.delay - early, 0.0) * rate)
        beyond = np.zeros_like(velocity)
        beyond[late:] = self.direction * velocity[: len(velocity) - late] - self.threshold
        return self.direction * np.maximum(beyond, 0.0)

    def torque(self, velocity: Array, gain: float | Array, rate: float, start: int = 0) -> Array:
        """Return the torque r in N·m for a velocity in rad/s and a gain g in N·m·s/rad.

        All have the shape (time,). The first sample is at time start / rate.
        """
        stretch = self.stretch(velocity, rate)
        if self.gain_after:
            return gain * self._muscle(stretch, rate, start)
        return self._muscle(gain * stretch, rate, start)

    def _muscle(self, drive: Array, rate: float, start: int) -> Array:
        """Return the force of the muscle, whose static gain is 1."""
        if not callable(self.frequency):
            stiffness = self.frequency**2
            muscle = scipy.signal.bilinear(
                [stiffness], [1.0, 2 * self.damping * self.frequency, stiffness], fs=rate
            )
            return np.asarray(scipy.signal.lfilter(*muscle, drive))
        time = np.arange(start, start + len(drive)) / rate
        frequency = over_time("StretchReflex: frequency", self.frequency, time, rate)
        if frequency.min() <= 0:
            raise InputError(
                f"StretchReflex: frequency must be positive at all times, got {frequency.min():g} "
                "rad/s"
            )
        square = np.square(frequency)
        motion = driven_motion(square, 2 * self.damping * frequency, (square * drive)[None], rate)
        return np.asarray(motion[0, 0])


is_reflex = Validator("a StretchReflex", lambda value: isinstance(value, StretchReflex))
