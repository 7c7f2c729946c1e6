"""Compute how fast a muscle is stretched: velocity, rectified at the rate of the recording."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import correlate1d

from tvsysid.numerics import Array
from tvsysid.numerics.decimation import keep_every
from tvsysid.numerics.differentiation import derivative_weights

FAST = 500.0  # Hz from which on five samples are enough for a derivative
PARABOLA = np.array([-2.0, -1.0, 0.0, 1.0, 2.0]) / 10  # slope of the parabola through five samples
HALF_WIDTH = 8  # samples to either side of the derivative at lower rates


def recorded_velocity(recorded_angle: Array, sampling_rate: float) -> Array:
    """Return the velocity in rad/s at the recorded rate, shape (realization, time * sample).

    The angle has shape (realization, time, sample). ``sampling_rate`` is that of the axis of time.
    From 500 Hz on the velocity is the slope of a parabola through five samples, which leaves an
    encoder's noise out; below, it is the band-limited derivative of
    :mod:`tvsysid.numerics.differentiation`. Before its first and after its last sample the angle is
    taken as constant.
    """
    rate = recorded_angle.shape[-1] * sampling_rate
    angle = recorded_angle.reshape(len(recorded_angle), -1)
    weights = PARABOLA if rate >= FAST else derivative_weights(HALF_WIDTH)[1][::-1]
    return correlate1d(angle, weights * rate, axis=-1, mode="nearest")


def stretch(velocity: Array, ratio: int, threshold: float, direction: int) -> Array:
    r"""Return the velocity beyond a threshold in the direction of stretch, (realization, time).

    It is returned at the lower rate:

    .. math:: f = s \max(s v - c, 0)

    rectified first, at the recorded rate, then decimated as the torque was. The other way round,
    what is rectified is the ringing of the decimation filter.

    Parameters
    ----------
    velocity
        At the recorded rate, in rad/s, shape (realization, time * ratio); see
        :func:`recorded_velocity`.
    ratio
        Of the recorded to the lower rate.
    threshold, direction
        c in rad/s, and s, 1 or -1. 0 is no stretch.
    """
    beyond = direction * velocity
    beyond -= threshold
    np.maximum(beyond, 0.0, out=beyond)  # in place: recorded velocities are long
    return direction * keep_every(beyond, ratio)
