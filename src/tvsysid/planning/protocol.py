"""State what would be recorded: a joint and how it is perturbed, or more of a pilot recording."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, NamedTuple

import attrs
import numpy as np
import scipy
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from tvsysid.errors import InputError, without_quality_warnings
from tvsysid.methods import AdaptiveRegression, label_of, resolve
from tvsysid.metrics import random_error
from tvsysid.preprocess import decimate, segment, subtract_mean
from tvsysid.signals import Array, Ensemble, check_ensemble
from tvsysid.simulate import (
    PERTURBATIONS,
    PROFILES,
    SYSTEMS,
    Joint,
    Perturbation,
    Profile,
    ReflexJoint,
    SineWave,
    SquareWave,
    StretchReflex,
)
from tvsysid.simulate.actuator import drive_of
from tvsysid.simulate.conditions import RMS_ANGLE
from tvsysid.simulate.simulation import System
from tvsysid.validators import optional, positive, settings_of, with_settings

SIMULATED_HZ = 1000.0
FADE_SAMPLES = 10  # from one realization of a pilot to the next
STEP_SHARE = 0.25  # of a constant stiffness, that a step goes to either side of it
NEGATIVE = (
    "the pilot's stiffness is negative: is the torque's sign reversed? (--torque-sign -1, in "
    "Python torque_sign=-1)"
)


class Simulated(NamedTuple):
    """Realizations, means not subtracted, and their true stiffness, shape (realization, time)."""

    ensemble: Ensemble
    stiffness: Array


@attrs.frozen(eq=False)
class Spectrum:
    """Gaussian signal of a spectral density ``density`` at ``frequencies`` in Hz."""

    frequencies: Array
    density: Array

    @classmethod
    def of(cls, values: Array, rate: float) -> Spectrum:
        """Estimate the mean spectrum of the realizations (realization, time)."""
        found = scipy.signal.welch(values, rate, nperseg=values.shape[1], detrend=False)
        return cls(found[0], found[1].mean(axis=0))

    def generate(self, samples: int, rate: float, random: np.random.Generator) -> Array:
        """Return samples at the rate in Hz, shape (samples,)."""
        size = next_fast_len(samples, real=True)
        density = np.interp(rfftfreq(size, 1 / rate), self.frequencies, self.density, right=0.0)
        white = rfft(random.standard_normal(size))
        return irfft(white * np.sqrt(density * rate / 2), size)[:samples]


# Voluntary torque is slow: its power falls with frequency.
PINK = Spectrum(frequencies := np.geomspace(0.5, 500.0, 200), 1 / frequencies)


@attrs.frozen(eq=False)
class Sampled:
    """Profile or angle of these ``values`` at the ``rate`` in Hz, repeated without end."""

    values: Array
    rate: float

    @classmethod
    def angle_of(cls, ensemble: Ensemble) -> Sampled:
        """Join the realizations in their order, means subtracted, at the recorded rate.

        Each fades into the next, which changes nothing where the two follow each other.
        """
        recorded = ensemble.angle_as_recorded
        ratio = recorded.shape[-1]
        angle = (recorded - recorded.mean(axis=0)).reshape(len(recorded), -1)
        joined, later = np.split(angle, [ensemble.samples * ratio], axis=1)
        later = np.roll(later[:, : FADE_SAMPLES * ratio], 1, axis=0)
        start = joined[:, : later.shape[1]]
        start += np.linspace(1, 0, later.shape[1]) * (later - start)
        return cls(joined.ravel(), ensemble.sampling_rate * ratio)

    def __call__(self, time: Array) -> Array:
        """Return the value at each time in s, linear between samples."""
        count = len(self.values)
        return np.interp(time * self.rate, np.arange(count), self.values, period=count)

    def generate(self, samples: int, rate: float, random: np.random.Generator) -> Array:
        """Return what gives this angle, from a random time on, after the actuator's filter."""
        start = random.integers(len(self.values)) / self.rate
        return drive_of(self(start + np.arange(samples) / rate), rate)


