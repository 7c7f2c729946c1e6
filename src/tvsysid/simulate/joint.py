"""Joints with time-varying impedance whose angle is imposed: with a stretch reflex, or scheduled by a variable."""

from __future__ import annotations

import math
from collections.abc import Callable

import attrs
import numpy as np
import scipy
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.numerics import Array
from tvsysid.simulate.actuator import answer
from tvsysid.simulate.motion import driven_motion
from tvsysid.simulate.perturbations import Perturbation
from tvsysid.simulate.profiles import Profile, SineWave, SquareWave, checked_profile, over_time
from tvsysid.simulate.settings import not_negative, positive
from tvsysid.simulate.setup import BANDWIDTH, Setup
from tvsysid.simulate.simulation import Seed, Simulation

EMG_LEAD = 0.010  # seconds from EMG to force
Relation = Callable[[Array], Array]  # of a variable's values, to one number for each


@attrs.frozen
class Joint:
    r"""A joint whose torque answers an imposed angle.

    .. math:: y(t) = I\,\ddot\theta(t) + b(t)\,\dot\theta(t) + k(t)\,\theta(t) + n(t)

    Its truth holds ``stiffness``, ``viscosity`` and ``inertia``; its one pathway is ``intrinsic``.

    Stiffness is a callable of time in s, to N·m/rad; one with an attribute ``period`` (in s) is
    evaluated over one period. Viscosity is in N·m·s/rad, or such a callable; inertia in kg·m².

    Raises
    ------
    InputError
        For an inertia that is not positive, or what is neither number nor callable.

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

    stiffness: Profile = attrs.field(factory=SquareWave)
    viscosity: float | Profile = 2.2
    inertia: float = 0.02

    def __attrs_post_init__(self) -> None:
        name = type(self).__name__
        checked_profile(name, "stiffness", self.stiffness)
        checked_profile(name, "viscosity", self.viscosity, number=True)
        positive(name, inertia=self.inertia)

    def simulate(
        self,
        duration: float,
        *,
        perturbation: Perturbation,
        snr_db: float,
        seed: Seed,
        rate: float = 1000.0,
    ) -> Simulation:
        """Record so many seconds.

        The perturbation passes a 40-Hz second-order Bessel filter (the actuator), whose states are
        angle and velocity and give the acceleration, so that nothing is differenced. The angle is
        scaled to an RMS of 0.5 degrees. The noise is white noise through a 40-Hz second-order
        Butterworth filter, scaled so that noiseless torque and noise have the ratio of variances
        asked for. Both scales are those of the samples from time 0 to the duration.

        Parameters
        ----------
        duration
            In s, counted from time 0. The recording has one second more on both sides.
        perturbation
            :class:`FilteredNoise`, :class:`PRBS`, or anything with their ``generate``.
        snr_db
            Ratio of the variances of noiseless torque and noise in dB; ``inf`` for no noise.
        seed
            Integer, SeedSequence or generator; the same one gives the same numbers. Perturbation
            and noise have streams of their own.
        rate
            Sampling rate in Hz, above twice the 40 Hz of the filters.

        Raises
        ------
        InputError
            For a duration or rate that is not positive, or a profile that does not give one finite
            number for each time.
        """
        return self._simulated(
            Setup(type(self).__name__, duration, perturbation, snr_db, seed, rate)
        )

    def _simulated(self, setup: Setup) -> Simulation:
        truth = self._impedance(setup, setup.index)
        found = answer(setup, truth, setup.streams())
        return setup.simulation(found.angle, found.noise, {"intrinsic": found.torque}, truth)

    def _impedance(
        self, setup: Setup, index: NDArray[np.int64], finer: int = 1
    ) -> dict[str, Array]:
        """Stiffness, viscosity and inertia over time, at samples of so many times the rate."""
        values, rate = (
            {name: getattr(self, name) for name in ("stiffness", "viscosity", "inertia")},
            finer * setup.rate,
        )
        return {
            name: over_time(f"{setup.system}: {name}", value, index, rate)
            for name, value in values.items()
        }


@attrs.frozen
class StretchReflex:
    r"""Torque of a muscle that answers the velocity of stretch some time later.

    .. math:: \ddot r(t) + 2 \zeta \omega\, \dot r(t) + \omega^2\, r(t) = \omega^2\, g(t)\, f(t - d), \qquad
              f = s \max(s\, \dot\theta - c, 0)

    The ``delay`` d is in s, rounded to a sample; ``frequency`` ω of the muscle in rad/s,
    ``damping`` its ratio ζ; ``threshold`` c in rad/s, the velocity below which nothing is
    answered; ``direction`` s is 1 where a positive velocity stretches the muscle, -1 where a
    negative one does. The gain g acts before the muscle, or on what leaves it where
    ``gain_after`` is true. A frequency that is a callable of time makes a muscle that changes.
    """

    delay: float = 0.040
    frequency: float | Profile = 15.6
    damping: float = 0.62
    threshold: float = 0.0
    direction: int = 1
    gain_after: bool = False

    def __attrs_post_init__(self) -> None:
        if not callable(self.frequency):
            positive("StretchReflex", frequency=self.frequency)
        positive("StretchReflex", damping=self.damping)
        not_negative("StretchReflex", delay=self.delay, threshold=self.threshold)
        if self.direction not in (-1, 1):
            raise InputError(f"StretchReflex: direction must be 1 or -1, got {self.direction!r}")

    def stretch(self, velocity: Array, rate: float, early: float = 0.0) -> Array:
        """What arrives at the muscle, f(t - d) in rad/s, or so many seconds before it does.

        Shape (time,).
        """
        late = round(max(self.delay - early, 0.0) * rate)
        beyond = np.zeros_like(velocity)
        beyond[late:] = self.direction * velocity[: len(velocity) - late] - self.threshold
        return self.direction * np.maximum(beyond, 0.0, out=beyond)

    def torque(self, velocity: Array, gain: float | Array, rate: float, start: int = 0) -> Array:
        """Torque r in N·m that answers a velocity in rad/s, shape (time,).

        The gain g is in N·m·s/rad.

        The first sample is at time start / rate.
        """
        stretch = self.stretch(velocity, rate)
        if self.gain_after:
            return gain * self._muscle(stretch, rate, start)
        return self._muscle(gain * stretch, rate, start)

    def _muscle(self, drive: Array, rate: float, start: int) -> Array:
        """What the muscle makes of its drive; its gain is 1."""
        if not callable(self.frequency):
            square = self.frequency**2
            muscle = scipy.signal.bilinear(
                [square], [1.0, 2 * self.damping * self.frequency, square], fs=rate
            )
            return np.asarray(scipy.signal.lfilter(*muscle, drive))
        index = np.arange(start, start + len(drive))
        frequency = over_time("StretchReflex: frequency", self.frequency, index, rate)
        if frequency.min() <= 0:
            raise InputError(
                f"StretchReflex: frequency must be positive at all times, got {frequency.min():g} "
                "rad/s"
            )
        force = np.square(frequency) * drive
        moved = driven_motion(np.square(frequency), 2 * self.damping * frequency, force[None], rate)
        return np.asarray(moved[0, 0])


@attrs.frozen
class ReflexJoint(Joint):
    r"""A joint with a stretch reflex, whose angle is imposed.

    .. math:: y(t) = I\,\ddot\theta(t) + b(t)\,\dot\theta(t) + k(t)\,\theta(t) + r(t) + n(t)

    with the torque r of :class:`StretchReflex`; the gain at a time scales what arrives at the
    muscle at that time. The noise is sized by the whole noiseless torque; all else is as for
    :class:`Joint`.

    Truth: ``stiffness``, ``viscosity``, ``inertia``, ``reflex_gain``. Pathways: ``intrinsic``,
    ``reflex``. Channel: ``emg``, the rectified EMG in rad/s: what arrives at the muscle, 10 ms
    before it pulls, times the magnitude of white noise, whose mean is 1. The electrode does not see
    the gain.

    The gain g is in N·m·s/rad, or a callable of time in s; ``noise_bandwidth`` the cut-off in Hz of
    the noise of the torque, for instance 1 Hz for slow voluntary torque.

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
    reflex: StretchReflex = attrs.field(factory=StretchReflex)
    noise_bandwidth: float = BANDWIDTH

    def __attrs_post_init__(self) -> None:
        super().__attrs_post_init__()
        checked_profile("ReflexJoint", "reflex_gain", self.reflex_gain, number=True)
        positive("ReflexJoint", noise_bandwidth=self.noise_bandwidth)
        if not isinstance(self.reflex, StretchReflex):
            raise InputError(f"ReflexJoint: reflex must be a StretchReflex, got {self.reflex!r}")

    def _simulated(self, setup: Setup) -> Simulation:
        impedance, streams, rate = self._impedance(setup, setup.index), setup.streams(3), setup.rate
        found = answer(setup, impedance, streams, self.noise_bandwidth)
        gain = over_time("ReflexJoint: reflex_gain", self.reflex_gain, setup.whole_index, rate)
        reflex = self.reflex.torque(found.velocity, gain, rate, int(setup.whole_index[0]))
        emg = np.abs(
            self.reflex.stretch(found.velocity, rate, EMG_LEAD)
            * streams[2].standard_normal(len(gain))
        )
        own = slice(setup.run_in, None)  # what is recorded
        return setup.simulation(
            found.angle,
            found.noise,
            {"intrinsic": found.torque, "reflex": reflex[own]},
            impedance | {"reflex_gain": gain[own]},
            {"emg": emg[own] / math.sqrt(2 / math.pi)},
        )


