"""Solve the motion of a second-order system whose stiffness and damping change over time."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dtbtrs

from tvsysid.numerics import Array


def driven_motion(
    stiffness: Array,
    damping: Array,
    forces: Array,
    rate: float,
    held: tuple[Array, Array] | None = None,
) -> Array:
    r"""Return position, velocity and acceleration (3, force, time) of a system that starts at rest.

    .. math:: \ddot x + d(t)\,\dot x + w(t)\,x = f(t)

    The stiffness w in 1/s² and damping d in 1/s, of shape (time,), are ``held`` over each step, at
    the mean of its ends if not given. The ``forces`` f in rad/s² (force, time) are linear between
    samples. For these the motion is exact.
    """
    held = held or ((stiffness[1:] + stiffness[:-1]) / 2, (damping[1:] + damping[:-1]) / 2)
    transition, early, late = _steps(*held, rate)
    forced, samples = forces.shape
    pushes = np.zeros((samples, 2, forced))
    pushes[1:] = np.moveaxis(early[:, None] * forces[:, :-1] + late[:, None] * forces[:, 1:], -1, 0)
    # Each state less the transition of the one before is what the forces add: a banded system.
    bands = np.zeros((4, samples, 2))
    bands[2, :-1, 0], bands[3, :-1, 0] = -transition[:, 0]
    bands[1, :-1, 1], bands[2, :-1, 1] = -transition[:, 1]
    states, _ = dtbtrs(bands.reshape(4, -1), pushes.reshape(2 * samples, -1), uplo="L", diag="U")
    position, velocity = np.moveaxis(states.reshape(samples, 2, forced), 0, -1)
    return np.stack([position, velocity, forces - damping * velocity - stiffness * position])


def _steps(stiffness: Array, damping: Array, rate: float) -> tuple[Array, Array, Array]:
    """Return the exact step of position and velocity.

    The transition (2, 2, step), and the response to a force at the begin and at the end (2, step).
    """
    half, step = damping / 2, 1 / rate
    turned = np.sqrt(stiffness - half**2 + 0j) * step
    cosine, sine = np.cos(turned).real, step * np.sinc(turned / np.pi).real
    transition = np.exp(-half * step) * np.array(
        [[cosine + half * sine, sine], [-stiffness * sine, cosine - half * sine]]
    )
    (_, position), (_, velocity) = transition

    def settle(first: Array, second: Array) -> Array:
        """Return the inverse of the system's matrix [[0, 1], [-w, -d]] times a state."""
        return np.stack([-(damping * first + second) / stiffness, first])

    constant = settle(position, velocity - 1)
    late = settle(constant[0] * rate, constant[1] * rate - 1)
    return transition, constant - late, late