@attrs.frozen(eq=False)
class Protocol:
    """A joint, and how it would be recorded. ``Protocol.of`` finds both in a pilot recording.

    ``attrs.evolve(protocol, amplitude=0.02, perturbation="prbs")`` is the same joint with another
    perturbation.

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
        the noise leaves ``snr_db`` at an amplitude of 0.5 degrees.
    snr_db
        Signal-to-noise ratio of the torque in dB at the rate below, where no noise is given.
    period, rate
        Duration of a realization in s, and rate in Hz to which signals are decimated.
    noise_spectrum
        Spectrum of the noise. By default, its power is inversely proportional to frequency, as that
        of voluntary torque. White noise of the same RMS needs fewer realizations.
    context
        Context beside each realization in s.
    pilot
        Ensemble, means subtracted, that the protocol was found in.

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
    noise_spectrum: Spectrum = attrs.field(default=PINK, kw_only=True)
    context: float = attrs.field(default=0.5, kw_only=True)
    pilot: Ensemble | None = attrs.field(default=None, kw_only=True)

    def __attrs_post_init__(self) -> None:
        self._parts  # noqa: B018  # raises for unknown names

    @classmethod
    def of(cls, ensemble: Ensemble) -> Protocol:
        """Identify a pilot's ensemble by ``adaptive``, to simulate more of the same.

        The noise has the spectrum of the torque that the model does not explain. The perturbation
        is the pilot's angle. A reflex that is detected is simulated.

        Raises
        ------
        InputError
            For fewer than four realizations, or a stiffness that is negative in the mean.
        """
        check_ensemble("plan", ensemble)
        centred = subtract_mean(ensemble)
        with without_quality_warnings():  # a diagnosis says it better
            model: Any = AdaptiveRegression().identify(centred)
        if np.mean(model.stiffness) < 0:
            raise InputError(NEGATIVE)
        rate = ensemble.sampling_rate
        over_time: dict[str, Any] = {
            name: Sampled(model.estimates[name].values, rate)
            for name in ("stiffness", "viscosity", "reflex_gain")
            if name in model.estimates
        }
        kind: type[Joint] = Joint
        if model.reflex is not None:
            kind, details = ReflexJoint, model.reflex.diagnostics.details
            shape = {name: details[name] for name in settings_of(StretchReflex())}
            # Joints are simulated at the usual amplitude.
            shape["threshold"] *= RMS_ANGLE / scatter(centred.angle)
            over_time["reflex"] = StretchReflex(**shape)
        residual = centred.torque[:, centred.core] - model.predict(centred)
        return cls(
            kind(inertia=float(np.mean(model.inertia)), **over_time),
            None,
            noise=scatter(residual),
            period=ensemble.duration,
            rate=rate,
            noise_spectrum=Spectrum.of(residual, rate),
            context=ensemble.context / rate,
        ).like(centred)

    def like(self, pilot: Ensemble) -> Protocol:
        """Return the same joint with the perturbation and the amplitude of a pilot."""
        return attrs.evolve(
            self,
            perturbation=Sampled.angle_of(pilot),
            amplitude=scatter(pilot.angle),
            pilot=pilot,
        )

    @property
    def sizes(self) -> tuple[int, ...]:
        """Numbers of realizations to simulate. A pilot does not tell about many more.

        Methods may not detect a reflex in fewer than 20 realizations.
        """
        return (10, 40, 160) if self.pilot is None else (20, 80)

    def __str__(self) -> str:
        name = f"the {label_of(self.perturbation)} perturbation"
        if isinstance(self.perturbation, Sampled):
            name = "the pilot's perturbation"
        return f"{name} at {self.amplitude:.2g} rad RMS"

    @cached_property
    def _parts(self) -> tuple[System, Perturbation]:
        """System with its stiffness, and perturbation."""
        system = resolve(self.system, SYSTEMS, "system")
        if self.stiffness is not None and "stiffness" in settings_of(system):
            profile = resolve(self.stiffness, PROFILES, "profile")
            if isinstance(profile, SineWave | SquareWave):
                offset = profile.offset * self.period / profile.period
                profile = attrs.evolve(profile, period=self.period, offset=offset)
            system = with_settings(system, stiffness=profile)
        return system, resolve(self.perturbation, PERTURBATIONS, "perturbation")

    @property
    def stiffness_over_time(self) -> Array:
        """Stiffness over a realization in N·m/rad; NaN if the system has no such setting."""
        profile = settings_of(self._parts[0]).get("stiffness")
        time = np.arange(0, self.period, 1 / self.rate)
        return profile(time) if profile else np.full_like(time, math.nan)

    def simulated(self, count: int, seed: int) -> Simulated:
        """Return ``count`` realizations. The same seed gives the same."""
        system, perturbation = self._parts
        made = system.simulate(
            count * self.period,
            perturbation=perturbation,
            snr_db=math.inf,
            seed=seed,
            rate=self.rate * math.ceil(SIMULATED_HZ / self.rate),
        )
        # The angle is simulated at the usual amplitude: another is another ratio.
        gain = self.amplitude / RMS_ANGLE
        recording = attrs.evolve(made.recording, angle=gain * made.recording.angle)
        recording = decimate(recording, self.rate)
        level = self.noise or float(np.std(recording.torque)) * 10 ** (-self.snr_db / 20)
        noise = self.noise_spectrum.generate(
            len(recording), self.rate, np.random.default_rng([seed, 1])
        )
        recording = attrs.evolve(
            recording,
            torque=gain * recording.torque + level * noise / np.std(noise),
        )
        ensemble = segment(recording, self.period, self.context)
        return Simulated(ensemble, made.truth_of(ensemble)["stiffness"])

    def stepped(self) -> Protocol | None:
        """Return the same with a stiffness that steps, or None if the system has none.

        It steps between the extremes of the stiffness, and about one that hardly changes.
        """
        over_time = self.stiffness_over_time
        if np.isnan(over_time).any():
            return None
        low, high = float(over_time.min()), float(over_time.max())
        reach = max(high - low, 2 * STEP_SHARE * abs(float(over_time.mean()))) / 2
        ends = (low + high) / 2 - reach, (low + high) / 2 + reach
        return attrs.evolve(self, stiffness=SquareWave(*ends, self.period, self.period / 4))

    def seconds(self, count: float) -> float:
        """Return the seconds to record for ``count`` realizations with context at both ends."""
        return (count + 2 * math.ceil(round(self.context / self.period, 6))) * self.period


def scatter(estimates: Array) -> float:
    """Return the random error of estimates (estimate, time), without the bias of a few."""
    count = len(estimates)
    return (
        float(random_error(estimates)) * math.sqrt(count / (count - 1)) if count > 1 else math.nan
    )
