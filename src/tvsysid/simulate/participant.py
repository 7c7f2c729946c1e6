"""Virtual participants: the paper's experiment on a simulated person, whose impedance is known."""

from __future__ import annotations

import math

import attrs
import numpy as np
import scipy
from numpy.typing import NDArray

from tvsysid.signals import Array, Recording
from tvsysid.simulate.actuator import BANDWIDTH, actuate
from tvsysid.simulate.conditions import RMS_ANGLE
from tvsysid.simulate.perturbations import (
    PERTURBATIONS,
    PRBS,
    Perturbation,
    low_passed_noise,
)
from tvsysid.simulate.profiles import SineWave
from tvsysid.simulate.reflex import StretchReflex
from tvsysid.simulate.simulation import Simulation
from tvsysid.validators import at_least

RATE_HZ = 1024.0
TRIALS, TRIAL_S = 10, 70.0
REST_S = 5.0  # without perturbation at both ends of a trial; time 0 is where it begins
PERIOD_S = 2.0
MIN_TARGET, MAX_TARGET = 0.05, 0.50  # shares of the maximal voluntary torque
FLUCTUATION_BANDWIDTH = 3.0  # Hz, of the voluntary torque
DRIFT_CORRELATION = 0.9  # of the amplitude's drift, from period to period


@attrs.frozen
class Traits:
    """Traits of one person.

    Parameters
    ----------
    maximal_torque
        Maximal voluntary torque in N·m.
    inertia
        Inertia of foot and footplate together in kg·m².
    passive_stiffness, stiffness_per_torque
        Stiffness without voluntary torque in N·m/rad, and its rise with that torque in 1/rad.
    damping_ratio
        Ratio to the critical viscosity, 2 √(stiffness · inertia).
    reflex_gain
        Torque per velocity of stretch in N·m·s/rad; 0 for no stretch reflex.
    delay, delay_jitter
        Mean delay of the voluntary torque behind the target, and its standard deviation from period
        to period, in s.
    amplitude_jitter, amplitude_drift
        Standard deviations of the amplitude from period to period and of its slow drift, as shares
        of it.
    offset_jitter
        Standard deviation of the mean torque from period to period, as a share of the amplitude.
    fluctuation
        Standard deviation of the torque's fluctuations up to some 3 Hz, as a share of the torque.
    sensor_noise
        Standard deviation in N·m.
    late_noise, late_prbs
        Shares of periods in which the rhythm is lost: under noise, and under a PRBS.
    weak, twitches
        Shares of periods in which the amplitude lapses, and in which the foot twitches.
    """

    maximal_torque: float
    inertia: float
    passive_stiffness: float
    stiffness_per_torque: float
    damping_ratio: float
    reflex_gain: float
    delay: float
    delay_jitter: float
    amplitude_jitter: float
    amplitude_drift: float
    offset_jitter: float
    fluctuation: float
    sensor_noise: float
    late_noise: float
    late_prbs: float
    weak: float
    twitches: float

    @classmethod
    def of(cls, number: int) -> Traits:
        """Return the traits of a participant by number; without a stretch reflex.

        Notes
        -----
        Stiffness rises by some 4 N·m/rad with each N·m, and the damping ratio does not depend on
        it, as is usual at the ankle under small perturbations. This gives the 50 to 150 N·m/rad of
        the paper's simulations. The imperfections give exclusions and VAFs like the paper's.
        """
        random = _generators(number)[0]
        clumsiness = math.exp(0.15 * random.standard_normal())
        lapsing = random.uniform(0.4, 1.6)
        return cls(
            maximal_torque=random.uniform(48, 66),
            inertia=random.uniform(0.052, 0.066),
            passive_stiffness=random.uniform(25, 45),
            stiffness_per_torque=random.uniform(3.3, 4.5),
            damping_ratio=random.uniform(0.35, 0.5),
            reflex_gain=0.0,
            delay=random.uniform(0.0, 0.1),
            delay_jitter=0.03 * clumsiness,
            amplitude_jitter=0.025 * clumsiness,
            amplitude_drift=0.02 * clumsiness,
            offset_jitter=0.016 * clumsiness,
            fluctuation=0.058 * clumsiness,
            sensor_noise=0.15,
            late_noise=0.005 * lapsing,
            late_prbs=0.04 * lapsing,
            weak=0.024 * lapsing,
            twitches=0.05 * lapsing,
        )


