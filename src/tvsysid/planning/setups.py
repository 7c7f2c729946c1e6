"""What would be recorded: from a stated joint and protocol, or as in a pilot recording."""

from __future__ import annotations

import math
import warnings
from functools import cached_property
from typing import Any, NamedTuple

import attrs
import numpy as np
import scipy
from scipy.fft import irfft, next_fast_len, rfftfreq

from tvsysid.checked import checked_rate
from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.methods import AdaptiveRegression, KernelRegression, label_of, resolve
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
from tvsysid.simulate.simulation import Simulation, System, checked_simulation
from tvsysid.validators import settings_of, with_settings

SIMULATED_HZ = 1000.0
PROBE = 40.0  # s that are simulated to see how large the noise is
CONTEXT = 0.5  # s beside each realization
STEP = 0.25  # share of a constant stiffness to either side of it, between which a step is tried

REFLEX = (
    "a reflex is found, which is not simulated: methods of one pathway take it for stiffness, and "
    "the plan does not "
    "know of that bias"
)
NEGATIVE = (
    "the pilot's stiffness is negative: is the torque's sign reversed? (--torque-sign -1, "
    "in Python torque_sign=-1)"
)


class Simulated(NamedTuple):
    """Realizations, means not subtracted, and their true stiffness, (realization, time)."""

    ensemble: Ensemble
    stiffness: Array


