"""State what would be recorded: a joint and a protocol, or more of a pilot recording."""

from __future__ import annotations

import math
import warnings
from functools import cached_property
from typing import NamedTuple

import attrs
import numpy as np
import scipy
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from tvsysid.errors import DataQualityWarning
from tvsysid.methods import AdaptiveRegression, label_of, resolve
from tvsysid.numerics.differentiation import HALF_WIDTH, differentiate
from tvsysid.preprocess import decimate, segment, subtract_mean
from tvsysid.signals import Array, Ensemble, Recording
from tvsysid.simulate import (
    PERTURBATIONS,
    PROFILES,
    SYSTEMS,
    Constant,
    Joint,
    Perturbation,
    Profile,
    SineWave,
    SquareWave,
)
from tvsysid.simulate.conditions import RMS_ANGLE
from tvsysid.simulate.simulation import Simulation, System
from tvsysid.validators import optional, positive, settings_of, with_settings

SIMULATED_HZ = 1000.0
PROBE_S = 40.0  # that are simulated to measure the noise
STEP_SHARE = 0.25  # of a constant stiffness, that a step goes to either side of it


REFLEX = (
    "a reflex is found, which is not simulated: methods of one pathway include its torque in the "
    "stiffness, and the plan does not count that bias"
)
NEGATIVE = (
    "the pilot's stiffness is negative: is the torque's sign reversed? (--torque-sign -1, in "
    "Python torque_sign=-1)"
)


class Simulated(NamedTuple):
    """Realizations, means not subtracted, and their true stiffness, shape (realization, time)."""

    ensemble: Ensemble
    stiffness: Array


@attrs.frozen
class Protocol:
    """A stated joint, and how it would be recorded.

    Parameters
    ----------
    system, stiffness, perturbation
        Names as in a study (``"joint"``, ``"sine"``, ``"prbs:switch_interval=0.2"``,
        ``"module:Object"``) or objects. A wave is stretched to the period. With None, the system
        keeps its own stiffness, as do systems that take none.
    amplitude
        RMS of the angle in rad.
    noise
        RMS of the torque's noise in N·m at the rate below, whatever the amplitude. With None,
        the noise leaves ``snr_db`` at the usual amplitude of 0.5 degrees.
    snr_db
        Signal-to-noise ratio in dB, where no noise is given.
    period, rate
        Duration of a realization in s, and rate in Hz to which signals are decimated.

    Raises
    ------
    InputError
        For an unknown name, or a number that is not positive.
    """

    system: str | System = "joint"
    stiffness: str | Profile | None = "sine"
    perturbation: str | Perturbation = "noise"
    amplitude: float = attrs.field(default=RMS_ANGLE, validator=positive)
    noise: float | None = attrs.field(default=None, validator=optional(positive))
    snr_db: float = 10.0
    period: float = attrs.field(default=2.0, validator=positive)
    rate: float = attrs.field(default=100.0, validator=positive)

    context = 0.5  # s beside each realization
    most_simulated = 320  # realizations

    def __attrs_post_init__(self) -> None:
        self._parts  # noqa: B018  # raises for unknown names

    def __str__(self) -> str:
        return f"{label_of(self.perturbation)} of {self.amplitude:.2g} rad"

    @cached_property
    def _parts(self) -> tuple[System, Perturbation]:
        """System with its stiffness, and perturbation."""
        system = resolve(self.system, SYSTEMS, "system")
        if self.stiffness is not None and "stiffness" in settings_of(system):
            profile = resolve(self.stiffness, PROFILES, "profile")
            if isinstance(profile, (SineWave, SquareWave)):
                offset = profile.offset * self.period / profile.period
                profile = attrs.evolve(profile, period=self.period, offset=offset)
            system = with_settings(system, stiffness=profile)
        return system, resolve(self.perturbation, PERTURBATIONS, "perturbation")

    def _simulate(self, duration: float, snr_db: float, seed: int) -> Simulation:
        system, perturbation = self._parts
        rate = _fine_rate(self.rate)
        return system.simulate(
            duration, perturbation=perturbation, snr_db=snr_db, seed=seed, rate=rate
        )

    @cached_property
    def _snr_db(self) -> float:
        """Signal-to-noise ratio at the amplitude.

        Angle and torque are simulated at the usual amplitude: another is another ratio.
        """
        gain_db = 20 * math.log10(self.amplitude / RMS_ANGLE)
        if self.noise is None:
            return self.snr_db + gain_db
        probe = self._simulate(PROBE_S, 0.0, 0)
        noise = probe.recording.torque - probe.noiseless.torque
        noise = decimate(attrs.evolve(probe.recording, torque=noise), self.rate).torque
        return gain_db + 20 * math.log10(float(np.std(noise)) / self.noise)

    def simulated(self, count: int, seed: int) -> Simulated:
        """Return ``count`` realizations. The same seed gives the same."""
        made = self._simulate(count * self.period, self._snr_db, seed)
        ensemble = segment(decimate(made.recording, self.rate), self.period, self.context)
        return Simulated(ensemble, made.truth_of(ensemble)["stiffness"])

    def stepped(self) -> Protocol | None:
        """Return the same with a stiffness that steps, or None if the system has none."""
        profile = settings_of(self._parts[0]).get("stiffness")
        if profile is None:
            return None
        time = np.arange(0, self.period, 1 / self.rate)
        return attrs.evolve(self, stiffness=_step(profile(time), self.period))


