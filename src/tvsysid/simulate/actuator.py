"""Move a joint by a stiff actuator."""

from __future__ import annotations

from functools import cache

import numpy as np
import scipy

from tvsysid.numerics import Array

BANDWIDTH = 40.0  # Hz, of the actuator's Bessel filter and the noise's Butterworth filter


def actuate(drive: Array, rate: float) -> Array:
    """Return angle, velocity and acceleration (3, time) after a second-order Bessel low-pass.

    The discretisation of x'' = w (drive - x) - d x' is exact for a drive that is linear between
    samples. Were the drive held over each sample, it would lag by half a sample, and add
    0.6 N·m·s/rad of viscosity at 1 kHz.
    """
    numerators, denominator, stiffness, damping = _bessel_filter(rate)
    motion = np.empty((3, len(drive)))
    for row, numerator in enumerate(numerators):
        motion[row] = scipy.signal.lfilter(numerator, denominator, drive)
    np.subtract(drive, motion[0], out=motion[2])
    motion[2] *= stiffness
    motion[2] -= damping * motion[1]
    return motion


def drive_of(angle: Array, rate: float) -> Array:
    """Return the drive (time,) to which :func:`actuate` responds with this angle."""
    *_, stiffness, damping = _bessel_filter(rate)
    velocity = np.gradient(angle, 1 / rate)
    return angle + (damping * velocity + np.gradient(velocity, 1 / rate)) / stiffness


@cache
def _bessel_filter(rate: float) -> tuple[list[list[float]], list[float], float, float]:
    """Return the numerators of angle and velocity, their denominator, stiffness and damping."""
    _, (_, damping, stiffness) = scipy.signal.bessel(
        2, 2 * np.pi * BANDWIDTH, analog=True, norm="phase"
    )
    system, entry = np.array([[0.0, 1.0], [-stiffness, -damping]]), np.array([0.0, stiffness])
    transition = scipy.linalg.expm(system / rate)
    held = np.linalg.solve(system, (transition - np.eye(2)) @ entry)
    late = np.linalg.solve(system, held * rate - entry)  # weight of the drive at the step's end
    early = held - late
    # (zI - A)^-1 (late z + early); the adjugate of zI - A is [[z - a11, a01], [a10, z - a00]].
    (a00, a01), (a10, a11) = transition
    denominator = [1.0, -(a00 + a11), a00 * a11 - a01 * a10]
    numerators = [
        [late[0], early[0] - a11 * late[0] + a01 * late[1], a01 * early[1] - a11 * early[0]],
        [late[1], early[1] - a00 * late[1] + a10 * late[0], a10 * early[0] - a00 * early[1]],
    ]
    return numerators, denominator, stiffness, damping