def _generators(number: int) -> list[np.random.Generator]:
    """Return random generators for the traits, and for noise and PRBS as the perturbation."""
    at_least(0).check("Participant", "number", number)
    return np.random.default_rng(number).spawn(3)


@attrs.frozen
class Participant:
    r"""Virtual person who follows a target torque while the ankle is perturbed.

    .. math:: y(t) = I\,\ddot\theta(t) + b(t)\,\dot\theta(t) + k(t)\,\theta(t) + r(t) + v(t) + n(t),
              \qquad k(t) = k_0 + s\,v(t), \quad b(t) = 2 \zeta \sqrt{k(t)\, I}

    The voluntary torque v follows a 0.5-Hz sinusoid between 5 and 50 % of the maximal voluntary
    torque, as people do. It is late by a delay that varies, with an amplitude that drifts and
    jitters and with fluctuations in proportion to the torque. At times the person loses the rhythm.
    Stiffness follows the person's torque, not the target. The stretch reflex r, if any, is that of
    :class:`ReflexJoint`; actuator and size of the angle are those of :class:`Joint`.

    Truth: ``stiffness``, ``viscosity``, ``inertia``, ``reflex_gain``. Pathways: ``intrinsic``,
    ``reflex`` and ``voluntary``. Channel: ``target``, the target torque in N·m.

    Parameters
    ----------
    number
        Number of the person, 0 or more. The same number gives the same random numbers.
    traits
        Traits in place of the person's own, such as
        ``attrs.evolve(Traits.of(1), reflex_gain=5.0)``.

    References
    ----------
    van de Ruit et al. 2021, section 4.1.3.

    Examples
    --------
    >>> import tvsysid as tv
    >>> tv.simulate.Participant(1).simulate(perturbation=tv.simulate.PRBS())
    Simulation(Recording(700 s in 10 trials at 1024 Hz; ...); stiffness ...; pathways intrinsic,
    reflex, voluntary)
    """

    number: int
    traits: Traits = attrs.field()

    @traits.default
    def _own_traits(self) -> Traits:
        return Traits.of(self.number)

    def simulate(self, *, perturbation: Perturbation = PERTURBATIONS["noise"]) -> Simulation:
        """Record ten trials of 70 s at 1024 Hz, each with 5 s of rest at both ends.

        Time 0 is where the perturbation begins. The protocol and the person's noise are fixed. The
        trials follow each other; rests let actuator and reflex settle between them.

        The perturbation is :class:`FilteredNoise`, :class:`PRBS`, or anything with their
        ``generate``. A PRBS has random numbers of its own. Under it the person loses the rhythm
        more often (``late_prbs``) than under anything else (``late_noise``).
        """
        traits, prbs = self.traits, isinstance(perturbation, PRBS)
        for_angle, for_person, for_sensor = _generators(self.number)[2 if prbs else 1].spawn(3)
        samples, rest = round(TRIAL_S * RATE_HZ), round(REST_S * RATE_HZ)
        moved, time = samples - 2 * rest, np.arange(samples) / RATE_HZ - REST_S

        drive = np.zeros((TRIALS, samples))
        for trial in drive:
            trial[rest:-rest] = perturbation.generate(moved, RATE_HZ, for_angle)
        motion = actuate(drive.ravel(), RATE_HZ)
        # Not by BLAS, whose last bits depend on the number of threads.
        size = float(np.sum(np.square(motion[0]))) / (TRIALS * moved)
        angle, velocity, acceleration = RMS_ANGLE / math.sqrt(size) * motion

        late = traits.late_prbs if prbs else traits.late_noise
        voluntary = np.concatenate(
            [_voluntary_torque(traits, time, late, for_person) for _ in range(TRIALS)]
        )
        contraction = np.maximum(voluntary, 0.0)
        stiffness = traits.passive_stiffness + traits.stiffness_per_torque * contraction
        viscosity = 2 * traits.damping_ratio * np.sqrt(stiffness * traits.inertia)
        intrinsic = traits.inertia * acceleration + viscosity * velocity + stiffness * angle
        reflex = StretchReflex().torque(velocity, traits.reflex_gain, RATE_HZ)
        noise = traits.sensor_noise * _unit_noise(BANDWIDTH, len(angle), for_sensor)
        recording = Recording(
            angle,
            intrinsic + voluntary + reflex + noise,
            RATE_HZ,
            start=-REST_S,
            channels={"target": np.tile(_target(traits)(time), TRIALS)},
            trial_starts=tuple(range(0, len(angle), samples)),
        )
        truth = {
            "stiffness": stiffness,
            "viscosity": viscosity,
            "inertia": np.full(len(angle), traits.inertia),
            "reflex_gain": np.full(len(angle), traits.reflex_gain),
        }
        pathways = {"intrinsic": intrinsic, "reflex": reflex, "voluntary": voluntary}
        return Simulation(recording, truth, pathways)


