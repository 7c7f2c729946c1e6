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
)
from tvsysid.simulate.conditions import RMS_ANGLE
from tvsysid.simulate.simulation import System
from tvsysid.validators import optional, positive, settings_of, with_settings

SIMULATED_HZ = 1000.0
STEP_SHARE = 0.25  # of a constant stiffness, that a step goes to either side of it
NEGATIVE = (
    "the pilot's stiffness is negative: is the torque's sign reversed? (--torque-sign -1, in "
    "Python torque_sign=-1)"
)


class Simulated(NamedTuple):
    """Realizations, means not subtracted, and their true stiffness, shape (realization, time)."""

    ensemble: Ensemble
    stiffness: Array


@attrs.frozen(eq=False, repr=False)
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
        return np.asarray(irfft(white * np.sqrt(density * rate / 2), size)[:samples])

    def __repr__(self) -> str:
        return "the pilot's perturbation"


# Voluntary torque is slow: its power falls with frequency.
PINK = Spectrum(frequencies := np.geomspace(0.5, 500.0, 200), 1 / frequencies)


@attrs.frozen(eq=False, repr=False)
class Sampled:
    """Profile of these ``values`` at the ``rate`` in Hz, repeated, linear between samples."""

    values: Array
    rate: float

    @property
    def period(self) -> float:
        """Period in s."""
        return len(self.values) / self.rate

    def __call__(self, time: Array) -> Array:
        """Return the value at each time in s."""
        own = np.arange(len(self.values)) / self.rate
        return np.interp(time, own, self.values, period=self.period)


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

        The noise is the torque that the model does not explain. Noise and angle get the mean
        spectra of the realizations. A reflex that is detected is simulated with the muscle of
        :class:`tvsysid.simulate.StretchReflex`.

        Raises
        ------
        InputError
            For fewer than four realizations, or a stiffness that is negative in the mean.
        """
        check_ensemble("plan", ensemble)
        centred = ensemble if ensemble.mean_subtracted else subtract_mean(ensemble)
        with without_quality_warnings():  # a diagnosis says it better
            model = AdaptiveRegression().identify(centred)
        if np.mean(model.stiffness) < 0:
            raise InputError(NEGATIVE)
        rate = ensemble.sampling_rate
        over_time: dict[str, Any] = {
            name: Sampled(model.estimates[name].values, rate)
            for name in ("stiffness", "viscosity", "reflex_gain")
            if name in model.estimates
        }
        kind = ReflexJoint if "reflex_gain" in over_time else Joint
        residual = centred.torque[:, centred.core] - model.predict(centred)
        return cls(
            kind(inertia=float(np.mean(model.inertia)), **over_time),
            None,
            noise=unbiased_std(residual),
            period=ensemble.duration,
            rate=rate,
            noise_spectrum=Spectrum.of(residual, rate),
            context=ensemble.context / rate,
            pilot=centred,
        ).as_recorded()

    def as_recorded(self) -> Protocol:
        """Return the same with the perturbation and the amplitude of the pilot."""
        if self.pilot is None:
            return self
        angle = self.pilot.angle
        spectrum = Spectrum.of(angle, self.rate)
        return attrs.evolve(self, perturbation=spectrum, amplitude=unbiased_std(angle))

    @property
    def sizes(self) -> tuple[int, ...]:
        """Numbers of realizations to simulate. A pilot does not tell about many more.

        With fewer than eight realizations, methods cannot detect a reflex.
        """
        return (10, 40, 160) if self.pilot is None else (10, 80)

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

    @property
    def stiffness_over_time(self) -> Array:
        """Stiffness over a realization in N·m/rad; NaN if the system has no such setting."""
        profile = settings_of(self._parts[0]).get("stiffness")
        time = np.arange(0, self.period, 1 / self.rate)
        return np.asarray(profile(time) if profile else np.full_like(time, math.nan))

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
        recording = decimate(made.recording, self.rate)
        # The angle is simulated at the usual amplitude: another is another ratio.
        gain = self.amplitude / RMS_ANGLE
        level = self.noise or float(np.std(recording.torque)) * 10 ** (-self.snr_db / 20)
        noise = self.noise_spectrum.generate(
            len(recording), self.rate, np.random.default_rng([seed, 1])
        )
        recording = attrs.evolve(
            recording,
            angle=gain * recording.angle,
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


def unbiased_std(values: Array) -> float:
    """Return the standard deviation of (realization, time) whose mean over realizations is 0."""
    return float(np.std(values)) * math.sqrt(len(values) / (len(values) - 1))
