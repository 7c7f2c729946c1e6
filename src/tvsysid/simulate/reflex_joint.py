"""A joint with a stretch reflex, whose angle is imposed."""

from __future__ import annotations

import math

import attrs
import numpy as np

from tvsysid.simulate.actuator import impose
from tvsysid.simulate.conditions import BANDWIDTH, Conditions
from tvsysid.simulate.joint import Joint
from tvsysid.simulate.profiles import Profile, number_or_profile
from tvsysid.simulate.reflex import StretchReflex, is_reflex
from tvsysid.simulate.simulation import Simulation
from tvsysid.validators import positive

EMG_LEAD_S = 0.010  # from EMG to force


@attrs.frozen
class ReflexJoint(Joint):
    r"""A joint with a stretch reflex, whose angle is imposed.

    .. math:: y(t) = I\,\ddot\theta(t) + b(t)\,\dot\theta(t) + k(t)\,\theta(t) + r(t) + n(t)

    The torque r is that of :class:`StretchReflex`. The gain at a time scales the stretch that
    arrives at the muscle at that time. The noise is scaled to the whole noiseless torque. All else
    is as for :class:`Joint`.

    Truth: ``stiffness``, ``viscosity``, ``inertia``, ``reflex_gain``. Pathways: ``intrinsic``,
    ``reflex``. Channel: ``emg``, the rectified EMG in rad/s. It is the stretch that arrives at the
    muscle, 10 ms before the force, times the magnitude of white noise with a mean of 1. It does not
    depend on the gain.

    Parameters
    ----------
    reflex_gain
        Gain in N·m·s/rad, or a callable of time in s.
    reflex
        Settings of the reflex.
    noise_bandwidth
        Cut-off in Hz of the torque's noise, for instance 1 Hz for slow voluntary torque.

    References
    ----------
    Parallel pathways: Kearney, Stein & Parameswaran 1997, IEEE Trans. Biomed. Eng. 44, 493-504.

    Examples
    --------
    >>> import tvsysid as tv
    >>> joint = tv.simulate.ReflexJoint(
    ...     stiffness=tv.simulate.SineWave(), reflex_gain=tv.simulate.SineWave(8, 4))
    >>> joint.simulate(40, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1)
    Simulation(Recording(42 s at 1000 Hz; ...); ... reflex_gain 4 to 12; pathways intrinsic, reflex)
    """

    reflex_gain: float | Profile = attrs.field(default=8.0, validator=number_or_profile)
    reflex: StretchReflex = attrs.field(factory=StretchReflex, validator=is_reflex)
    noise_bandwidth: float = attrs.field(default=BANDWIDTH, validator=positive)

    def _simulate(self, conditions: Conditions) -> Simulation:
        rate, generators = conditions.rate, conditions.generators(3)
        impedance = self._impedance(conditions.time)
        imposed = impose(conditions, impedance, generators, self.noise_bandwidth)
        gain = self._over_time("reflex_gain", conditions.whole_time)
        torque = self.reflex.torque(imposed.velocity, gain, rate, -2 * conditions.second)
        stretch = self.reflex.stretch(imposed.velocity, rate, EMG_LEAD_S)
        emg = np.abs(stretch * generators[2].standard_normal(len(gain))) / math.sqrt(2 / math.pi)
        recorded = slice(conditions.second, None)
        return conditions.simulation(
            imposed.angle,
            imposed.noise,
            {"intrinsic": imposed.torque, "reflex": torque[recorded]},
            impedance | {"reflex_gain": gain[recorded]},
            {"emg": emg[recorded]},
        )
