"""Angular perturbations, before the actuator's bandwidth limits them; their size is set later."""

from __future__ import annotations

import math
from typing import Protocol

import attrs
import numpy as np
import scipy

from tvsysid.errors import InputError
from tvsysid.numerics import Array
from tvsysid.simulate.settings import not_negative, positive


class Perturbation(Protocol):
    """Anything that generates an angle, up to its scale."""

    def generate(self, samples: int, rate: float, random: np.random.Generator) -> Array:
        """Samples at the rate in Hz, shape (samples,)."""
        ...  # pragma: no cover


def generated(
    perturbation: Perturbation, samples: int, rate: float, random: np.random.Generator
) -> Array:
    """Angle that a perturbation generates, if it is one finite number for each sample."""
    values = perturbation.generate(samples, rate, random)
    if np.shape(values) != (samples,) or not np.isfinite(values).all():
        came = (
            "values that are not finite"
            if np.shape(values) == (samples,)
            else f"shape {np.shape(values)}"
        )
        raise InputError(
            f"{type(perturbation).__name__}: generate(samples, rate, random) must return one "
            "finite number for each "
            f"sample, shape ({samples},); got {came}"
        )
    return np.asarray(values)


@attrs.frozen
class FilteredNoise:
    """White noise through a second-order low-pass Butterworth filter, with its -3 dB frequency ``cutoff`` in Hz."""

    cutoff: float = 5.0

    def __attrs_post_init__(self) -> None:
        positive("FilteredNoise", cutoff=self.cutoff)

    def generate(self, samples: int, rate: float, random: np.random.Generator) -> Array:
        """Samples at the rate in Hz, shape (samples,); starts from rest."""
        if self.cutoff >= rate / 2:
            raise InputError(
                f"FilteredNoise: cutoff {self.cutoff:g} Hz must be below half the sampling rate "
                f"of {rate:g} Hz"
            )
        numerator, denominator = scipy.signal.butter(2, self.cutoff, fs=rate)
        return np.asarray(
            scipy.signal.lfilter(numerator, denominator, random.standard_normal(samples))
        )


@attrs.frozen
class PRBS:
    """Pseudo-random binary sequence: each ``switch_interval`` (s) takes one of two levels with equal probability.

    The paper states a switching rate of 147 ms and a mean absolute velocity of 0.08 rad/s, which
    do not go together: a 147-ms clock gives 0.06 rad/s, and 0.08 rad/s take some 109 ms. The
    stated interval is the default.
    """

    switch_interval: float = 0.147

    def __attrs_post_init__(self) -> None:
        positive("PRBS", switch_interval=self.switch_interval)

    def generate(self, samples: int, rate: float, random: np.random.Generator) -> Array:
        """Samples at the rate in Hz, shape (samples,), of 1 and -1.

        Starts at a random phase of the clock.
        """
        interval = self.switch_interval * rate
        if interval < 1:
            raise InputError(
                f"PRBS: switch_interval {self.switch_interval:g} s is shorter than a sample at "
                f"{rate:g} Hz"
            )
        phase = random.uniform(0, interval)
        levels = 2.0 * random.integers(0, 2, math.ceil((samples + phase) / interval) + 1) - 1.0
        switches = np.ceil(np.arange(1, len(levels) + 1) * interval - phase).astype(np.intp)
        lengths = np.diff(np.minimum(switches, samples), prepend=0)
        return np.repeat(levels, lengths)


@attrs.frozen
class Pulses:
    """Pulses to either side with rests between them, as the ankle is often perturbed while its muscles contract.

    A pulse lasts ``duration`` s, to either side with equal probability; the next begins
    ``interval`` s after it. Both pulses and rests vary, each by up to the share ``variation`` of
    its length. With the defaults, which are those of the tonic contractions in the public
    toolbox of Kearney's laboratory, the usual RMS of 0.5 degrees makes pulses of 0.7 degrees.
    """

    duration: float = 0.25
    interval: float = 0.5
    variation: float = 0.2

    def __attrs_post_init__(self) -> None:
        positive("Pulses", duration=self.duration, interval=self.interval)
        not_negative("Pulses", variation=self.variation)
        if self.duration >= self.interval or self.variation >= 1:
            raise InputError(
                "Pulses: expected a duration below the interval, and a variation below 1, got "
                f"{self!r}"
            )

    def generate(self, samples: int, rate: float, random: np.random.Generator) -> Array:
        """Samples at the rate in Hz, shape (samples,), of 1, 0 and -1.

        Starts at a random time between two pulses.
        """
        if self.duration * rate * (1 - self.variation) < 1:
            raise InputError(
                f"Pulses: {self!r} has pulses that are shorter than a sample at {rate:g} Hz"
            )
        count = math.ceil(samples / (self.interval * rate * (1 - self.variation))) + 2
        lengths = np.array([self.duration, self.interval - self.duration]) * rate
        lengths = lengths * (1 + self.variation * random.uniform(-1, 1, (count, 2)))
        levels = np.stack([2.0 * random.integers(0, 2, count) - 1.0, np.zeros(count)], axis=1)
        ends = np.rint(np.cumsum(lengths) - random.uniform(0, self.interval * rate))
        shown = np.diff(np.clip(ends, 0, samples), prepend=0.0).astype(np.intp)
        return np.repeat(levels.ravel(), shown)


@attrs.frozen
class Multisine:
    """Sum of sines of equal amplitude at these ``frequencies`` in Hz, each at a random phase.

    A line that is a multiple of 1/period moves the joint alike in every realization. Where all
    are, nothing is left when the mean over realizations is subtracted, which
    :func:`tvsysid.preprocess.subtract_mean` refuses; the default lines have no common multiple
    below 10 s with a period of 2 s. So a line needs some tenths of 1/period between it and the
    next multiple.
    """

    frequencies: tuple[float, ...] = (1.2, 5.2, 9.2, 13.2, 17.2)

    def __attrs_post_init__(self) -> None:
        if not self.frequencies:
            raise InputError("Multisine: frequencies must be numbers of hertz, got none")
        for frequency in self.frequencies:
            positive("Multisine", frequencies=frequency)
        if len(set(self.frequencies)) < len(self.frequencies):
            raise InputError(f"Multisine: frequencies must differ, got {self.frequencies}")

    def generate(self, samples: int, rate: float, random: np.random.Generator) -> Array:
        """Samples at the rate in Hz, shape (samples,)."""
        if max(self.frequencies) >= rate / 2:
            raise InputError(
                f"Multisine: frequencies must be below half the sampling rate of {rate:g} Hz, got "
                f"{self.frequencies}"
            )
        turns = np.outer(self.frequencies, np.arange(samples) / rate) + random.random(
            (len(self.frequencies), 1)
        )
        return np.asarray(np.sin(2 * np.pi * turns).sum(axis=0))


PERTURBATIONS: dict[str, Perturbation] = {
    "noise": FilteredNoise(),
    "prbs": PRBS(),
    "pulses": Pulses(),
    "multisine": Multisine(),
}
"""Perturbations by name."""
