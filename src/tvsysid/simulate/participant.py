"""A virtual participant: the paper's experiment on a simulated person, with the truth that no experiment tells."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy.signal import bilinear, butter, lfilter

from tvsysid.errors import InputError
from tvsysid.signals import Recording
from tvsysid.simulate.actuator import Actuator
from tvsysid.simulate.perturbations import PRBS, FilteredNoise, Perturbation
from tvsysid.simulate.profiles import SineWave
from tvsysid.simulate.setup import BANDWIDTH, RMS_ANGLE

Array = NDArray[np.float64]

RATE = 1024.0
TRIALS = 10
TRIAL = 70.0
"""Duration of a trial in s."""
REST = 5.0
"""Seconds without perturbation at both ends of a trial; time 0 is where the perturbation begins."""
PERIOD = 2.0
LOWEST, HIGHEST = 0.05, 0.50
"""The target's range, as shares of the maximal voluntary torque."""
FLUCTUATION_BANDWIDTH = 3.0
"""Cut-off in Hz of the fluctuations of voluntary torque."""
MEMORY = 0.9
"""How much of the drift in amplitude is left after a period."""
REFLEX_DELAY = 0.040
REFLEX_FREQUENCY = 15.6
"""Natural frequency of the reflex's muscle in rad/s."""
REFLEX_DAMPING = 0.62


