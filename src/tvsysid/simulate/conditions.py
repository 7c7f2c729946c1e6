"""Conditions of a simulated experiment: its settings, random seed, times and noise."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property, reduce

import attrs
import numpy as np

from tvsysid.errors import InputError
from tvsysid.signals import Array, Recording
from tvsysid.simulate.perturbations import Perturbation, low_passed_noise
from tvsysid.simulate.simulation import Seed, Simulation
from tvsysid.validators import Validator, at_least, is_number, positive

RMS_ANGLE = math.radians(0.5)
BANDWIDTH = 40.0  # Hz, of the actuator's Bessel filter and the noise's Butterworth filter

RULES = {
    "duration": positive,
    "perturbation": Validator(
        "FilteredNoise, PRBS, Pulses, Multisine or an object with generate",
        lambda value: callable(getattr(value, "generate", None)),
    ),
    "snr_db": Validator(
        "a number of decibels above -300",
        lambda value: (is_number(value) or value == math.inf) and value > -300,
    ),
    "seed": Validator(
        "a whole number of zero or more",
        lambda value: not isinstance(value, int | float) or at_least(0).is_valid(value),
    ),
    "rate": Validator(
        f"a number of hertz above {2 * BANDWIDTH:g} Hz",
        lambda value: is_number(value) and value > 2 * BANDWIDTH,
    ),
}


@attrs.frozen(eq=False)
class Conditions:
    """Conditions under which a system is simulated. ``system`` is its name in error messages.

    One second before time 0 and one second after the duration are recorded as context. One more
    second is simulated before these but not recorded: the run-in, in which the transients of the
    filters decay.
    """

    system: str
    duration: float
    perturbation: Perturbation
    snr_db: float
    seed: Seed
    rate: float

    @cached_property
    def generators(self) -> list[np.random.Generator]:
        """Random generators of perturbation, noise and the system's own channel."""
        seed = self.seed
        if isinstance(seed, np.random.SeedSequence):
            # Spawning changes a SeedSequence. A copy gives the same numbers each time.
            seed = np.random.SeedSequence(**seed.state | {"n_children_spawned": 0})
        return np.random.default_rng(seed).spawn(3)

    def __attrs_post_init__(self) -> None:
        for name, rule in RULES.items():
            rule.check(self.system, name, getattr(self, name))

    @property
    def second(self) -> int:
        """Number of samples in one second: the run-in, or the context on either side."""
        return round(self.rate)

    @property
    def whole_time(self) -> Array:
        """Time of each simulated sample in s, those of the run-in included."""
        return (
            np.arange(-2 * self.second, round(self.duration * self.rate) + self.second) / self.rate
        )

    @property
    def recorded(self) -> slice:
        """Simulated samples that are recorded."""
        return slice(self.second, None)

    @property
    def time(self) -> Array:
        """Time of each recorded sample in s."""
        return self.whole_time[self.recorded]

    def _inner(self, values: Array) -> Array:
        """Return recorded values from time 0 to the duration, from which scales are computed."""
        return values[self.second : -self.second]

    def drive(self) -> Array:
        """Return the unscaled perturbation over the whole time."""
        return self.perturbation.generate(len(self.whole_time), self.rate, self.generators[0])

    def noise(self, bandwidth: float, state: float = 0.0) -> Array:
        """Return unscaled noise of the torque over the whole time."""
        samples = len(self.whole_time)
        return low_passed_noise(self.generators[1], bandwidth, self.rate, samples, state)

    def angle_scale(self, angle: Array) -> float:
        """Return the factor that scales an angle to an RMS of 0.5 degrees."""
        inner = self._inner(angle)
        size = float(np.dot(inner, inner))
        if size == 0:
            raise InputError(f"{self.system}: {self.perturbation!r} gave an angle of 0 only")
        return RMS_ANGLE / math.sqrt(size / len(inner))

    def noise_scale(self, torque: Array, noise: Array) -> float:
        """Return the factor that scales noise to the signal-to-noise ratio for a torque."""
        ratio = float(np.std(self._inner(torque)) / np.std(self._inner(noise)))
        return ratio * 10 ** (-self.snr_db / 20)

    def simulation(
        self,
        angle: Array,
        noise: Array,
        pathways: Mapping[str, Array],
        truth: Mapping[str, Array],
        channels: Mapping[str, Array] | None = None,
        imposed: Array | None = None,
    ) -> Simulation:
        """Scale the noise, add it to the torque, and return the simulation.

        The noise is scaled relative to the torque ``imposed``, by default the sum of the pathways.
        """
        torque = reduce(np.add, pathways.values())
        noise = noise * self.noise_scale(torque if imposed is None else imposed, noise)
        start = float(self.time[0])
        recording = Recording(angle, torque + noise, self.rate, start, channels=channels or {})
        return Simulation(recording, truth, pathways)
