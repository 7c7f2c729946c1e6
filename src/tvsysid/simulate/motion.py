"""Motion of a driven system of second order whose stiffness and damping change over time."""

from __future__ import annotations

import numpy as np

from tvsysid.numerics import Array

BLOCK = 512


def driven_motion(
    stiffness: Array,
    damping: Array,
    forces: Array,
    rate: float,
    held: tuple[Array, Array] | None = None,
) -> Array:
    r"""Motion of :math:`\ddot x + d(t)\,\dot x + w(t)\,x = f(t)` from rest.

    Exact for a stiffness w in 1/s² and damping d in 1/s (time,) ``held`` over each step, at the
    mean of its ends if not given, and ``forces`` f in rad/s² (force, time) that are linear
    between samples. Position, velocity and acceleration are (3, force, time).
    """
    held = held or ((stiffness[1:] + stiffness[:-1]) / 2, (damping[1:] + damping[:-1]) / 2)
    transition, early, late = _steps(*held, rate)
    forced, samples = forces.shape
    count = -(-(samples - 1) // BLOCK)

    def blocked(values: Array) -> Array:
        """Steps by their place in a block and block, (BLOCK, ..., block).

        The last block is filled with zeros.
        """
        padded = np.pad(values, [*[(0, 0)] * (values.ndim - 1), (0, count * BLOCK - samples + 1)])
        return np.moveaxis(padded.reshape(*values.shape[:-1], count, BLOCK), -1, 0).copy()

    push = blocked(early[:, None] * forces[:, :-1] + late[:, None] * forces[:, 1:])
    transition = blocked(transition)
    # All blocks are stepped through at once: first from rest and, unforced, from unit states, which
    # says with what
    # state each block really begins.
    ends = np.zeros((2, forced + 2, count))
    ends[0, forced], ends[1, forced + 1] = 1.0, 1.0
    for step, own in zip(transition, push, strict=True):
        ends = np.einsum("ijb,jcb->icb", step, ends)
        ends[:, :forced] += own
    state = np.zeros((2, forced, count))
    for block in range(1, count):
        state[..., block] = (
            ends[:, forced:, block - 1] @ state[..., block - 1] + ends[:, :forced, block - 1]
        )
    motion = np.zeros((3, forced, BLOCK * count + 1))
    for number, (step, own) in enumerate(zip(transition, push, strict=True)):
        state = np.einsum("ijb,jcb->icb", step, state) + own
        motion[:2, :, number + 1 :: BLOCK] = state
    motion = motion[..., :samples]
    motion[2] = forces - damping * motion[1] - stiffness * motion[0]
    return motion


def _steps(stiffness: Array, damping: Array, rate: float) -> tuple[Array, Array, Array]:
    """Transition of position and velocity, (2, 2, step), and what a force at a step's begin and end adds, (2, step)."""
    half, step = damping / 2, 1 / rate
    turned = np.sqrt(stiffness - half**2 + 0j) * step
    cosine, sine = np.cos(turned).real, step * np.sinc(turned / np.pi).real
    decay = np.exp(-half * step)
    transition = decay * np.array(
        [[cosine + half * sine, sine], [-stiffness * sine, cosine - half * sine]]
    )
    (_, position), (_, velocity) = transition

    def settled(first: Array, second: Array) -> Array:
        """Inverse of the system's matrix [[0, 1], [-w, -d]] times a state."""
        return np.stack([-(damping * first + second) / stiffness, first])

    held = settled(position, velocity - 1)
    late = settled(held[0] * rate, held[1] * rate - 1)
    return transition, held - late, late