@dataclass(frozen=True)
class Traits:
    """What makes one person differ from another.

    Parameters
    ----------
    maximal_torque
        Maximal voluntary torque in N·m.
    inertia
        Of foot and footplate together in kg·m².
    passive_stiffness
        In N·m/rad, without voluntary torque.
    stiffness_per_torque
        Rise of the stiffness with voluntary torque in 1/rad.
    damping_ratio
        Share of critical damping; the viscosity is 2 · damping ratio · √(stiffness · inertia).
    reflex_gain
        Torque per velocity of stretch in N·m·s/rad; 0 for no stretch reflex.
    delay
        By how much the voluntary torque follows the target on average, in s.
    delay_jitter
        Standard deviation of the delay from period to period, in s.
    amplitude_jitter, amplitude_drift
        Standard deviation of the amplitude from period to period, and of its slow drift, as shares of it.
    offset_jitter
        Standard deviation of the mean torque from period to period, as a share of the amplitude.
    fluctuation
        Standard deviation of the torque's fluctuations up to some 3 Hz, as a share of the torque.
    sensor_noise
        Standard deviation of the torque sensor's noise in N·m.
    late_noise, late_prbs
        Share of the periods in which the rhythm is lost, for either perturbation.
    weak, twitches
        Share of the periods in which the amplitude lapses, and in which the foot twitches.
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

    def __post_init__(self) -> None:
        positive = {"maximal_torque", "inertia", "passive_stiffness"}
        for field in fields(self):
            value = getattr(self, field.name)
            if not (isinstance(value, (int, float, np.number)) and math.isfinite(value) and value >= 0):
                raise InputError(f"Traits: {field.name} must be a number of zero or more, got {value!r}")
            if field.name in positive and value == 0:
                raise InputError(f"Traits: {field.name} must be positive, got {value!r}")

    @classmethod
    def of(cls, number: int) -> Traits:
        """Traits of the participant with this number; without a stretch reflex.

        Notes
        -----
        Stiffness rises by some 4 N·m/rad with each N·m, and the damping ratio does not depend on it, as is usually
        found at the ankle under small perturbations; with the target's range, that gives the 50 to 150 N·m/rad of
        the paper's simulations. The imperfections are set such that the paper's exclusions and VAFs come out.
        """
        random = _streams(number)[0]
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


@dataclass(frozen=True, eq=False, repr=False)
class Trials:
    """Recorded trials with one perturbation, and the truth about them, sample by sample.

    Parameters
    ----------
    recording
        Ten trials, each from 5 s before its perturbation begins to 5 s after it ends; channel ``target`` is the torque
        to be followed in N·m.
    stiffness, viscosity
        In N·m/rad and N·m·s/rad, shape (time,).
    voluntary_torque, reflex_torque
        Parts of the torque that are no answer of the joint's impedance, in N·m, shape (time,).
    """

    recording: Recording
    stiffness: Array
    viscosity: Array
    voluntary_torque: Array
    reflex_torque: Array

    @property
    def revealed(self) -> Recording:
        """The recording with the truth as further channels, which pass through preprocessing as the torque does."""
        recording = self.recording
        truth = {name: getattr(self, name) for name in ("stiffness", "viscosity", "voluntary_torque", "reflex_torque")}
        return Recording(
            recording.angle,
            recording.torque,
            recording.sampling_rate,
            recording.start,
            {**recording.channels, **truth},
            recording.trial_starts,
        )

    def __repr__(self) -> str:
        low, high = float(self.stiffness.min()), float(self.stiffness.max())
        return f"Trials({self.recording!r}; stiffness {low:.0f} to {high:.0f} N·m/rad)"


@dataclass(frozen=True, eq=False)
class Participant:
    """One virtual person's experiment.

    Parameters
    ----------
    traits
        What the person is like.
    noise, prbs
        The trials with either perturbation.
    """

    traits: Traits
    noise: Trials
    prbs: Trials


def participant(number: int, traits: Traits | None = None) -> Participant:
    r"""Twenty trials of 70 s in which a virtual person follows a target torque while the ankle is perturbed.

    .. math:: y(t) = I\,\ddot\theta(t) + b(t)\,\dot\theta(t) + k(t)\,\theta(t) + v(t) + r(t) + n(t), \qquad
              k(t) = k_0 + s\,v(t), \quad b(t) = 2 \zeta \sqrt{k(t)\, I}

    The voluntary torque v follows a 0.5-Hz sinusoid between 5 and 50 % of the maximal voluntary torque, as people do:
    late by a delay that varies, with an amplitude that drifts and jitters, with fluctuations in proportion to the
    torque, and at times not at all. Stiffness follows what the person does, not the target. The stretch reflex r, if
    any, is the delayed velocity of stretch through a half-wave rectifier and a second-order low-pass. Perturbations,
    actuator and their size (0.5 degrees RMS) are those of :class:`Joint`.

    Parameters
    ----------
    number
        Which person: 0 or more. The same number gives the same numbers.
    traits
        Instead of the person's own, for instance ``replace(Traits.of(1), reflex_gain=5.0)``.

    Returns
    -------
    Participant
        Ten trials with filtered noise and ten with a PRBS at 1024 Hz, and the truth.

    References
    ----------
    van de Ruit et al. 2021, section 4.1.3.

    Examples
    --------
    >>> import tvsysid as tv
    >>> tv.simulate.participant(1).prbs
    Trials(Recording(700 s in 10 trials at 1024 Hz; ...); stiffness ... N·m/rad)
    """
    _, noise, prbs = _streams(number)
    own = Traits.of(number) if traits is None else traits
    return Participant(
        traits=own,
        noise=_trials(own, FilteredNoise(), own.late_noise, noise),
        prbs=_trials(own, PRBS(), own.late_prbs, prbs),
    )


def _streams(number: int) -> list[np.random.Generator]:
    """Independent random numbers for the person's traits and for either perturbation's trials."""
    try:
        return np.random.default_rng(number).spawn(3)
    except (TypeError, ValueError) as error:
        raise InputError(f"participant: number must be a whole number of zero or more, got {number!r}") from error


def _trials(traits: Traits, perturbation: Perturbation, late: float, random: np.random.Generator) -> Trials:
    """All trials with one perturbation, one after the other in one array.

    The rests at both ends of a trial let actuator and reflex come to rest before the next one begins.
    """
    for_angle, for_person, for_sensor = random.spawn(3)
    samples, rest = round(TRIAL * RATE), round(REST * RATE)
    time = np.arange(samples) / RATE - REST
    target = _target(traits)(time)

    drive = np.zeros((TRIALS, samples))
    for trial in drive:
        trial[rest:-rest] = perturbation.generate(samples - 2 * rest, RATE, for_angle)
    angle, velocity, acceleration = Actuator(RATE)(drive.ravel())
    # Not by BLAS, whose last bits depend on the number of threads.
    scale = RMS_ANGLE / math.sqrt(float(np.sum(np.square(angle))) / (TRIALS * (samples - 2 * rest)))
    angle, velocity, acceleration = scale * angle, scale * velocity, scale * acceleration

    voluntary = np.concatenate([_voluntary_torque(traits, time, late, for_person) for _ in range(TRIALS)])
    stiffness = traits.passive_stiffness + traits.stiffness_per_torque * np.maximum(voluntary, 0.0)
    viscosity = 2 * traits.damping_ratio * np.sqrt(stiffness * traits.inertia)
    reflex = _reflex_torque(traits.reflex_gain, velocity)
    noise = traits.sensor_noise * _low_passed(BANDWIDTH, len(angle), for_sensor)
    torque = traits.inertia * acceleration + viscosity * velocity + stiffness * angle + voluntary + reflex + noise

    for values in (angle, torque, stiffness, viscosity, voluntary, reflex):
        values.flags.writeable = False
    recording = Recording(
        angle,
        torque,
        RATE,
        start=-REST,
        channels={"target": np.tile(target, TRIALS)},
        trial_starts=tuple(range(0, len(angle), samples)),
    )
    return Trials(recording, stiffness, viscosity, voluntary, reflex)


def _target(traits: Traits) -> SineWave:
    mean, amplitude = (HIGHEST + LOWEST) / 2, (HIGHEST - LOWEST) / 2
    return SineWave(mean * traits.maximal_torque, amplitude * traits.maximal_torque, PERIOD)


def _voluntary_torque(traits: Traits, time: Array, late: float, random: np.random.Generator) -> Array:
    """Voluntary torque in N·m over one trial, shape (time,).

    Delay, amplitude and mean are drawn for the middle of each period, and change linearly from one to the next.
    """
    target = _target(traits)
    middles = np.arange(time[0] - PERIOD / 2, time[-1] + PERIOD, PERIOD)
    count = len(middles)

    def happens(share: float) -> NDArray[np.bool_]:
        return np.asarray(random.random(count) < share)

    delay = traits.delay + traits.delay_jitter * random.standard_normal(count)
    delay += happens(late) * random.choice([-1.0, 1.0], count) * random.uniform(0.35, 0.7, count)
    innovation = math.sqrt(1 - MEMORY**2) * random.standard_normal(count)
    innovation[0] = random.standard_normal()
    drift = lfilter([1.0], [1.0, -MEMORY], innovation)
    amplitude = 1 + traits.amplitude_jitter * random.standard_normal(count) + traits.amplitude_drift * drift
    amplitude -= happens(traits.weak) * random.uniform(0.2, 0.6, count)
    offset = traits.offset_jitter * random.standard_normal(count)

    delay, amplitude, offset = (np.interp(time, middles, values) for values in (delay, amplitude, offset))
    torque = target.mean + target.amplitude * offset + amplitude * (target(time - delay) - target.mean)
    torque *= 1 + traits.fluctuation * _low_passed(FLUCTUATION_BANDWIDTH, len(time), random)
    for middle in middles[happens(traits.twitches)]:
        centre, width = middle + random.uniform(-PERIOD / 2, PERIOD / 2), random.uniform(0.05, 0.15)
        height = random.choice([-1.0, 1.0]) * random.uniform(0.2, 0.4) * target.amplitude
        torque += height * np.exp(-0.5 * np.square((time - centre) / width))
    return np.asarray(torque)


def _low_passed(bandwidth: float, samples: int, random: np.random.Generator) -> Array:
    """Gaussian noise of unit variance below a frequency in Hz (second-order Butterworth), shape (samples,)."""
    numerator, denominator = butter(2, bandwidth, fs=RATE)
    settling = round(RATE / bandwidth)
    noise = lfilter(numerator, denominator, random.standard_normal(settling + samples))[settling:]
    return np.asarray(noise / math.sqrt(_power_gain(bandwidth)))


def _power_gain(bandwidth: float) -> float:
    """Variance of white noise of unit variance after the low-pass."""
    impulse = np.zeros(round(4 * RATE / bandwidth))
    impulse[0] = 1.0
    response = lfilter(*butter(2, bandwidth, fs=RATE), impulse)
    return float(np.dot(response, response))


def _reflex_torque(gain: float, velocity: Array) -> Array:
    """Torque in N·m that answers the delayed velocity of stretch in rad/s, shape (time,)."""
    if gain == 0:
        return np.zeros_like(velocity)
    stretch = np.zeros_like(velocity)
    late = round(REFLEX_DELAY * RATE)
    stretch[late:] = np.maximum(velocity[:-late], 0.0)
    square = REFLEX_FREQUENCY**2
    muscle = bilinear([gain * square], [1.0, 2 * REFLEX_DAMPING * REFLEX_FREQUENCY, square], fs=RATE)
    return np.asarray(lfilter(*muscle, stretch))