@attrs.frozen
class Protocol:
    """A stated joint, and how it would be recorded.

    Parameters
    ----------
    system, stiffness, perturbation
        Names as in a study (``"joint"``, ``"sine"``, ``"prbs:switch_interval=0.2"``,
        ``"module:Object"``) or objects. A wave is stretched to the period; None leaves the system
        its own stiffness.
    amplitude
        RMS of the angle in rad.
    noise
        RMS of the torque's noise in N·m, at the rate below, whatever the amplitude. If None, what
        leaves ``snr_db`` at the usual amplitude of 0.5 degrees.
    period, rate
        Seconds of a realization, and Hz to which signals are decimated.

    Raises
    ------
    InputError
        For an unknown name, or a number that is not positive.
    """

    system: str | System = "joint"
    stiffness: str | Profile | None = "sine"
    perturbation: str | Perturbation = "noise"
    amplitude: float = RMS_ANGLE
    noise: float | None = None
    snr_db: float = 10.0
    period: float = 2.0
    rate: float = 100.0

    def __attrs_post_init__(self) -> None:
        checked_rate(self.rate)
        for name in ("amplitude", "period", *(["noise"] if self.noise is not None else [])):
            positive(name, getattr(self, name))
        self._parts  # noqa: B018  # raises for unknown names

    def __str__(self) -> str:
        return f"{label_of(self.perturbation)} of {self.amplitude:.2g} rad"

    @cached_property
    def _parts(self) -> tuple[Any, Perturbation]:
        system = resolve(self.system, SYSTEMS, "system")
        if self.stiffness is not None:
            profile = resolve(self.stiffness, PROFILES, "profile")
            if isinstance(profile, (SineWave, SquareWave)):
                stretch = self.period / profile.period
                profile = attrs.evolve(profile, period=self.period, offset=profile.offset * stretch)
            if "stiffness" not in settings_of(system):
                raise InputError(
                    f"stiffness: {label_of(self.system)} takes none; give None, and set it in the "
                    "system"
                )
            system = with_settings(system, stiffness=profile)
        return system, resolve(self.perturbation, PERTURBATIONS, "perturbation")

    def _made(self, duration: float, snr_db: float, seed: int) -> Simulation:
        system, perturbation = self._parts
        rate = self.rate * max(1, -(-SIMULATED_HZ // self.rate))
        made = system.simulate(
            duration, perturbation=perturbation, snr_db=snr_db, seed=seed, rate=rate
        )
        return checked_simulation(made, label_of(self.system))

    @cached_property
    def _snr_db(self) -> float:
        """Angle and torque grow together, so that another amplitude is another signal-to-noise ratio."""
        louder = 20 * math.log10(self.amplitude / RMS_ANGLE)
        if self.noise is None:
            return self.snr_db + louder
        probe = self._made(PROBE, 0.0, 0)
        noisy, clean = (
            decimate(each, self.rate).torque for each in (probe.recording, probe.noiseless)
        )
        return louder + 20 * math.log10(float(np.std(noisy - clean)) / self.noise)

    def simulated(self, count: int, seed: int) -> Simulated:
        """So many realizations; the same seed gives the same."""
        made = self._made(count * self.period, self._snr_db, seed)
        ensemble = segment(decimate(made.recording, self.rate), self.period, CONTEXT)
        return Simulated(ensemble, made.truth_of(ensemble)["stiffness"])

    def stepped(self) -> Protocol | None:
        """The same with a stiffness that steps up and down.

        None of a system whose stiffness cannot be given.
        """
        if self.stiffness is None:
            return None
        low, high = _levels(self._parts[0].stiffness(np.arange(0, self.period, 1 / self.rate)))
        return attrs.evolve(self, stiffness=SquareWave(low, high, self.period, self.period / 4))


@attrs.frozen(eq=False)
class Pilot:
    """What a pilot recording shows of joint, noise and perturbation: enough to simulate more of the same.

    Made by :meth:`of`. ``stiffness`` and ``viscosity`` are over a realization, shape (time,);
    ``movement`` and ``noise`` are spectral densities of angle and torque noise at
    ``frequencies``; ``amplitude`` is the RMS of the angle that is planned, and ``perturbation``
    one in place of the recorded one, by name or as an object. How much methods scatter is
    compared with what they do in the ensemble that was ``recorded``, if there is one.
    """

    stiffness: Array
    viscosity: Array
    inertia: float
    frequencies: Array
    movement: Array
    noise: Array
    sampling_rate: float
    context: int
    amplitude: float
    perturbation: str | Perturbation | None = None
    recorded: Ensemble | None = None

    @classmethod
    def of(
        cls,
        ensemble: Ensemble,
        *,
        amplitude: float | None = None,
        perturbation: str | Perturbation | None = None,
    ) -> Pilot:
        """Identify a pilot's ensemble, by ``adaptive`` if it has the realizations that this needs, else by ``kbr``.

        What the model leaves of the torque is the noise; both spectra are means over realizations.

        Raises
        ------
        InputError
            If nothing can be identified.

        Warns
        -----
        DataQualityWarning
            Of a reflex, which is not simulated, and of a negative stiffness.
        """
        recorded = ensemble
        if not ensemble.mean_subtracted and len(ensemble) > 1:
            ensemble = subtract_mean(ensemble)
        adaptive = AdaptiveRegression()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DataQualityWarning)  # a diagnosis says it better
            model = (KernelRegression() if adaptive.skip(ensemble) else adaptive).identify(ensemble)
        left = ensemble.torque[:, ensemble.core] - model.predict(ensemble)
        left = left[:, np.isfinite(left).all(axis=0)]
        # What subtracting the mean took away.
        scale = len(ensemble) / (len(ensemble) - 1) if ensemble.mean_subtracted else 1.0
        rate, times = ensemble.sampling_rate, ensemble.samples
        frequencies, noise = _density(left, rate, left.shape[1])
        at, movement = _density(ensemble.angle, rate, ensemble.angle.shape[1])
        movement = np.interp(frequencies, at, movement) * scale
        for text, holds in (
            (REFLEX, "reflex_gain" in model.estimates),
            (NEGATIVE, np.nanmean(model.stiffness) < 0),
        ):
            if holds:
                warnings.warn(text, DataQualityWarning, stacklevel=2)
        return cls(
            _filled(model.stiffness, times),
            _filled(model.viscosity, times),
            float(np.nanmean(model.inertia)),
            frequencies,
            movement,
            noise * scale,
            rate,
            ensemble.context,
            math.sqrt(scale) * float(np.std(ensemble.angle))
            if amplitude is None
            else positive("amplitude", amplitude),
            perturbation,
            recorded,
        )

    def __attrs_post_init__(self) -> None:
        if self.perturbation is not None:
            resolve(self.perturbation, PERTURBATIONS, "perturbation")

    def __str__(self) -> str:
        name = (
            "the pilot's perturbation" if self.perturbation is None else label_of(self.perturbation)
        )
        return f"{name} of {self.amplitude:.2g} rad"

    def described(self) -> str:
        """What the pilot shows, in a line."""
        noise = _rms(self.noise, self.frequencies)
        return (
            f"stiffness {self.stiffness.min():.0f} to {self.stiffness.max():.0f} N·m/rad, "
            f"viscosity {self.viscosity.mean():.2g} N·m·s/rad, inertia {self.inertia:.2g} kg·m²; "
            f"{self}; "
            f"noise of the torque {noise:.2g} N·m RMS"
        )

    @property
    def period(self) -> float:
        """Seconds of a realization."""
        return len(self.stiffness) / self.sampling_rate

    def simulated(self, count: int, seed: int) -> Simulated:
        """So many realizations of the pilot's joint, Gaussian angle and noise of its spectra."""
        samples = count * len(self.stiffness) + 2 * (self.context + HALF_WIDTH)
        random = np.random.default_rng(seed)
        motion = differentiate(self._angle(samples, random), self.sampling_rate)
        place = (np.arange(motion.shape[1]) - self.context) % len(self.stiffness)
        torque = (
            self.stiffness[place] * motion[0]
            + self.viscosity[place] * motion[1]
            + self.inertia * motion[2]
        )
        torque += _gaussian(self.noise, self.frequencies, self.sampling_rate, len(torque), random)
        recording = Recording(
            motion[0], torque, self.sampling_rate, start=-self.context / self.sampling_rate
        )
        ensemble = segment(recording, self.period, self.context / self.sampling_rate)
        return Simulated(ensemble, np.tile(self.stiffness, (len(ensemble), 1)))

    def _angle(self, samples: int, random: np.random.Generator) -> Array:
        rate = self.sampling_rate
        if self.perturbation is None:
            angle = _gaussian(self.movement, self.frequencies, rate, samples, random)
            return angle * self.amplitude / _rms(self.movement, self.frequencies)
        perturbation = resolve(self.perturbation, PERTURBATIONS, "perturbation")
        finer = rate * max(1, -(-SIMULATED_HZ // rate))
        made = Joint(stiffness=Constant()).simulate(
            samples / rate, perturbation=perturbation, snr_db=math.inf, seed=random, rate=finer
        )
        return decimate(made.recording, rate).angle[:samples] * self.amplitude / RMS_ANGLE

    def as_recorded(self) -> Pilot:
        """With the recorded perturbation, whatever else is planned."""
        return attrs.evolve(
            self, perturbation=None, amplitude=_rms(self.movement, self.frequencies)
        )

    def stepped(self) -> Pilot:
        """The same with a stiffness that steps up and down between the pilot's extremes."""
        low, high = _levels(self.stiffness)
        time = np.arange(len(self.stiffness)) / self.sampling_rate
        return attrs.evolve(
            self, stiffness=SquareWave(low, high, self.period, self.period / 4)(time)
        )


Setup = Protocol | Pilot


def seconds_of(setup: Setup, count: float) -> float:
    """Seconds to record for so many realizations: those at both ends that lack context are left out."""
    context = setup.context / setup.sampling_rate if isinstance(setup, Pilot) else CONTEXT
    lost = 2 * math.ceil(round(context / setup.period, 6))
    return (count + lost) * setup.period


def positive(name: str, value: object) -> float:
    """Return the value as a float, if it is a positive finite number."""
    if (
        isinstance(value, bool)
        or not isinstance(value, (int, float, np.number))
        or not 0 < value < math.inf
    ):
        raise InputError(f"{name}: expected a positive number, got {value!r}")
    return float(value)


def _levels(stiffness: Array) -> tuple[float, float]:
    """Between which a step is tried: the extremes, or about a stiffness that hardly changes."""
    low, high, mean = float(stiffness.min()), float(stiffness.max()), float(stiffness.mean())
    reach = max(high - low, 2 * STEP * abs(mean)) / 2
    return (low + high) / 2 - reach, (low + high) / 2 + reach


def _density(values: Array, rate: float, length: int) -> tuple[Array, Array]:
    """Frequencies, and spectral density of (realization, time), mean over realizations."""
    frequencies, power = scipy.signal.welch(values, rate, nperseg=length, detrend=False, axis=1)
    return frequencies, power.mean(axis=0)


def _rms(density: Array, frequencies: Array) -> float:
    """Root mean square of what has a spectral density."""
    return math.sqrt(float(np.trapezoid(density, frequencies)))


def _gaussian(
    density: Array, at: Array, rate: float, samples: int, random: np.random.Generator
) -> Array:
    """Gaussian noise of a spectral density."""
    size = next_fast_len(samples, real=True)
    frequencies = rfftfreq(size, 1 / rate)
    parts = random.standard_normal((2, len(frequencies)))
    scale = np.sqrt(np.interp(frequencies, at, density) * rate * size) / 2
    return np.asarray(irfft(scale * (parts[0] + 1j * parts[1]), size)[:samples])


def _filled(values: Array, times: int) -> Array:
    """Values (time,) with what is not known at the ends as beside it."""
    known = np.isfinite(values)
    if not known.any():
        raise InputError(
            "pilot: stiffness or viscosity could not be identified; record more, or state the joint"
        )
    return np.interp(np.arange(times), np.flatnonzero(known), values[known])
