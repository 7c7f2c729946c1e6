"""A joint with time-varying impedance, perturbed in angle: what is recorded, and the truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import bessel, butter, lfilter

from tvsysid.errors import InputError
from tvsysid.signals import Recording, checked_rate

Array = NDArray[np.float64]
Profile = Callable[[Array], Array]

RMS_ANGLE = math.radians(0.5)
BANDWIDTH = 40.0
"""Cut-off in Hz of the actuator's (Bessel) filter and of the measurement noise's (Butterworth)."""
MARGIN = 1.0
"""Seconds recorded before time 0 and after the duration, so that every realization has context."""
RUN_IN = 1.0
"""Seconds simulated before that and thrown away, so that the filters' start from rest is forgotten."""
BLOCK = 16384


class Perturbation(Protocol):
    """Anything that generates an angle, up to its scale."""

    def generate(self, samples: int, rate: float, random: np.random.Generator) -> Array:
        """Samples at the rate in Hz, shape (samples,)."""
        ...  # pragma: no cover


@dataclass(frozen=True, eq=False, repr=False)
class Simulation:
    """A simulated recording and the truth about it, sample by sample.

    Parameters
    ----------
    recording
        Angle and noisy torque; begins 1 s before time 0 and ends 1 s after the duration.
    noiseless_torque
        In N·m, shape (time,).
    stiffness, viscosity
        In N·m/rad and N·m·s/rad, shape (time,).
    inertia
        In kg·m².
    """

    recording: Recording
    noiseless_torque: Array
    stiffness: Array
    viscosity: Array
    inertia: float

    @property
    def noiseless(self) -> Recording:
        """The same recording with the noiseless torque."""
        recording = self.recording
        return Recording(recording.angle, self.noiseless_torque, recording.sampling_rate, recording.start)

    def __repr__(self) -> str:
        low, high = float(self.stiffness.min()), float(self.stiffness.max())
        return f"Simulation({self.recording!r}; stiffness {low:g} to {high:g} N·m/rad, inertia {self.inertia:g} kg·m²)"