@attrs.frozen(eq=False)
class Pilot:
    """Joint, noise and perturbation of a pilot recording, to simulate more of the same.

    Made by :meth:`of`. ``attrs.evolve(pilot, amplitude=0.02, perturbation="prbs")`` is the same
    joint with another perturbation.

    Parameters
    ----------
    stiffness, viscosity, inertia
        Of the joint; the first two over a realization, shape (time,).
    frequencies, movement, noise
        Spectral densities of the angle and of the torque's noise at frequencies in Hz.
    recorded
        Ensemble in which the methods' scatter is compared with the simulated one.
    amplitude
        RMS of the angle that is planned, in rad.
    perturbation
        Perturbation that is planned; None for the pilot's.
    """

    stiffness: Array
    viscosity: Array
    inertia: float
    frequencies: Array
    movement: Array
    noise: Array
    recorded: Ensemble
    amplitude: float = attrs.field(validator=positive)
    perturbation: str | Perturbation | None = None

    most_simulated = 80  # realizations; a pilot does not tell what more of them would show

    @classmethod
    def of(cls, ensemble: Ensemble) -> Pilot:
        """Identify a pilot's ensemble by ``adaptive``.

        The noise is the torque that the model leaves. Both spectra are means over realizations.

        Raises
        ------
        InputError
            For fewer than four realizations.

        Warns
        -----
        DataQualityWarning
            Of a reflex, which is not simulated, and of a negative stiffness.
        """
        recorded = ensemble
        if not ensemble.mean_subtracted:
            ensemble = subtract_mean(ensemble)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataQualityWarning)  # a diagnosis says it better
            model = AdaptiveRegression().identify(ensemble)
        if "reflex_gain" in model.estimates:
            warnings.warn(REFLEX, DataQualityWarning, stacklevel=2)
        if np.mean(model.stiffness) < 0:
            warnings.warn(NEGATIVE, DataQualityWarning, stacklevel=2)
        residual = ensemble.torque[:, ensemble.core] - model.predict(ensemble)
        # The mean over realizations took a part of the variance away.
        scale = len(ensemble) / (len(ensemble) - 1)
        frequencies, noise = _density(residual, ensemble.sampling_rate)
        movement = np.interp(frequencies, *_density(ensemble.angle, ensemble.sampling_rate))
        return cls(
            model.stiffness,
            model.viscosity,
            float(np.mean(model.inertia)),
            frequencies=frequencies,
            movement=movement * scale,
            noise=noise * scale,
            recorded=recorded,
            amplitude=math.sqrt(scale) * float(np.std(ensemble.angle)),
        )

    def __str__(self) -> str:
        is_own = self.perturbation is None
        name = "the pilot's perturbation" if is_own else label_of(self.perturbation)
        return f"{name} of {self.amplitude:.2g} rad"

    def described(self) -> str:
        """Return joint, perturbation and noise of the pilot in a line."""
        noise = _rms(self.noise, self.frequencies)
        return (
            f"stiffness {self.stiffness.min():.0f} to {self.stiffness.max():.0f} N·m/rad, "
            f"viscosity {self.viscosity.mean():.2g} N·m·s/rad, inertia {self.inertia:.2g} kg·m²; "
            f"{self}; noise of the torque {noise:.2g} N·m RMS"
        )

    @property
    def period(self) -> float:
        """Duration of a realization in s."""
        return self.recorded.duration

    @property
    def recorded_amplitude(self) -> float:
        """RMS of the pilot's angle in rad."""
        return _rms(self.movement, self.frequencies)

    @property
    def context(self) -> float:
        """Context beside each realization in s."""
        return self.recorded.context / self.recorded.sampling_rate

    def simulated(self, count: int, seed: int) -> Simulated:
        """Return ``count`` realizations of the pilot's joint, with Gaussian angle and noise."""
        rate, context = self.recorded.sampling_rate, self.recorded.context
        samples = count * len(self.stiffness) + 2 * (context + HALF_WIDTH)
        random = np.random.default_rng(seed)
        angle, velocity, acceleration = differentiate(self._angle(samples, rate, random), rate)
        phase = (np.arange(len(angle)) - context) % len(self.stiffness)
        torque = self.stiffness[phase] * angle + self.viscosity[phase] * velocity
        torque += self.inertia * acceleration + _gaussian(
            self.noise, self.frequencies, rate, len(torque), random
        )
        recording = Recording(angle, torque, rate, start=-self.context)
        ensemble = segment(recording, self.period, self.context)
        return Simulated(ensemble, np.tile(self.stiffness, (len(ensemble), 1)))

    def _angle(self, samples: int, rate: float, random: np.random.Generator) -> Array:
        if self.perturbation is None:
            angle = _gaussian(self.movement, self.frequencies, rate, samples, random)
            return angle * self.amplitude / self.recorded_amplitude
        made = Joint(stiffness=Constant()).simulate(
            samples / rate,
            perturbation=resolve(self.perturbation, PERTURBATIONS, "perturbation"),
            snr_db=math.inf,
            seed=random,
            rate=_fine_rate(rate),
        )
        return decimate(made.recording, rate).angle[:samples] * self.amplitude / RMS_ANGLE

    def stepped(self) -> Pilot:
        """Return the same with a stiffness that steps between the pilot's extremes."""
        return attrs.evolve(self, stiffness=_step(self.stiffness, self.period)(self.recorded.time))