def _target(traits: Traits) -> SineWave:
    mean, amplitude = (MAX_TARGET + MIN_TARGET) / 2, (MAX_TARGET - MIN_TARGET) / 2
    return SineWave(mean * traits.maximal_torque, amplitude * traits.maximal_torque, PERIOD_S)


def _voluntary_torque(
    traits: Traits, time: Array, late: float, random: np.random.Generator
) -> Array:
    """Return the voluntary torque in N·m over one trial, shape (time,).

    Delay, amplitude and mean are drawn for the middle of each period, and change linearly in
    between.
    """
    target = _target(traits)
    middles = np.arange(time[0] - PERIOD_S / 2, time[-1] + PERIOD_S, PERIOD_S)
    count = len(middles)

    def happens(share: float) -> NDArray[np.bool_]:
        return random.random(count) < share

    delay = traits.delay + traits.delay_jitter * random.standard_normal(count)
    delay += happens(late) * random.choice([-1.0, 1.0], count) * random.uniform(0.35, 0.7, count)
    innovation = math.sqrt(1 - DRIFT_CORRELATION**2) * random.standard_normal(count)
    innovation[0] = random.standard_normal()
    drift = scipy.signal.lfilter([1.0], [1.0, -DRIFT_CORRELATION], innovation)
    amplitude = (
        1 + traits.amplitude_jitter * random.standard_normal(count) + traits.amplitude_drift * drift
    )
    amplitude -= happens(traits.weak) * random.uniform(0.2, 0.6, count)
    offset = traits.offset_jitter * random.standard_normal(count)

    delay, amplitude, offset = (np.interp(time, middles, x) for x in (delay, amplitude, offset))
    torque = (
        target.mean + target.amplitude * offset + amplitude * (target(time - delay) - target.mean)
    )
    torque *= 1 + traits.fluctuation * _unit_noise(FLUCTUATION_BANDWIDTH, len(time), random)
    for middle in middles[happens(traits.twitches)]:
        centre = middle + random.uniform(-PERIOD_S / 2, PERIOD_S / 2)
        width = random.uniform(0.05, 0.15)
        height = random.choice([-1.0, 1.0]) * random.uniform(0.2, 0.4) * target.amplitude
        torque += height * np.exp(-0.5 * np.square((time - centre) / width))
    return torque


def _unit_noise(bandwidth: float, samples: int, random: np.random.Generator) -> Array:
    """Return low-passed noise of unit variance, shape (samples,)."""
    impulse = scipy.signal.unit_impulse(round(4 * RATE_HZ / bandwidth))
    response = scipy.signal.lfilter(*scipy.signal.butter(2, bandwidth, fs=RATE_HZ), impulse)
    run_in = round(RATE_HZ / bandwidth)
    noise = low_passed_noise(random, bandwidth, RATE_HZ, run_in + samples)[run_in:]
    return noise / math.sqrt(float(np.dot(response, response)))