def joint(
    duration: float,
    *,
    stiffness: Profile,
    perturbation: Perturbation,
    snr_db: float,
    seed: int | np.random.Generator | np.random.SeedSequence,
    inertia: float = 0.02,
    viscosity: float | Profile = 2.2,
    rate: float = 1000.0,
) -> Simulation:
    r"""Simulate a joint whose torque answers an imposed angle.

    .. math:: y(t) = I\,\ddot\theta(t) + b(t)\,\dot\theta(t) + k(t)\,\theta(t) + n(t)

    The perturbation passes a 40-Hz second-order Bessel filter (the actuator), whose states are angle and velocity and
    give the acceleration, so that nothing is differenced. The angle is scaled to an RMS of 0.5 degrees. The noise is
    white noise through a 40-Hz second-order Butterworth filter, scaled so that noiseless torque and noise have the
    ratio of variances asked for. Both scales are those of the samples from time 0 to the duration.

    Parameters
    ----------
    duration
        In s, counted from time 0. The recording has one second more on both sides.
    stiffness
        Callable of time in s, to N·m/rad; one with an attribute ``period`` (in s) is evaluated over one period.
    perturbation
        :class:`FilteredNoise`, :class:`PRBS`, or anything with their ``generate``.
    snr_db
        Ratio of the variances of noiseless torque and noise in dB; ``inf`` for no noise.
    seed
        Integer, SeedSequence or generator; the same one gives the same numbers. Perturbation and noise have streams of
        their own.
    inertia
        In kg·m².
    viscosity
        In N·m·s/rad, or a callable as for the stiffness.
    rate
        Sampling rate in Hz, above twice the 40 Hz of the filters.

    Returns
    -------
    Simulation
        The recording and the truth.

    Raises
    ------
    InputError
        For a duration, rate or inertia that is not positive, or a profile that does not give one finite number for each
        time.

    References
    ----------
    van de Ruit et al. 2021, section 3.1.

    Examples
    --------
    >>> import tvsysid as tv
    >>> tv.simulate.joint(40, stiffness=tv.simulate.SquareWave(), perturbation=tv.simulate.PRBS(),
    ...                   snr_db=10, seed=1)
    Simulation(Recording(42 s at 1000 Hz; ...); stiffness 50 to 150 N·m/rad, inertia 0.02 kg·m²)
    """
    rate = checked_rate(rate)
    _check_settings(rate, stiffness, perturbation, duration=duration, inertia=inertia, snr_db=snr_db)
    run_in, margin, inside = (round(seconds * rate) for seconds in (RUN_IN, MARGIN, duration))
    samples = inside + 2 * margin
    try:
        if isinstance(seed, np.random.SeedSequence):
            # Spawning counts in the sequence: with a copy, the same one gives the same numbers again.
            seed = np.random.SeedSequence(seed.entropy, spawn_key=seed.spawn_key, pool_size=seed.pool_size)
        random, noise_random = np.random.default_rng(seed).spawn(2)
    except (TypeError, ValueError) as error:
        raise InputError(f"joint: seed must be a whole number of zero or more, got {seed!r}") from error

    drive = np.asarray(perturbation.generate(run_in + samples, rate, random))
    angle, torque, noise = np.empty(samples), np.empty(samples), np.empty(samples)
    time_index = np.arange(-margin, -margin + samples)
    k = _profile("stiffness", stiffness, time_index, rate)
    if callable(viscosity):
        b = _profile("viscosity", viscosity, time_index, rate)
    elif isinstance(viscosity, (int, float, np.number)) and math.isfinite(viscosity):
        b = np.broadcast_to(np.float64(viscosity), samples)
    else:
        raise InputError(f"joint: viscosity must be a finite number or a callable of time, got {viscosity!r}")

    noise_filter = butter(2, BANDWIDTH, fs=rate)
    actuator, noise_state = _Actuator(rate), np.zeros(2)
    actuator(drive[:run_in])
    _, noise_state = lfilter(*noise_filter, noise_random.standard_normal(run_in), zi=noise_state)
    # Blocks that stay in the cache: each sample is touched while it is there.
    for first in range(0, samples, BLOCK):
        block = slice(first, min(first + BLOCK, samples))
        position, velocity, acceleration = actuator(drive[run_in + block.start : run_in + block.stop])
        angle[block] = position
        velocity *= b[block]
        position *= k[block]
        acceleration *= inertia
        acceleration += velocity
        np.add(acceleration, position, out=torque[block])
        noise[block], noise_state = lfilter(
            *noise_filter, noise_random.standard_normal(block.stop - block.start), zi=noise_state
        )

    inner = slice(margin, margin + inside)
    size = float(np.dot(angle[inner], angle[inner]))
    if size == 0:
        raise InputError(f"joint: {perturbation!r} gave a signal without movement")
    scale = RMS_ANGLE / math.sqrt(size / inside)
    angle *= scale
    torque *= scale
    noise *= float(np.std(torque[inner]) / np.std(noise[inner])) * 10 ** (-snr_db / 20)
    noise += torque
    for values in (angle, noise, torque, k, b):
        values.flags.writeable = False
    recording = Recording(angle, noise, rate, start=-margin / rate)
    return Simulation(recording, torque, k, b, float(inertia))


