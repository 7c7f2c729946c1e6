"""Conditions of a simulated experiment: its settings, random numbers, times and scales."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property, reduce

import attrs
import numpy as np

from tvsysid.errors import InputError
from tvsysid.signals import Array, Recording
from tvsysid.simulate.actuator import BANDWIDTH
from tvsysid.simulate.perturbations import Perturbation, low_passed_noise
from tvsysid.simulate.simulation import Seed, Simulation
from tvsysid.validators import Validator, is_number, positive

RMS_ANGLE = math.radians(0.5)

is_perturbation = Validator(
    "FilteredNoise, PRBS, Pulses, Multisine or an object with generate",
    lambda value: hasattr(value, "generate"),
)
is_snr = Validator(
    "a number of decibels, or inf", lambda value: is_number(value) or value == math.inf
)
is_rate = Validator(
    f"a number of hertz above {2 * BANDWIDTH:g} Hz",
    lambda value: is_number(value) and value > 2 * BANDWIDTH,
)


@attrs.frozen(eq=False)
class Conditions:
    """Conditions under which a system is simulated.

    One second before time 0 and one second after the duration are recorded as context. One more
    second is simulated before these: the run-in, in which the transients of the filters decay. All
    signals begin with it. :meth:`simulation` cuts it off.
    """

    duration: float = attrs.field(validator=positive)
    perturbation: Perturbation = attrs.field(validator=is_perturbation)
    snr_db: float = attrs.field(validator=is_snr)
    seed: Seed
    rate: float = attrs.field(validator=is_rate)

    @cached_property
    def generators(self) -> list[np.random.Generator]:
        """Random generators of perturbation, noise and the system's own channel."""
        seed = self.seed
        if isinstance(seed, np.random.SeedSequence):
            # Spawning changes a SeedSequence. A copy gives the same numbers each time.
            seed = np.random.SeedSequence(**seed.state | {"n_children_spawned": 0})
        return np.random.default_rng(seed).spawn(3)

    @property
    def second(self) -> int:
        """Number of samples in one second: the run-in, or the context on either side."""
        return round(self.rate)

    @cached_property
    def time(self) -> Array:
        """Time of each sample in s."""
        last = round(self.duration * self.rate) + self.second
        return np.arange(-2 * self.second, last) / self.rate

    def drive(self) -> Array:
        """Return the unscaled perturbation."""
        return self.perturbation.generate(len(self.time), self.rate, self.generators[0])

    def noise(self, bandwidth: float, state: float = 0.0) -> Array:
        """Return unscaled noise of the torque."""
        return low_passed_noise(self.generators[1], bandwidth, self.rate, len(self.time), state)

    def _inner(self, values: Array) -> Array:
        """Return the values from time 0 to the duration, from which scales are computed."""
        return values[2 * self.second : -self.second]

    def angle_scale(self, angle: Array) -> float:
        """Return the factor that scales an angle to an RMS of 0.5 degrees."""
        inner = self._inner(angle)
        size = float(np.dot(inner, inner))
        if size == 0:
            raise InputError(f"simulate: {self.perturbation!r} gave an angle of 0 only")
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
        channels: Mapping[str, Array],
    ) -> Simulation:
        """Return the simulation without the run-in, whose torque is pathways plus noise."""
        recorded = slice(self.second, None)

        def cut(signals: Mapping[str, Array]) -> dict[str, Array]:
            own = {name: values[recorded] for name, values in signals.items()}
            for values in own.values():
                values.flags.writeable = False  # so that they are not copied
            return own

        torque = reduce(np.add, pathways.values()) + noise
        start = float(self.time[self.second])
        own = cut({"angle": angle, "torque": torque, **channels})
        recording = Recording(own.pop("angle"), own.pop("torque"), self.rate, start, channels=own)
        return Simulation(recording, cut(truth), cut(pathways))
