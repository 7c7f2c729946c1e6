r"""What may change, and how: a constant, a smooth Gaussian process or none, and switches at any time.

.. math:: x(t) = c + f(t) + \sum_j \Delta_j\, h_{s_j}(t)
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from tvsysid.numerics import Array

LEVEL = 30.0  # standard deviation of the constant, in mean sizes
AMPLITUDES = (0.02, 0.05, 0.125, 0.3, 0.7)  # of the smooth part, in mean sizes
SIZES = (0.05, 0.2, 0.8)  # standard deviations of a switch, in mean sizes
SHORTEST, RATIO = 4.0, 1.6  # length in samples of the roughest smooth part, and from one to the next
FAINT = 1e-7  # share of the first harmonic's variance below which others are left out
TAPS = 1.5  # samples to either side over which a low-pass before sampling smears a step


class Roughness(NamedTuple):
    """A smooth part: its ``kind``, standard deviation in mean sizes, length in samples, and log prior probability.

    ``weights`` (feature,) are variances, in squares of the mean size, of a constant and of cosines and sines.
    """

    kind: str
    amplitude: float
    length: float
    log_prior: float
    weights: Array


class Axis(NamedTuple):
    """Samples over which something changes: how many ``times``, and whether the end goes on at the beginning."""

    times: int
    periodic: bool

    @property
    def period(self) -> int:
        """Of the Fourier series: where nothing repeats it is twice as long, and of any process over the interval."""
        return self.times if self.periodic else 2 * self.times

    @property
    def harmonics(self) -> int:
        """What the shortest length needs."""
        return max(1, int(0.78 * self.period / SHORTEST))

    def features(self) -> Array:
        """A constant, and cosines and sines of the harmonics, (time, feature)."""
        turns = 2 * np.pi * np.outer(np.arange(self.times), np.arange(1, self.harmonics + 1)) / self.period
        waves = np.stack([np.cos(turns), np.sin(turns)], axis=2).reshape(self.times, -1)
        return np.concatenate([np.ones((self.times, 1)), waves], axis=1)

    def steps(self, positions: Array) -> Array:
        """Steps of 1 at positions in samples, (time, position); a sawtooth that jumps by 1 if the end is no end."""
        late = np.arange(self.times)[:, None] - positions
        if self.periodic:
            return np.asarray(0.5 - np.mod(late, self.times) / self.times)
        return np.asarray((late >= 0).astype(np.float64))

    def seen(self, positions: Array, width: float = 1.0) -> Array:
        """Steps as a recording shows them that was low-passed before it was sampled; ``width`` 0 is none."""
        out = self.steps(positions)
        if not width:
            return out
        late = np.arange(self.times)[:, None] - positions
        if self.periodic:
            late = np.mod(late + self.times / 2, self.times) - self.times / 2
        near = np.abs(late) < TAPS * width
        out[near] += smeared(late[near] / width) - (late[near] >= 0)
        return out


@lru_cache(maxsize=1)
def _smeared_table() -> tuple[Array, Array]:
    grid = np.linspace(-TAPS, TAPS, 1201)
    density = np.sinc(grid) * (0.54 + 0.46 * np.cos(np.pi * grid / TAPS))
    total = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2)])
    return grid, total / total[-1]


def smeared(late: Array) -> Array:
    """What the usual decimation filter, a Hamming-windowed sinc, makes of a step, at times in samples."""
    return np.interp(late, *_smeared_table())


@lru_cache(maxsize=16)
def roughnesses(axis: Axis) -> tuple[Roughness, ...]:
    """Every smooth part there may be: none (prior 1/2), squared-exponential ones, and Matérn 3/2 ones, for corners."""
    period, harmonic = axis.period, np.arange(1, axis.harmonics + 1)
    shapes: list[tuple[str, float, float, Array]] = []

    def add(kind: str, length: float, amplitudes: tuple[float, ...], spectrum: Array) -> None:
        kept = np.where(spectrum >= FAINT * spectrum[0], spectrum, 0.0)
        shapes.extend((kind, a, length, a**2 * kept / kept.sum()) for a in amplitudes)

    length = SHORTEST
    while length < period / 2.5:
        add("smooth", length, AMPLITUDES, np.exp(-2 * (np.pi * harmonic * length / period) ** 2))
        length *= RATIO
    length = SHORTEST * RATIO**2
    while length < period / 1.2:
        spectrum = (1 + (2 * np.pi * harmonic * length / period) ** 2 / 3) ** -2.0
        add("with corners", length, AMPLITUDES[1:], spectrum)
        length *= RATIO**2
    share = math.log(0.5 / max(len(shapes), 1))
    none = np.zeros(2 * axis.harmonics + 1)
    none[0] = LEVEL**2
    out = [Roughness("none", 0.0, math.inf, math.log(0.5), none)]
    for kind, amplitude, length, spectrum in shapes:
        weights = np.concatenate([[LEVEL**2], np.repeat(spectrum, 2)])
        out.append(Roughness(kind, amplitude, length, share, weights))
    return tuple(out)
