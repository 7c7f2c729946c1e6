"""A joint on a compliant actuator: a closed loop, in which noise of the torque moves the angle."""

from __future__ import annotations

import math
from typing import Any, Literal

import attrs
import numpy as np

from tvsysid.numerics import Array
from tvsysid.simulate.actuator import actuate
from tvsysid.simulate.conditions import Conditions
from tvsysid.simulate.joint import Joint
from tvsysid.simulate.motion import driven_motion
from tvsysid.simulate.simulation import Simulation
from tvsysid.validators import not_negative, one_of, optional, positive

Disturbance = Literal["angle", "torque"]
STIFF = 0.1  # squared natural frequency times step beyond which an actuator counts as stiff


def _transmits(item: CompliantActuator, field: attrs.Attribute[Any], value: object) -> None:
    (positive if item.disturbance == "angle" else not_negative)(item, field, value)


@attrs.frozen
class CompliantActuator(Joint):
    r"""A joint in closed loop: its torque moves the actuator, or another load it is on.

    .. math:: y(t) = I\,\ddot\theta + b(t)\,\dot\theta + k(t)\,\theta + n(t), \qquad
              M\,\ddot\theta + B\,\dot\theta + A\,\theta = d(t) - y(t)

    With ``disturbance="torque"`` the disturbance d is the perturbation, as a torque. With
    ``"angle"`` it is the reference angle of the actuator, which is the perturbation after the 40-Hz
    filter of :class:`Joint`; A d takes the place of d.

    The angle that the disturbance causes is scaled to an RMS of 0.5 degrees. The noise is scaled to
    the torque that the disturbance causes. Methods that take the angle as independent of the noise
    are biased in such a loop. The softer the actuator and the slower the noise, the larger is their
    bias.

    Truth: ``stiffness``, ``viscosity``, ``inertia`` (of the joint). Pathway: ``intrinsic``, the
    response to the whole angle. Channel: ``disturbance``, d in rad or N·m.

    Parameters
    ----------
    actuator_stiffness, actuator_viscosity, actuator_inertia
        Load: A in N·m/rad, B in N·m·s/rad (None for 0.7 of its critical damping) and M in kg·m².
        Each may be 0; a stiffness of 0 takes a torque as the disturbance.
    disturbance
        ``"angle"`` or ``"torque"``.

    References
    ----------
    Closed loops in joint identification: van der Helm et al. 2002, J. Neurosci. Methods 119, 1-14.
    Loads: Ludvig & Kearney 2009, Proc. IEEE EMBS 31, 1558-1561.

    Examples
    --------
    >>> import tvsysid as tv
    >>> simulation = tv.simulate.CompliantActuator(actuator_stiffness=100.0).simulate(
    ...     40, perturbation=tv.simulate.FilteredNoise(20.0), snr_db=5, seed=1)
    >>> simulation.recording.channels["disturbance"].shape
    (42000,)
    """

    actuator_stiffness: float = attrs.field(default=100.0, validator=_transmits)
    actuator_viscosity: float | None = attrs.field(default=None, validator=optional(not_negative))
    actuator_inertia: float = attrs.field(default=0.05, validator=not_negative)
    disturbance: Disturbance = attrs.field(default="angle", validator=one_of(Disturbance))

    def _simulate(self, conditions: Conditions) -> Simulation:
        time, rate, drive = conditions.time, conditions.rate, conditions.drive()
        # The noise begins with an impulse, whose rest is some 1e-6 of the torque at 2 Hz. Results
        # of the closed-loop study depend on it.
        noise = conditions.noise(self.noise_bandwidth, 1.0)
        impedance = self._impedance(time, rate)
        joint, load = np.stack([*impedance.values()]), self._with_load(impedance)
        mass = self.inertia + self.actuator_inertia
        if self.disturbance == "torque":
            applied, force, added = drive, drive, np.zeros(1)
            between = self._impedance(time[:-1] + 0.5 / rate, 2 * rate)
            held = tuple(self._with_load(between)[:2] / mass)
        else:
            # As a deviation from a share of the reference. The motion of the angle itself would
            # ring between samples on a stiff actuator. The deviation from the whole reference would
            # be a small difference of large numbers on a soft one.
            turned = float(load[0].mean()) / mass / rate**2  # squared, within a step
            share = turned**2 / (STIFF**2 + turned**2)
            reference = actuate(drive, rate)
            applied, added, held = reference[0], share * reference, None
            force = self.actuator_stiffness * applied - share * np.einsum(
                "qt,qt->t", load, reference
            )
        # The system is linear: motion that the force and that the noise causes.
        forces = np.stack([force, -noise]) / mass
        motion = driven_motion(load[0] / mass, load[1] / mass, forces, rate, held)
        motion[:, 0] += added
        scale = conditions.angle_scale(motion[0, 0])
        imposed = scale * np.einsum("qt,qt->t", joint, motion[:, 0])
        size = conditions.noise_scale(imposed, noise)
        motion = scale * motion[:, 0] + size * motion[:, 1]
        torque = np.einsum("qt,qt->t", joint, motion)
        return conditions.simulation(
            motion[0],
            size * noise,
            {"intrinsic": torque},
            impedance,
            {"disturbance": scale * applied},
        )

    def _with_load(self, impedance: dict[str, Array]) -> Array:
        """Return stiffness, viscosity and inertia of joint and load together (3, time)."""
        viscosity = self.actuator_viscosity
        if viscosity is None:
            viscosity = 1.4 * math.sqrt(self.actuator_stiffness * self.actuator_inertia)
        load = np.array([[self.actuator_stiffness], [viscosity], [self.actuator_inertia]])
        return np.stack([*impedance.values()]) + load
