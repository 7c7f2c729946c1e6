"""Impose an angle on a joint by a stiff actuator."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import scipy

from tvsysid.numerics import Array
from tvsysid.simulate.conditions import BANDWIDTH, Conditions
from tvsysid.simulate.reflex import StretchReflex
from tvsysid.simulate.simulation import Simulation


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


def impose(
    conditions: Conditions,
    truth: Mapping[str, Array],
    noise_bandwidth: float,
    reflex: StretchReflex | None = None,
    gain: Array | float = 0.0,
    channels: Callable[[Array], dict[str, Array]] = lambda velocity: {},
) -> Simulation:
    """Impose the perturbation on a joint whose impedance over time is the truth.

    The gain of a reflex is given over the whole time, and the channels are a function of the
    angle's velocity over the whole time.
    """
    motion, recorded = actuate(conditions.drive(), conditions.rate), conditions.recorded
    angle, velocity, acceleration = motion[:, recorded]
    torque = truth["inertia"] * acceleration + truth["viscosity"] * velocity
    torque += truth["stiffness"] * angle
    scale = conditions.angle_scale(angle)
    pathways, whole = {"intrinsic": scale * torque}, scale * motion[1]
    if reflex is not None:
        begin = -2 * conditions.second
        pathways["reflex"] = reflex.torque(whole, gain, conditions.rate, begin)[recorded]
    noise = conditions.noise(noise_bandwidth)[recorded]
    return conditions.simulation(scale * angle, noise, pathways, truth, channels(whole))
