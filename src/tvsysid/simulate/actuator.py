"""Actuator that imposes an angle on a joint."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import scipy

from tvsysid.numerics import Array
from tvsysid.simulate.conditions import BANDWIDTH, Conditions
from tvsysid.simulate.motion import driven_motion
from tvsysid.simulate.perturbations import generate


def actuate(drive: Array, rate: float) -> Array:
    """Return angle, velocity and acceleration (3, time) after a second-order Bessel low-pass.

    The drive is linear between samples and starts from zero. Were it held over each sample, it
    would lag by half a sample, and add 0.6 N·m·s/rad of viscosity at 1 kHz.
    """
    _, (_, damping, stiffness) = scipy.signal.bessel(
        2, 2 * np.pi * BANDWIDTH, analog=True, norm="phase"
    )
    force = stiffness * np.pad(drive, (1, 0))[None]
    held = np.array([stiffness]), np.array([damping])
    return driven_motion(*held, force, rate, held)[:, 0, 1:]


class Imposed(NamedTuple):
    """Imposed angle, its velocity with the run-in, the intrinsic torque, and unscaled noise."""

    angle: Array
    velocity: Array
    torque: Array
    noise: Array


def impose(
    conditions: Conditions,
    impedance: Mapping[str, Array],
    generators: list[np.random.Generator],
    noise_bandwidth: float = BANDWIDTH,
) -> Imposed:
    """Impose the perturbation on a joint of this stiffness, viscosity and inertia over time."""
    samples, recorded = len(conditions.whole_time), slice(conditions.second, None)
    drive = generate(conditions.perturbation, samples, conditions.rate, generators[0])
    motion = actuate(drive, conditions.rate)
    angle, velocity, acceleration = motion[:, recorded]
    torque = impedance["inertia"] * acceleration + impedance["viscosity"] * velocity
    torque += impedance["stiffness"] * angle
    scale = conditions.angle_scale(angle)
    noise = conditions.noise(generators[1], noise_bandwidth)[recorded]
    return Imposed(scale * angle, scale * motion[1], scale * torque, noise)
