"""Perturbations of the angle. The actuator limits their bandwidth, and they are scaled later."""

from __future__ import annotations

import math
from typing import Protocol

import attrs
import numpy as np
import scipy

from tvsysid.errors import InputError
from tvsysid.numerics import Array

VARIATION = 0.2  # of the lengths of pulses and rests, as a share


class Perturbation(Protocol):
    """Any object that generates an angle, up to its scale."""

    def generate(self, samples: int, rate: float, random: np.random.Generator) -> Array:
        """Return samples at the rate in Hz, shape (samples,)."""
        ...  # pragma: no cover


@attrs.frozen
class FilteredNoise:
    """White noise through a second-order low-pass Butterworth filter of -3 dB at ``cutoff`` Hz."""

    cutoff: float = 5.0

    def generate(self, samples: int, rate: float, random: np.random.Generator) -> Array:
        """Return samples at the rate in Hz, shape (samples,). They start from rest."""
        return low_passed_noise(random, self.cutoff, rate, samples)


def low_passed_noise(
    random: np.random.Generator,
    cutoff: float,
    rate: float,
    samples: int,
    state: float = 0.0,
) -> Array:
    """Return white noise after a second-order Butterworth low-pass with this initial state."""
    low_pass = scipy.signal.butter(2, cutoff, fs=rate)
    white = random.standard_normal(samples)
    return scipy.signal.lfilter(*low_pass, white, zi=[state, 0.0])[0]


@attrs.frozen
class PRBS:
    """Pseudo-random binary sequence: one of two levels at random in each ``switch_interval`` (s).

    The paper states a switching rate of 147 ms and a mean absolute velocity of 0.08 rad/s. These
    do not fit: a 147-ms clock gives 0.06 rad/s, and 0.08 rad/s take some 109 ms. The stated
    interval is the default.
    """

    switch_interval: float = 0.147

    def generate(self, samples: int, rate: float, random: np.random.Generator) -> Array:
        """Return samples of 1 and -1 at the rate in Hz, shape (samples,).

        They start at a random phase of the clock.
        """
        interval = self.switch_interval * rate
        phase = random.uniform(0, interval)
        levels = 2.0 * random.integers(0, 2, math.ceil((samples + phase) / interval) + 1) - 1.0
        switches = np.ceil(np.arange(1, len(levels) + 1) * interval - phase).astype(np.intp)
        return np.repeat(levels, np.diff(np.minimum(switches, samples), prepend=0))


@attrs.frozen
class Pulses:
    """Pulses to either side with rests between them, as for ankles with contracted muscles.

    A pulse lasts ``duration`` s, to either side with equal probability. The next begins
    ``interval`` s after it. Both pulses and rests vary, each by up to 20 % of its length. The
    defaults are those of the tonic contractions in the public toolbox of Kearney's laboratory. The
    usual RMS of 0.5 degrees then makes pulses of 0.7 degrees.
    """

    duration: float = 0.25
    interval: float = 0.5

    def generate(self, samples: int, rate: float, random: np.random.Generator) -> Array:
        """Return samples of 1, 0 and -1 at the rate in Hz, shape (samples,).

        They start at a random time between two pulses.
        """
        count = math.ceil(samples / (self.interval * rate * (1 - VARIATION))) + 2
        lengths = np.array([self.duration, self.interval - self.duration]) * rate
        lengths = lengths * (1 + VARIATION * random.uniform(-1, 1, (count, 2)))
        levels = np.stack([2.0 * random.integers(0, 2, count) - 1.0, np.zeros(count)], axis=1)
        ends = np.rint(np.cumsum(lengths) - random.uniform(0, self.interval * rate))
        shown = np.diff(np.clip(ends, 0, samples), prepend=0.0).astype(np.intp)
        return np.repeat(levels.ravel(), shown)


@attrs.frozen
class Multisine:
    """Sum of sines of equal amplitude at these ``frequencies`` in Hz, each at a random phase.

    A line at a multiple of 1/period moves the joint alike in every realization. If all lines are
    such multiples, nothing is left after the mean over realizations is subtracted, and
    :func:`tvsysid.preprocess.subtract_mean` raises an error. So leave some tenths of 1/period
    between a line and the next multiple. The default lines have no common multiple below 10 s with
    a period of 2 s.
    """

    frequencies: tuple[float, ...] = (1.2, 5.2, 9.2, 13.2, 17.2)

    def generate(self, samples: int, rate: float, random: np.random.Generator) -> Array:
        """Return samples at the rate in Hz, shape (samples,)."""
        if max(self.frequencies) >= rate / 2:
            raise InputError(
                f"Multisine: frequencies must be below half the sampling rate of {rate:g} Hz, got "
                f"{self.frequencies}"
            )
        phases = random.random((len(self.frequencies), 1))
        turns = np.outer(self.frequencies, np.arange(samples) / rate) + phases
        return np.sin(2 * np.pi * turns).sum(axis=0)


PERTURBATIONS: dict[str, Perturbation] = {
    "noise": FilteredNoise(),
    "prbs": PRBS(),
    "pulses": Pulses(),
    "multisine": Multisine(),
}
"""Perturbations by name."""