Setup = Protocol | Pilot


def seconds_of(setup: Setup, count: float) -> float:
    """Return the seconds to record for ``count`` realizations with context at both ends."""
    lost = 2 * math.ceil(round(setup.context / setup.period, 6))
    return (count + lost) * setup.period


def _fine_rate(rate: float) -> float:
    """Return the lowest multiple of a rate that is no lower than that of simulations."""
    return rate * max(1, -(-SIMULATED_HZ // rate))


def _step(stiffness: Array, period: float) -> SquareWave:
    """Return a step between the extremes of the stiffness, and about one that hardly changes."""
    low, high, mean = float(stiffness.min()), float(stiffness.max()), float(stiffness.mean())
    middle, reach = (low + high) / 2, max(high - low, 2 * STEP_SHARE * abs(mean)) / 2
    return SquareWave(middle - reach, middle + reach, period, period / 4)


def _density(values: Array, rate: float) -> tuple[Array, Array]:
    """Return frequencies and spectral density of (realization, time), mean over realizations."""
    frequencies, power = scipy.signal.welch(values, rate, nperseg=values.shape[1], detrend=False)
    return frequencies, power.mean(axis=0)


def _rms(density: Array, frequencies: Array) -> float:
    """Return the root mean square of a signal with this spectral density."""
    return math.sqrt(float(np.trapezoid(density, frequencies)))


def _gaussian(
    density: Array, at: Array, rate: float, samples: int, random: np.random.Generator
) -> Array:
    """Return Gaussian noise of a spectral density."""
    size = next_fast_len(samples, real=True)
    gain = np.sqrt(np.interp(rfftfreq(size, 1 / rate), at, density) * rate / 2)
    return np.asarray(irfft(rfft(random.standard_normal(size)) * gain, size)[:samples])
