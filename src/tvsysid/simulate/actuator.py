"""Actuator that imposes an angle on a joint."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import scipy

from tvsysid.numerics import Array
from tvsysid.simulate.conditions import BANDWIDTH, Conditions


def actuate(drive: Array, rate: float) -> Array:
    """Return angle, velocity and acceleration (3, time) after a second-order Bessel low-pass.

    The discretisation of x'' = w (drive - x) - d x' is exact for a drive that is linear between
    samples. Were the drive held over each sample, it would lag by half a sample, and add
    0.6 N·m·s/rad of viscosity at 1 kHz.
    """
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
    numerators = (
        [late[0], early[0] - a11 * late[0] + a01 * late[1], a01 * early[1] - a11 * early[0]],
        [late[1], early[1] - a00 * late[1] + a10 * late[0], a10 * early[0] - a00 * early[1]],
    )
    angle, velocity = (
        scipy.signal.lfilter(numerator, denominator, drive) for numerator in numerators
    )
    return np.stack([angle, velocity, stiffness * (drive - angle) - damping * velocity])


class Imposed(NamedTuple):
    """Imposed angle, its velocity with the run-in, the intrinsic torque, and unscaled noise."""

    angle: Array
    velocity: Array
    torque: Array
    noise: Array


def impose(
    conditions: Conditions,
    impedance: Mapping[str, Array],
    noise_bandwidth: float,
) -> Imposed:
    """Impose the perturbation on a joint of this stiffness, viscosity and inertia over time."""
    motion = actuate(conditions.drive(), conditions.rate)
    angle, velocity, acceleration = motion[:, conditions.recorded]
    torque = impedance["inertia"] * acceleration + impedance["viscosity"] * velocity
    torque += impedance["stiffness"] * angle
    scale = conditions.angle_scale(angle)
    noise = conditions.noise(noise_bandwidth)[conditions.recorded]
    return Imposed(scale * angle, scale * motion[1], scale * torque, noise)