@attrs.frozen
class ScheduledJoint(Joint):
    r"""A joint whose stiffness follows a measured variable, such as EMG, that differs from realization to realization.

    .. math:: y(t) = I\,\ddot\theta(t) + b\,\dot\theta(t) + k(\rho(t))\,\theta(t) + r(t) + n(t), \qquad
              \rho(t) = (1 + \sigma\, g(t))\, k^{-1}(k_0(t))

    The variable ρ would give the profile k₀ of the stiffness, were it not stronger or weaker each
    time: g is drawn anew every so many seconds, Gaussian with unit variance, and changes linearly
    in between; its factor is never negative. A ``schedule`` takes the place of
    :math:`k^{-1}(k_0(t))`: the variable itself over time, as where a joint is moved slowly.
    Viscosity and reflex may follow the variable too. All else is as for :class:`Joint`.

    Truth: ``stiffness``, ``viscosity``, ``inertia``, and ``reflex_gain`` where there is a reflex.
    Pathways: ``intrinsic``, and ``reflex``. Channel: the variable, by its name.

    ``stiffness`` is k₀; ``relation`` k, a callable of the variable, to N·m/rad, which without a
    schedule rises from 0 to 1 and covers the profile there; ``viscosity_relation``, to N·m·s/rad,
    takes the place of ``viscosity``, and ``gain_relation`` gives the gain of the ``reflex`` in
    N·m·s/rad from the variable at the time of the stretch. ``variation`` σ is the standard
    deviation of the variable's strength relative to its mean; ``interval`` the seconds after which
    the strength is drawn anew; ``variable`` the name of the channel; ``noise_bandwidth`` the
    cut-off in Hz of the torque's noise.

    Raises
    ------
    InputError
        As for :class:`Joint`, and for a relation that is no callable or, without a schedule, does
        not rise or does not cover the profile.

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

    stiffness: Profile = attrs.field(factory=SineWave)
    viscosity: float | Profile = 2.2
    inertia: float = 0.02
    relation: Relation = attrs.field(factory=lambda: Polynomial([20.0, 200.0]))
    variation: float = 0.3
    interval: float = 2.0
    variable: str = "emg"
    schedule: Profile | None = None
    viscosity_relation: Relation | None = None
    gain_relation: Relation | None = None
    reflex: StretchReflex = attrs.field(factory=StretchReflex)
    noise_bandwidth: float = BANDWIDTH

    def __attrs_post_init__(self) -> None:
        super().__attrs_post_init__()
        for name in ("relation", "schedule", "viscosity_relation", "gain_relation"):
            value = getattr(self, name)
            if not callable(value) and (name == "relation" or value is not None):
                of = "time" if name == "schedule" else "the variable"
                raise InputError(
                    f"ScheduledJoint: {name} must be a callable of {of}, got {value!r}"
                )
        not_negative("ScheduledJoint", variation=self.variation)
        positive("ScheduledJoint", interval=self.interval, noise_bandwidth=self.noise_bandwidth)

    def _simulated(self, setup: Setup) -> Simulation:
        streams = setup.streams(3)
        impedance = self._impedance(setup, setup.index)
        factor = self._strength(setup.index / setup.rate, streams[2])
        if self.schedule is None:
            variable = self._usual(impedance["stiffness"]) * factor
        else:
            variable = (
                over_time("ScheduledJoint: schedule", self.schedule, setup.index, setup.rate)
                * factor
            )
        impedance["stiffness"] = self._related("relation", self.relation, variable)
        if self.viscosity_relation is not None:
            impedance["viscosity"] = self._related(
                "viscosity_relation", self.viscosity_relation, variable
            )
        found = answer(setup, impedance, streams, self.noise_bandwidth)
        pathways = {"intrinsic": found.torque}
        if self.gain_relation is not None:
            gain = impedance["reflex_gain"] = self._related(
                "gain_relation", self.gain_relation, variable
            )
            # Before the record the variable is as at its beginning; the gain is that at the time of
            # the stretch.
            late = np.pad(gain, (setup.run_in + round(self.reflex.delay * setup.rate), 0), "edge")[
                : len(found.velocity)
            ]
            torque = self.reflex.torque(found.velocity, late, setup.rate, int(setup.whole_index[0]))
            pathways["reflex"] = torque[setup.run_in :]
        return setup.simulation(
            found.angle, found.noise, pathways, impedance, {self.variable: variable}
        )

    def _related(self, name: str, relation: Relation, variable: Array) -> Array:
        """What a relation gives for each value of the variable."""
        values = np.asarray(relation(variable), dtype=np.float64)
        if values.shape != variable.shape or not np.isfinite(values).all():
            raise InputError(
                f"ScheduledJoint: {name} must give one finite number for each value, got "
                f"{relation!r}"
            )
        return values

    def _usual(self, stiffness: Array) -> Array:
        """Variable that gives a stiffness."""
        grid = np.linspace(0.0, 1.0, 10_001)
        values = np.asarray(self.relation(grid), dtype=np.float64)
        if values.shape != grid.shape or not np.all(np.diff(values) > 0):
            raise InputError(
                "ScheduledJoint: relation must rise from 0 to 1, one number for each, got "
                f"{self.relation!r}"
            )
        if not (values[0] <= stiffness.min() and stiffness.max() <= values[-1]):
            raise InputError(
                f"ScheduledJoint: stiffness goes from {stiffness.min():g} to {stiffness.max():g} "
                "N·m/rad, but relation "
                f"gives {values[0]:g} to {values[-1]:g} N·m/rad from 0 to 1; change one of them"
            )
        return np.interp(stiffness, values, grid)

    def _strength(self, time: Array, random: np.random.Generator) -> Array:
        """Factor on the variable over time; it is 1 on average."""
        knots = np.arange(time[0], time[-1] + self.interval, self.interval)
        factor = np.interp(time, knots, 1 + self.variation * random.standard_normal(len(knots)))
        return np.maximum(factor, 0.0)
