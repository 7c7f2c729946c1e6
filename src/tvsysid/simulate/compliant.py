"""A joint on an actuator of finite stiffness: a closed loop, in which the noise of the torque moves the angle."""

from __future__ import annotations

import math
from typing import Literal, get_args

import attrs
import numpy as np

from tvsysid.errors import InputError
from tvsysid.numerics import Array
from tvsysid.simulate.actuator import Actuator
from tvsysid.simulate.joint import Joint
from tvsysid.simulate.motion import driven_motion
from tvsysid.simulate.perturbations import generated
from tvsysid.simulate.settings import not_negative, positive
from tvsysid.simulate.setup import BANDWIDTH, Setup
from tvsysid.simulate.simulation import Simulation

Disturbance = Literal["angle", "torque"]
STIFF = 0.1  # squared natural frequency times step, beyond which an actuator counts as stiff
QUANTITIES = ("stiffness", "viscosity", "inertia")


@attrs.frozen
class CompliantActuator(Joint):
    r"""A joint in closed loop: its torque moves the actuator, or whatever load it is on.

    .. math:: y(t) = I\,\ddot\theta + b(t)\,\dot\theta + k(t)\,\theta + n(t), \qquad
              M\,\ddot\theta + B\,\dot\theta + A\,\theta = d(t) - y(t)

    with a torque d as the disturbance (``disturbance="torque"``): the perturbation as it is. By
    default it is an angle, and A d stands in the place of d, with M and B acting on :math:`\theta`
    as well: the reference of an actuator that is not infinitely stiff, which is the perturbation
    after the 40-Hz filter of :class:`Joint`.

    The angle that the disturbance causes is scaled to an RMS of 0.5 degrees, and the noise such
    that the torque that the disturbance causes and the noise have the ratio of variances asked for.
    Methods that take the angle as independent of the noise are biased in such a loop, the more so
    the softer the actuator and the slower the noise.

    Truth: ``stiffness``, ``viscosity``, ``inertia`` (of the joint). Pathway: ``intrinsic``, which
    answers the whole angle. Channel: ``disturbance``, d in rad or N·m.

    The load has a stiffness A in N·m/rad (``actuator_stiffness``), a viscosity B in N·m·s/rad (None
    for 0.7 of what damps it critically, alone) and an inertia M in kg·m²: elastic, viscous and
    inertial loads, each of which may be 0 beside a torque. ``noise_bandwidth`` is the cut-off in Hz
    of the noise's second-order Butterworth filter.

    Raises
    ------
    InputError
        As for :class:`Joint`, for settings of the actuator that are not positive (with a torque:
        negative), and where the stiffness of joint and actuator together is not.

    References
    ----------
    Closed loops in joint identification: van der Helm et al. 2002, J. Neurosci. Methods 119, 1-14; loads: Ludvig &
    Kearney 2009, Proc. IEEE EMBS 31, 1558-1561.

    Examples
    --------
    >>> import tvsysid as tv
    >>> simulation = tv.simulate.CompliantActuator(actuator_stiffness=100.0).simulate(
    ...     40, perturbation=tv.simulate.FilteredNoise(20.0), snr_db=5, seed=1)
    >>> simulation.recording.channels["disturbance"].shape
    (42000,)
    """

    actuator_stiffness: float = 100.0
    actuator_viscosity: float | None = None
    actuator_inertia: float = 0.05
    noise_bandwidth: float = BANDWIDTH
    disturbance: Disturbance = "angle"

    def __attrs_post_init__(self) -> None:
        super().__attrs_post_init__()
        if self.disturbance not in get_args(Disturbance):
            raise InputError(
                "CompliantActuator: disturbance must be 'angle' or 'torque', got "
                f"{self.disturbance!r}"
            )
        own = ["actuator_stiffness", "actuator_inertia"]
        if self.actuator_viscosity is not None:
            own.append("actuator_viscosity")
        check = positive if self.disturbance == "angle" else not_negative
        check("CompliantActuator", **{name: getattr(self, name) for name in own})
        positive("CompliantActuator", noise_bandwidth=self.noise_bandwidth)

    def _simulated(self, setup: Setup) -> Simulation:
        impedance = self._impedance(setup, setup.whole_index)
        for_drive, for_noise = setup.streams()
        samples, run_in = len(setup.whole_index), setup.run_in
        drive = generated(setup.perturbation, samples, setup.rate, for_drive)
        noise = setup.low_passed(for_noise, self.noise_bandwidth, settling=0)(samples)

        weights = np.stack([impedance[name] for name in QUANTITIES])
        load = weights + self._load[:, None]
        lowest = float(load[0].min())
        if lowest <= 0:
            raise InputError(
                "CompliantActuator: the stiffness of joint (lowest: "
                f"{lowest - self.actuator_stiffness:g} N·m/rad) and "
                f"actuator ({self.actuator_stiffness:g} N·m/rad) together must be positive; "
                "stiffen either"
            )
        # What the disturbance and what the noise moves apart, for the system is linear.
        if self.disturbance == "torque":
            finer = np.arange(2 * setup.whole_index[0] + 1, 2 * setup.whole_index[-1])
            between = self._impedance(setup, finer, 2)
            held = np.stack([between[name][::2] for name in QUANTITIES]) + self._load[:, None]
            applied, motion = drive, self._moved(load, np.stack([drive, -noise]), setup.rate, held)
        else:  # as a deviation from a share of the reference, for its acceleration is not linear between samples
            reference = np.stack(Actuator(setup.rate)(drive))
            part = self._followed(load, setup.rate)
            pull = self.actuator_stiffness * reference[0] - part * np.einsum(
                "qt,qt->t", load, reference
            )
            applied, motion = reference[0], self._moved(load, np.stack([pull, -noise]), setup.rate)
            motion[:, 0] += part * reference
        motion, weights, applied, noise = (
            x[..., run_in:] for x in (motion, weights, applied, noise)
        )

        scale = setup.scale_of(motion[0, 0])
        imposed = scale * np.einsum("qt,qt->t", weights, motion[:, 0])
        motion = scale * motion[:, 0] + setup.noise_scale(imposed, noise) * motion[:, 1]
        return setup.simulation(
            motion[0],
            noise,
            {"intrinsic": np.einsum("qt,qt->t", weights, motion)},
            {name: values[run_in:] for name, values in impedance.items()},
            {"disturbance": scale * applied},
            answered=imposed,
        )

    @property
    def _load(self) -> Array:
        """Stiffness, viscosity and inertia of the load."""
        damping = self.actuator_viscosity
        if damping is None:
            damping = 1.4 * math.sqrt(self.actuator_stiffness * self.actuator_inertia)
        return np.array([self.actuator_stiffness, damping, self.actuator_inertia])

    def _followed(self, load: Array, rate: float) -> float:
        """Share of the reference that the joint follows at once: none of a soft actuator's, all of a stiff one's.

        Integrated as the angle itself, the motion on a stiff actuator would ring between
        samples; as a deviation from all of the reference, that on a soft one would be a small
        difference of two large ones.
        """
        turned = (
            float(load[0].mean()) / (self.inertia + self.actuator_inertia) / rate**2
        )  # squared, within a step
        return turned**2 / (STIFF**2 + turned**2)

    def _moved(self, load: Array, forces: Array, rate: float, held: Array | None = None) -> Array:
        """Angle, velocity and acceleration (3, force, time) of joint and load together (quantity, time or step)."""
        mass = self.inertia + self.actuator_inertia
        steps = None if held is None else (held[0] / mass, held[1] / mass)
        return driven_motion(load[0] / mass, load[1] / mass, forces / mass, rate, steps)
