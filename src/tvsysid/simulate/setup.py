"""What every simulated experiment shares: checked settings, random streams, times, and the noise of the torque."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import reduce

import attrs
import numpy as np
import scipy
from numpy.typing import NDArray

from tvsysid.checked import checked_rate
from tvsysid.errors import InputError
from tvsysid.signals import Array, Recording
from tvsysid.simulate.perturbations import Perturbation
from tvsysid.simulate.settings import positive
from tvsysid.simulate.simulation import Seed, Simulation

RMS_ANGLE = math.radians(0.5)
# cut-off in Hz of the actuator's (Bessel) filter and of the measurement noise's (Butterworth)
BANDWIDTH = 40.0
# seconds recorded before time 0 and after the duration, so that every realization has context
MARGIN = 1.0
# seconds simulated before that and thrown away, so that the filters' start from rest is forgotten
RUN_IN = 1.0


@attrs.frozen(eq=False)
class Setup:
    """What is asked of a system, checked once; its name is for messages."""

    system: str
    duration: float
    perturbation: Perturbation
    snr_db: float
    seed: Seed
    rate: float

    def __attrs_post_init__(self) -> None:
        rate, name = checked_rate(self.rate), self.system
        object.__setattr__(self, "rate", rate)
        if rate <= 2 * BANDWIDTH:
            raise InputError(f"{name}: rate must be above {2 * BANDWIDTH:g} Hz, got {rate:g} Hz")
        positive(name, duration=self.duration)
        if self.inside < 1:
            raise InputError(
                f"{name}: a duration of {self.duration:g} s is shorter than a sample at {rate:g} Hz"
            )
        if not isinstance(self.snr_db, (int, float, np.number)) or not self.snr_db > -300:
            raise InputError(
                f"{name}: snr_db must be a number of decibels above -300, got {self.snr_db!r}"
            )
        if not callable(getattr(self.perturbation, "generate", None)):
            raise InputError(
                f"{name}: perturbation must be FilteredNoise, PRBS, Pulses, Multisine or have "
                "generate, "
                f"got {self.perturbation!r}"
            )

    @property
    def inside(self) -> int:
        """Samples from time 0 to the duration."""
        return round(self.duration * self.rate)

    @property
    def run_in(self) -> int:
        """Samples before the recording."""
        return round(RUN_IN * self.rate)

    @property
    def index(self) -> NDArray[np.int64]:
        """Number of each recorded sample; that at time 0 has number 0."""
        margin = round(MARGIN * self.rate)
        return np.arange(-margin, self.inside + margin)

    @property
    def whole_index(self) -> NDArray[np.int64]:
        """Number of each simulated sample, those before the recording included."""
        return np.arange(self.index[0] - self.run_in, self.index[-1] + 1)

    @property
    def inner(self) -> slice:
        """Recorded samples from time 0 to the duration, over which sizes are measured."""
        margin = round(MARGIN * self.rate)
        return slice(margin, margin + self.inside)

    def streams(self, count: int = 2) -> list[np.random.Generator]:
        """Independent random numbers: for the perturbation, the noise, and whatever else the system draws."""
        seed = self.seed
        try:
            if isinstance(seed, np.random.SeedSequence):
                # Spawning counts in the sequence: with a copy, the same one gives the same numbers
                # again.
                seed = np.random.SeedSequence(
                    seed.entropy, spawn_key=seed.spawn_key, pool_size=seed.pool_size
                )
            return np.random.default_rng(seed).spawn(count)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"{self.system}: seed must be a whole number of zero or more, got {seed!r}"
            ) from error

    def low_passed(
        self, random: np.random.Generator, cutoff: float, settling: int
    ) -> LowPassedNoise:
        """Noise of the torque, of any size; ``cutoff`` is the system's ``noise_bandwidth``."""
        if cutoff >= self.rate / 2:
            raise InputError(
                f"{self.system}: noise_bandwidth must be below half the sampling rate of "
                f"{self.rate:g} Hz, "
                f"got {cutoff:g} Hz"
            )
        return LowPassedNoise(random, cutoff, self.rate, settling)

    def scale_of(self, angle: Array) -> float:
        """Factor that gives an angle the usual RMS."""
        size = float(np.dot(angle[self.inner], angle[self.inner]))
        if size == 0:
            raise InputError(f"{self.system}: {self.perturbation!r} gave a signal without movement")
        return RMS_ANGLE / math.sqrt(size / self.inside)

    def noise_scale(self, torque: Array, noise: Array) -> float:
        """Factor that gives noise the size asked for, relative to a torque."""
        ratio = float(np.std(torque[self.inner]) / np.std(noise[self.inner]))
        return ratio * 10 ** (-self.snr_db / 20)

    def simulation(
        self,
        angle: Array,
        noise: Array,
        pathways: Mapping[str, Array],
        truth: Mapping[str, Array],
        channels: Mapping[str, Array] | None = None,
        answered: Array | None = None,
    ) -> Simulation:
        """Simulation of these signals.

        The noise, of any size, is sized by the torque ``answered`` (the sum of the pathways if
        not given) and becomes the noisy torque in place.
        """
        torque = reduce(np.add, pathways.values())
        noise *= self.noise_scale(torque if answered is None else answered, noise)
        noise += torque
        for values in (angle, noise, *pathways.values()):
            values.flags.writeable = False
        recording = Recording(angle, noise, self.rate, self.index[0] / self.rate, channels or {})
        return Simulation(recording, truth, pathways)


class LowPassedNoise:
    """White noise through a second-order Butterworth low-pass, block after block.

    After so many samples to settle.
    """

    def __init__(
        self, random: np.random.Generator, cutoff: float, rate: float, settling: int
    ) -> None:
        self.random, self.filter, self.state = (
            random,
            scipy.signal.butter(2, cutoff, fs=rate),
            np.zeros(2),
        )
        self(settling)

    def __call__(self, samples: int) -> Array:
        """Return the next samples."""
        noise, self.state = scipy.signal.lfilter(
            *self.filter, self.random.standard_normal(samples), zi=self.state
        )
        return np.asarray(noise)
