"""Joints of time-varying impedance whose angle is imposed."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import attrs
import numpy as np
from numpy.polynomial import Polynomial

from tvsysid.errors import InputError
from tvsysid.numerics import Array
from tvsysid.simulate.actuator import BANDWIDTH, actuate
from tvsysid.simulate.conditions import Conditions
from tvsysid.simulate.perturbations import Perturbation
from tvsysid.simulate.profiles import (
    Profile,
    SineWave,
    SquareWave,
    evaluate,
    is_profile,
    number_or_profile,
    over_time,
)
from tvsysid.simulate.reflex import StretchReflex
from tvsysid.simulate.simulation import Seed, Simulation
from tvsysid.validators import not_negative, positive

Relation = Callable[[Array], Array]  # from values of a variable to one number for each

EMG_LEAD_S = 0.010  # delay from EMG to force
INTERVAL_S = 2.0  # after which the strength of a variable is drawn anew


def impose(
    conditions: Conditions,
    truth: Mapping[str, Array],
    noise_bandwidth: float,
    reflex: StretchReflex | None = None,
    gain: Array | float = 0.0,
    channels: Callable[[Array], dict[str, Array]] = lambda velocity: {},
) -> Simulation:
    """Impose the perturbation on a joint whose impedance over time is the truth.

    The ``channels`` are a function of the angle's velocity. The ``gain`` is that of the reflex.
    """
    motion = actuate(conditions.drive(), conditions.rate)
    angle, velocity, acceleration = motion
    torque = truth["inertia"] * acceleration
    torque += truth["viscosity"] * velocity
    torque += truth["stiffness"] * angle
    scale = conditions.angle_scale(angle)
    motion *= scale
    torque *= scale
    pathways = {"intrinsic": torque}
    if reflex is not None:
        pathways["reflex"] = reflex.torque(velocity, gain, conditions.rate)
    noise = conditions.noise(noise_bandwidth)
    noise *= conditions.noise_scale(sum(pathways.values()), noise)
    return conditions.simulation(angle, noise, pathways, truth, channels(velocity))


@attrs.frozen
class Joint:
    r"""A joint whose torque responds to an imposed angle.

    .. math:: y(t) = I\,\ddot\theta(t) + b(t)\,\dot\theta(t) + k(t)\,\theta(t) + n(t)

    Truth: ``stiffness``, ``viscosity``, ``inertia``. Pathway: ``intrinsic``.

    Parameters
    ----------
    stiffness
        Callable of time in s, which returns N·m/rad.
    viscosity
        Number in N·m·s/rad, or a callable of time in s.
    inertia
        In kg·m².
    noise_bandwidth
        Cut-off in Hz of the torque's noise, for instance 1 Hz for slow voluntary torque.

    References
    ----------
    van de Ruit et al. 2021, section 3.1.

    Examples
    --------
    >>> import tvsysid as tv
    >>> joint = tv.simulate.Joint(stiffness=tv.simulate.SquareWave())
    >>> joint.simulate(40, perturbation=tv.simulate.PRBS(), snr_db=10, seed=1)
    Simulation(Recording(42 s at 1000 Hz; ...); stiffness 50 to 150, viscosity 2.2, inertia 0.02;
    pathways intrinsic)
    """

    stiffness: Profile = attrs.field(factory=SquareWave, validator=is_profile)
    viscosity: float | Profile = attrs.field(default=2.2, validator=number_or_profile)
    inertia: float = attrs.field(default=0.02, validator=positive)
    noise_bandwidth: float = attrs.field(default=BANDWIDTH, validator=positive, kw_only=True)

    def simulate(
        self,
        duration: float,
        *,
        perturbation: Perturbation,
        snr_db: float,
        seed: Seed,
        rate: float = 1000.0,
    ) -> Simulation:
        """Simulate a recording.

        The perturbation passes a 40-Hz second-order Bessel filter (the actuator), which gives
        angle, velocity and acceleration without numerical differentiation. The angle is scaled to
        an RMS of 0.5 degrees. The noise is white noise through a second-order Butterworth filter,
        scaled to the signal-to-noise ratio. Both scales are computed from time 0 to the duration.

        Parameters
        ----------
        duration
            In s, counted from time 0. The recording has one second more on both sides.
        perturbation
            :class:`FilteredNoise`, :class:`PRBS`, or any object with such a ``generate`` method.
        snr_db
            Ratio of the variances of noiseless torque and noise in dB; ``inf`` for no noise.
        seed
            Random seed: an integer, SeedSequence or Generator. The same integer or SeedSequence
            gives the same simulation. Perturbation and noise use independent random numbers.
        rate
            Sampling rate in Hz, above twice the 40 Hz of the filters.

        Raises
        ------
        InputError
            For a duration or rate that is not positive.
        """
        return self._simulate(Conditions(duration, perturbation, snr_db, seed, rate))

    def _simulate(self, conditions: Conditions) -> Simulation:
        truth = self._impedance(conditions.time, conditions.rate)
        return impose(conditions, truth, self.noise_bandwidth)

    def _impedance(self, time: Array, rate: float) -> dict[str, Array]:
        """Return stiffness, viscosity and inertia over time."""
        names = ("stiffness", "viscosity", "inertia")
        return {name: over_time(getattr(self, name), time, rate) for name in names}


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
    reflex: StretchReflex = attrs.field(factory=StretchReflex)

    def _simulate(self, conditions: Conditions) -> Simulation:
        time, rate = conditions.time, conditions.rate
        gain = over_time(self.reflex_gain, time, rate)
        truth = self._impedance(time, rate) | {"reflex_gain": gain}

        def emg(velocity: Array) -> dict[str, Array]:
            noise = conditions.generators[2].standard_normal(len(velocity))
            stretch = self.reflex.stretch(velocity, rate, EMG_LEAD_S)
            return {"emg": np.abs(stretch * noise) / math.sqrt(2 / math.pi)}

        return impose(conditions, truth, self.noise_bandwidth, self.reflex, gain, emg)


@attrs.frozen
class ScheduledJoint(Joint):
    r"""A joint whose stiffness depends on a measured variable, such as EMG.

    .. math:: y(t) = I\,\ddot\theta(t) + b\,\dot\theta(t) + k(\rho(t))\,\theta(t) + r(t) + n(t),
              \qquad \rho(t) = (1 + \sigma\, g(t))\, k^{-1}(k_0(t))

    With σ = 0, the stiffness follows the profile k₀. Otherwise, the variable ρ is randomly stronger
    or weaker. Its deviation g is Gaussian with unit variance, drawn anew every 2 s and
    interpolated linearly. The factor 1 + σ g is never negative. All else is as for
    :class:`Joint`.

    Truth: ``stiffness``, ``viscosity``, ``inertia``, and ``reflex_gain`` if there is a reflex.
    Pathways: ``intrinsic``, and ``reflex``. Channel: the variable, by its name.

    Parameters
    ----------
    stiffness
        Profile k₀.
    relation
        Callable k of the variable, which returns N·m/rad. Without a schedule, it must increase from
        0 to 1 and reach all values of the profile there.
    variation
        Standard deviation σ of the factor.
    variable
        Name of the channel.
    schedule
        Variable over time, in place of :math:`k^{-1}(k_0(t))`, for instance if a joint is moved
        slowly.
    viscosity_relation
        Callable of the variable, which returns N·m·s/rad, in place of ``viscosity``.
    gain_relation
        Callable of the variable at the time of the stretch, which returns the gain of the
        ``reflex`` in N·m·s/rad.

    References
    ----------
    Stiffness that rises with muscle activity: Hunter & Kearney 1982, J. Biomech. 15, 747-752.

    Examples
    --------
    >>> import tvsysid as tv
    >>> simulation = tv.simulate.ScheduledJoint().simulate(
    ...     40, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1)
    >>> list(simulation.recording.channels)
    ['emg']
    """

    # attrs moves a redeclared field behind the inherited ones. Redeclaring all keeps their order.
    stiffness: Profile = attrs.field(factory=SineWave, validator=is_profile)
    viscosity: float | Profile = attrs.field(default=2.2, validator=number_or_profile)
    inertia: float = attrs.field(default=0.02, validator=positive)
    relation: Relation = attrs.field(factory=lambda: Polynomial([20.0, 200.0]))
    variation: float = attrs.field(default=0.3, validator=not_negative)
    variable: str = "emg"
    schedule: Profile | None = None
    viscosity_relation: Relation | None = None
    gain_relation: Relation | None = None
    reflex: StretchReflex = attrs.field(factory=StretchReflex)

    def _simulate(self, conditions: Conditions) -> Simulation:
        time, rate = conditions.time, conditions.rate
        truth = self._impedance(time, rate)
        if self.schedule is None:
            variable = self._inverse_relation(truth["stiffness"])
        else:
            variable = over_time(self.schedule, time, rate)
        variable = variable * self._strength(conditions)
        truth["stiffness"] = evaluate(self.relation, variable)
        if self.viscosity_relation is not None:
            truth["viscosity"] = evaluate(self.viscosity_relation, variable)
        reflex, late = None, variable
        if self.gain_relation is not None:
            reflex = self.reflex
            truth["reflex_gain"] = evaluate(self.gain_relation, variable)
            # The gain at the time of the stretch counts. Before the record, it is the first value.
            early = conditions.second + round(reflex.delay * rate)
            late = np.pad(truth["reflex_gain"][conditions.second :], (early, 0), "edge")[
                : len(time)
            ]
        channels = {self.variable: variable}
        return impose(conditions, truth, self.noise_bandwidth, reflex, late, lambda _: channels)

    def _inverse_relation(self, stiffness: Array) -> Array:
        """Return the variable that gives a stiffness."""
        grid = np.linspace(0.0, 1.0, 10_001)
        values = evaluate(self.relation, grid)
        low, high = stiffness.min(), stiffness.max()
        if not np.all(np.diff(values) > 0) or values[0] > low or high > values[-1]:
            raise InputError(
                "ScheduledJoint: relation must rise from 0 to 1 and cover the stiffness of "
                f"{low:g} to {high:g} N·m/rad; it gives {values[0]:g} to {values[-1]:g} N·m/rad"
            )
        return np.interp(stiffness, values, grid)

    def _strength(self, conditions: Conditions) -> Array:
        """Return the factor of the variable over time. Its mean is 1."""
        time = conditions.time
        knots = np.arange(time[conditions.second], time[-1] + INTERVAL_S, INTERVAL_S)
        random = conditions.generators[2].standard_normal(len(knots))
        return np.maximum(np.interp(time, knots, 1 + self.variation * random), 0.0)
