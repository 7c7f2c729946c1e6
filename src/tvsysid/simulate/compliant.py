"""A joint on an actuator of finite stiffness: a closed loop, in which the noise of the torque moves the angle."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tvsysid.errors import InputError
from tvsysid.simulate.actuator import Actuator
from tvsysid.simulate.joint import Joint
from tvsysid.simulate.motion import driven_motion
from tvsysid.simulate.perturbations import generated
from tvsysid.simulate.settings import positive
from tvsysid.simulate.setup import BANDWIDTH, Setup
from tvsysid.simulate.simulation import Simulation


@dataclass(frozen=True)
class CompliantActuator(Joint):
    r"""A joint in closed loop: its torque moves the actuator, which is not infinitely stiff.

    .. math:: y(t) = I\,\ddot\theta + b(t)\,\dot\theta + k(t)\,\theta + n(t), \qquad
              M\,\ddot\theta + B\,\dot\theta + A\,(\theta - d(t)) = -y(t)

    The reference d is the perturbation after the 40-Hz filter of :class:`Joint`. The angle that it causes is scaled to
    an RMS of 0.5 degrees, and the noise such that the torque that the reference causes and the noise have the ratio of
    variances asked for. Methods that take the angle as independent of the noise are biased in such a loop, the more so
    the softer the actuator and the slower the noise.

    Truth: ``stiffness``, ``viscosity``, ``inertia`` (of the joint). Pathway: ``intrinsic``, which answers the whole
    angle. Channel: ``disturbance``, the reference d in rad.

    The actuator has a stiffness A in N·m/rad, a viscosity B in N·m·s/rad (None for 0.7 of what damps it critically,
    alone) and an inertia M in kg·m², with all that it carries beside the joint. ``noise_bandwidth`` is the cut-off in
    Hz of the noise's second-order Butterworth filter.

    Raises
    ------
    InputError
        As for :class:`Joint`, for settings of the actuator that are not positive, and where the stiffness of joint and
        actuator together is not.

    References
    ----------
    Closed loops in joint identification: van der Helm et al. 2002, J. Neurosci. Methods 119, 1-14.

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

    def __post_init__(self) -> None:
        super().__post_init__()
        own = ["actuator_stiffness", "actuator_inertia", "noise_bandwidth"]
        if self.actuator_viscosity is not None:
            own.append("actuator_viscosity")
        positive("CompliantActuator", **{name: getattr(self, name) for name in own})

    def _simulated(self, setup: Setup) -> Simulation:
        impedance = self._impedance(setup, setup.whole_index)
        for_drive, for_noise = setup.streams()
        samples, run_in = len(setup.whole_index), setup.run_in
        drive = generated(setup.perturbation, samples, setup.rate, for_drive)
        reference = np.stack(Actuator(setup.rate)(drive))  # with its derivatives
        noise = setup.low_passed(for_noise, self.noise_bandwidth, settling=0)(samples)

        weights = np.stack([impedance[name] for name in ("stiffness", "viscosity", "inertia")])
        damping = self.actuator_viscosity
        if damping is None:
            damping = 1.4 * math.sqrt(self.actuator_stiffness * self.actuator_inertia)
        lowest = float(weights[0].min())
        if lowest + self.actuator_stiffness <= 0:
            raise InputError(
                f"CompliantActuator: the stiffness of joint (lowest: {lowest:g} N·m/rad) and actuator "
                f"({self.actuator_stiffness:g} N·m/rad) together must be positive; stiffen either"
            )
        # The angle's deviation from the reference, which is smoother than the reference between samples; what the
        # reference and what the noise moves apart, for the system is linear.
        mass = self.inertia + self.actuator_inertia
        load = weights + np.array([[0.0], [damping], [self.actuator_inertia]])
        forces = np.stack([-np.einsum("qt,qt->t", load, reference), -noise]) / mass
        motion = driven_motion((weights[0] + self.actuator_stiffness) / mass, load[1] / mass, forces, setup.rate)
        motion[:, 0] += reference
        motion, weights, reference, noise = (x[..., run_in:] for x in (motion, weights, reference, noise))

        scale = setup.scale_of(motion[0, 0])
        imposed = scale * np.einsum("qt,qt->t", weights, motion[:, 0])
        motion = scale * motion[:, 0] + setup.noise_scale(imposed, noise) * motion[:, 1]
        return setup.simulation(
            motion[0],
            noise,
            {"intrinsic": np.einsum("qt,qt->t", weights, motion)},
            {name: values[run_in:] for name, values in impedance.items()},
            {"disturbance": scale * reference[0]},
            answered=imposed,
        )
