"""An actuator that imposes an angle on a joint, and the torque with which the joint answers."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import NamedTuple

import numpy as np
import scipy
from scipy.linalg import expm

from tvsysid.numerics import Array
from tvsysid.simulate.perturbations import generated
from tvsysid.simulate.setup import BANDWIDTH, Setup

BLOCK = 16384


class Answer(NamedTuple):
    """Angle of the usual size, its velocity (run-in included), the torque that answers it, and noise; each (time,)."""

    angle: Array
    velocity: Array
    torque: Array
    noise: Array


def answer(
    setup: Setup,
    impedance: Mapping[str, Array],
    streams: list[np.random.Generator],
    noise_bandwidth: float = BANDWIDTH,
) -> Answer:
    """Impose the perturbation's angle on a joint; the streams are those of perturbation and noise.

    The impedance is ``stiffness``, ``viscosity`` and ``inertia`` over time. The noise still has
    any size.
    """
    samples, run_in = len(setup.index), setup.run_in
    drive = generated(setup.perturbation, run_in + samples, setup.rate, streams[0])
    found = Answer(
        np.empty(samples), np.empty(run_in + samples), np.empty(samples), np.empty(samples)
    )
    actuator, noise = Actuator(setup.rate), setup.low_passed(streams[1], noise_bandwidth, run_in)
    found.velocity[:run_in] = actuator(drive[:run_in])[1]
    # Blocks that stay in the cache: each sample is touched while it is there.
    for first in range(0, samples, BLOCK):
        block = slice(first, min(first + BLOCK, samples))
        position, velocity, acceleration = actuator(
            drive[run_in + block.start : run_in + block.stop]
        )
        found.angle[block] = position
        found.velocity[run_in + block.start : run_in + block.stop] = velocity
        velocity *= impedance["viscosity"][block]
        position *= impedance["stiffness"][block]
        acceleration *= impedance["inertia"][block]
        acceleration += velocity
        np.add(acceleration, position, out=found.torque[block])
        found.noise[block] = noise(block.stop - block.start)
    scale = setup.scale_of(found.angle)
    for values in found[:3]:
        np.multiply(values, scale, out=values)
    return found


class Actuator:
    """Second-order Bessel low-pass with its states, fed block after block."""

    def __init__(self, rate: float) -> None:
        self.position, self.velocity, self.denominator, self.stiffness, self.damping = (
            _actuator_filter(rate)
        )
        self.states = [np.zeros(2), np.zeros(2)]

    def __call__(self, drive: Array) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration, the drive being linear between samples."""
        position, self.states[0] = scipy.signal.lfilter(
            self.position, self.denominator, drive, zi=self.states[0]
        )
        velocity, self.states[1] = scipy.signal.lfilter(
            self.velocity, self.denominator, drive, zi=self.states[1]
        )
        acceleration = drive - position
        acceleration *= self.stiffness
        acceleration -= self.damping * velocity
        return position, velocity, acceleration


@cache
def _actuator_filter(rate: float) -> tuple[Array, Array, Array, float, float]:
    """Exact discretisation of x'' = w (drive - x) - d x' for a drive that is linear between samples.

    A drive held over each sample would lag half a sample behind the one in the acceleration's
    equation, and so add 0.6 N·m·s/rad of viscosity at 1 kHz.
    """
    _, (_, damping, stiffness) = scipy.signal.bessel(
        2, 2 * np.pi * BANDWIDTH, analog=True, norm="phase"
    )
    system, entry = np.array([[0.0, 1.0], [-stiffness, -damping]]), np.array([0.0, stiffness])
    transition = expm(system / rate)
    held = np.linalg.solve(system, (transition - np.eye(2)) @ entry)
    late = np.linalg.solve(
        system, held * rate - entry
    )  # weight of the drive at the end of the step
    early = held - late
    # (zI - A)^-1 (late z + early); the adjugate of zI - A is [[z - a11, a01], [a10, z - a00]].
    (a00, a01), (a10, a11) = transition
    denominator = np.array([1.0, -(a00 + a11), a00 * a11 - a01 * a10])
    position = np.array(
        [late[0], early[0] - a11 * late[0] + a01 * late[1], a01 * early[1] - a11 * early[0]]
    )
    velocity = np.array(
        [late[1], early[1] - a00 * late[1] + a10 * late[0], a10 * early[0] - a00 * early[1]]
    )
    return position, velocity, denominator, float(stiffness), float(damping)