def _check_settings(rate: float, stiffness: object, perturbation: object, **numbers: float) -> None:
    if rate <= 2 * BANDWIDTH:
        raise InputError(f"joint: rate must be above {2 * BANDWIDTH:g} Hz, got {rate:g} Hz")
    for name, value in numbers.items():
        if not isinstance(value, (int, float, np.number)):
            raise InputError(f"joint: {name} must be a number, got {value!r}")
        if name != "snr_db" and not (math.isfinite(value) and value > 0):
            raise InputError(f"joint: {name} must be positive, got {value!r}")
    if round(numbers["duration"] * rate) < 1:
        raise InputError(f"joint: a duration of {numbers['duration']:g} s is shorter than a sample at {rate:g} Hz")
    if not numbers["snr_db"] > -300:
        raise InputError(f"joint: snr_db must be a number of decibels above -300, got {numbers['snr_db']!r}")
    if not callable(getattr(perturbation, "generate", None)):
        raise InputError(f"joint: perturbation must be FilteredNoise, PRBS or have generate(), got {perturbation!r}")
    if not callable(stiffness):
        raise InputError(f"joint: stiffness must be a callable of time, such as Constant(100), got {stiffness!r}")


def _profile(name: str, profile: Profile, index: NDArray[np.int64], rate: float) -> Array:
    """Profile at the times index / rate; one period is computed and repeated where that is exact."""
    period = getattr(profile, "period", None)
    exact = 0.0 if period is None else float(period) * rate
    cycle = round(exact)
    repeats = 0 < cycle < len(index) and abs(exact - cycle) < 1e-9 * cycle
    needed = np.arange(cycle) if repeats else index
    values = np.asarray(profile(needed / rate), dtype=np.float64)
    if values.shape != needed.shape or not np.isfinite(values).all():
        raise InputError(
            f"joint: the {name} profile must give one finite number for each time; for {len(needed)} times it gave "
            f"values of shape {values.shape}{'' if np.isfinite(values).all() else ', some of them not finite'}"
        )
    if not repeats:
        return np.array(values)
    shift = int(index[0]) % cycle
    return np.resize(np.concatenate([values[shift:], values[:shift]]), len(index))


class _Actuator:
    """Second-order Bessel low-pass with its states, fed block after block."""

    def __init__(self, rate: float) -> None:
        self.position, self.velocity, self.denominator, self.stiffness, self.damping = _actuator_filter(rate)
        self.states = [np.zeros(2), np.zeros(2)]

    def __call__(self, drive: Array) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration, the drive being linear between samples."""
        position, self.states[0] = lfilter(self.position, self.denominator, drive, zi=self.states[0])
        velocity, self.states[1] = lfilter(self.velocity, self.denominator, drive, zi=self.states[1])
        acceleration = drive - position
        acceleration *= self.stiffness
        acceleration -= self.damping * velocity
        return position, velocity, acceleration


@cache
def _actuator_filter(rate: float) -> tuple[Array, Array, Array, float, float]:
    """Exact discretisation of x'' = w (drive - x) - d x' for a drive that is linear between samples.

    A drive held over each sample would lag half a sample behind the one in the acceleration's equation, and so add
    0.6 N·m·s/rad of viscosity at 1 kHz.
    """
    _, (_, damping, stiffness) = bessel(2, 2 * np.pi * BANDWIDTH, analog=True, norm="phase")
    system, entry = np.array([[0.0, 1.0], [-stiffness, -damping]]), np.array([0.0, stiffness])
    transition = expm(system / rate)
    held = np.linalg.solve(system, (transition - np.eye(2)) @ entry)
    late = np.linalg.solve(system, held * rate - entry)  # weight of the drive at the end of the step
    early = held - late
    # (zI - A)^-1 (late z + early); the adjugate of zI - A is [[z - a11, a01], [a10, z - a00]].
    (a00, a01), (a10, a11) = transition
    denominator = np.array([1.0, -(a00 + a11), a00 * a11 - a01 * a10])
    position = np.array([late[0], early[0] - a11 * late[0] + a01 * late[1], a01 * early[1] - a11 * early[0]])
    velocity = np.array([late[1], early[1] - a00 * late[1] + a10 * late[0], a10 * early[0] - a00 * early[1]])
    return position, velocity, denominator, float(stiffness), float(damping)
