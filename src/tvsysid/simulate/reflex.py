"""The stretch reflex, and a joint that has one."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.signal import bilinear, lfilter

from tvsysid.errors import InputError
from tvsysid.simulate.actuator import answer
from tvsysid.simulate.joint import Joint
from tvsysid.simulate.profiles import Profile, checked_profile, over_time
from tvsysid.simulate.settings import not_negative, positive
from tvsysid.simulate.setup import Setup
from tvsysid.simulate.simulation import Simulation

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StretchReflex:
    r"""Torque of a muscle that answers the velocity of stretch some time later.

    .. math:: \ddot r(t) + 2 \zeta \omega\, \dot r(t) + \omega^2\, r(t) = \omega^2\, g(t)\, f(t - d), \qquad
              f = s \max(s\, \dot\theta - c, 0)

    Parameters
    ----------
    delay
        d in s, rounded to a sample.
    frequency, damping
        Natural frequency ω of the muscle in rad/s, and its damping ratio ζ.
    threshold
        Velocity c in rad/s below which nothing is answered.
    direction
        s: 1 where a positive velocity stretches the muscle, -1 where a negative one does.
    """

    delay: float = 0.040
    frequency: float = 15.6
    damping: float = 0.62
    threshold: float = 0.0
    direction: int = 1

    def __post_init__(self) -> None:
        positive("StretchReflex", frequency=self.frequency, damping=self.damping)
        not_negative("StretchReflex", delay=self.delay, threshold=self.threshold)
        if self.direction not in (-1, 1):
            raise InputError(f"StretchReflex: direction must be 1 or -1, got {self.direction!r}")

    def torque(self, velocity: Array, gain: float | Array, rate: float) -> Array:
        """Torque r in N·m that answers a velocity in rad/s, shape (time,); the gain g is in N·m·s/rad."""
        late, square = round(self.delay * rate), self.frequency**2
        stretch = np.zeros_like(velocity)
        stretch[late:] = self.direction * velocity[: len(velocity) - late] - self.threshold
        np.maximum(stretch, 0.0, out=stretch)
        muscle = bilinear([square], [1.0, 2 * self.damping * self.frequency, square], fs=rate)
        return np.asarray(lfilter(*muscle, self.direction * gain * stretch))


@dataclass(frozen=True)
class ReflexJoint(Joint):
    r"""A joint with a stretch reflex, whose angle is imposed.

    .. math:: y(t) = I\,\ddot\theta(t) + b(t)\,\dot\theta(t) + k(t)\,\theta(t) + r(t) + n(t)

    with the torque r of :class:`StretchReflex`; the gain at a time scales what arrives at the muscle at that time. The
    noise is sized by the whole noiseless torque; all else is as for :class:`Joint`.

    Truth: ``stiffness``, ``viscosity``, ``inertia``, ``reflex_gain``. Pathways: ``intrinsic``, ``reflex``.

    Parameters
    ----------
    stiffness, viscosity, inertia
        As for :class:`Joint`.
    reflex_gain
        g in N·m·s/rad, or a callable of time in s.
    reflex
        Delay, muscle and threshold.

    Raises
    ------
    InputError
        As for :class:`Joint`, and for a gain that is neither number nor callable.

    References
    ----------
    Parallel pathways: Kearney, Stein & Parameswaran 1997, IEEE Trans. Biomed. Eng. 44, 493-504.

    Examples
    --------
    >>> import tvsysid as tv
    >>> joint = tv.simulate.ReflexJoint(stiffness=tv.simulate.SineWave(), reflex_gain=tv.simulate.SineWave(8, 4))
    >>> joint.simulate(40, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1)
    Simulation(Recording(42 s at 1000 Hz; ...); ... reflex_gain 4 to 12; pathways intrinsic, reflex)
    """

    reflex_gain: float | Profile = 8.0
    reflex: StretchReflex = field(default_factory=StretchReflex)

    def __post_init__(self) -> None:
        super().__post_init__()
        checked_profile("ReflexJoint", "reflex_gain", self.reflex_gain, number=True)
        if not isinstance(self.reflex, StretchReflex):
            raise InputError(f"ReflexJoint: reflex must be a StretchReflex, got {self.reflex!r}")

    def _simulated(self, setup: Setup) -> Simulation:
        impedance = self._impedance(setup, setup.index)
        found = answer(setup, impedance, setup.streams())
        gain = over_time("ReflexJoint: reflex_gain", self.reflex_gain, setup.whole_index, setup.rate)
        reflex = self.reflex.torque(found.velocity, gain, setup.rate)[setup.run_in :]
        pathways = {"intrinsic": found.torque, "reflex": reflex}
        return setup.simulation(found.angle, found.noise, pathways, impedance | {"reflex_gain": gain[setup.run_in :]})
