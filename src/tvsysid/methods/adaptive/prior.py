r"""Priors of a function of time: a constant, perhaps a smooth Gaussian process, and switches.

.. math:: x(t) = c + f(t) + \sum_j \Delta_j\, h_{s_j}(t)
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from tvsysid.numerics import Array

LEVEL = 30.0  # standard deviation of the constant, in mean sizes
AMPLITUDES = (0.02, 0.05, 0.125, 0.3, 0.7)  # of the smooth part, in mean sizes
SIZES = (0.05, 0.2, 0.8)  # standard deviations of a switch, in mean sizes
SHORTEST, RATIO = (
    4.0,
    1.6,
)  # length in samples of the roughest smooth part, and from one to the next
LONGEST = (
    1 / 1.2
)  # period below which lengths are tried; from half of it on one harmonic is all that is left
FAINT = 1e-7  # share of the first harmonic's variance below which others are left out
DECIMATOR = 15  # samples before decimation to either side that its filter reaches
USUAL_TAPS = 1.5  # samples that it reaches after a decimation by 10
LOW_PASS = 0.33  # standard deviation in samples of what it smears
JITTERS = (1.0, 1.4, 2.0, 2.8, 4.0)  # samples, that are tried
HARMONICS = 160  # at most: what is shorter is left out of long realizations


class Roughness(NamedTuple):
    """A smooth part of a function of time.

    It has a ``kind``, a standard deviation in mean sizes, a length in samples, and a log prior
    probability. ``weights`` (feature,) are variances, in squares of the mean size, of a constant
    and of cosines and sines.
    """

    kind: str
    amplitude: float
    length: float
    log_prior: float
    weights: Array


class Axis(NamedTuple):
    """Sampled time axis of a function.

    It has ``times`` samples. If ``periodic``, the end continues at the beginning. ``taps`` are
    samples to either side over which a low-pass before sampling smears a step, 0 for none.
    ``jitter`` is the standard deviation in samples of a switch's time between ``realizations``. It
    makes their mean change gradually.
    """

    times: int
    periodic: bool
    taps: float = USUAL_TAPS
    jitter: float = 0.0
    realizations: int = 1

    @property
    def period(self) -> int:
        """Return the period of the Fourier series in samples.

        Without repetition it is twice as long as the interval, so that it represents any process.
        """
        return self.times if self.periodic else 2 * self.times

    @property
    def harmonics(self) -> int:
        """Return the number of harmonics that the shortest length needs."""
        return min(HARMONICS, max(1, int(0.78 * self.period / SHORTEST)))

    def features(self) -> Array:
        """Return a constant, and cosines and sines of the harmonics, shape (time, feature)."""
        turns = (
            2
            * np.pi
            * np.outer(np.arange(self.times), np.arange(1, self.harmonics + 1))
            / self.period
        )
        waves = np.stack([np.cos(turns), np.sin(turns)], axis=2).reshape(self.times, -1)
        return np.concatenate([np.ones((self.times, 1)), waves], axis=1)

    def late(self, positions: Array) -> Array:
        """Return by how many samples times are later than positions, shape (time, position).

        On a periodic axis, this is at most half a period.
        """
        late = np.arange(self.times)[:, None] - positions
        return np.asarray(
            late - self.times * np.floor(late / self.times + 0.5) if self.periodic else late
        )

    def sharp(self, late: Array) -> Array:
        """Return the values of unit steps, ``late`` samples after each step.

        On a periodic axis, a step is a sawtooth that jumps by 1.
        """
        step = (late >= 0).astype(np.float64)
        return np.asarray(step - 0.5 - late / self.times if self.periodic else step)

    def steps(self, positions: Array) -> Array:
        """Return steps at positions in samples, averaged over realizations, (time, position)."""
        late = self.late(positions)
        out = self.sharp(late)
        if self.jitter:
            out += ndtr(late / self.jitter) - (late >= 0)
        return out

    def uneven(self, positions: Array) -> Array:
        """Return the variance of the mean over realizations of steps, shape (time, position).

        The steps come at different times in different realizations.
        """
        if not self.jitter:
            return np.zeros((self.times, len(positions)))
        share = ndtr(self.late(positions) / self.jitter)
        return np.asarray(share * (1 - share) / self.realizations)

    def seen(self, positions: Array) -> Array:
        """Return the steps as they are recorded."""
        late = self.late(positions)
        out = self.sharp(late)
        if self.jitter:
            out += ndtr(late / math.hypot(self.jitter, LOW_PASS * (self.taps > 0))) - (late >= 0)
        elif self.taps:
            near = np.abs(late) < self.taps
            out[near] += smeared(late[near], self.taps) - (late[near] >= 0)
        return out


@lru_cache(maxsize=8)
def _smeared_table(taps: float) -> tuple[Array, Array]:
    grid = np.linspace(-taps, taps, 1201)
    density = np.sinc(grid) * (0.54 + 0.46 * np.cos(np.pi * grid / taps))
    total = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2)])
    return grid, total / total[-1]


def smeared(late: Array, taps: float) -> Array:
    """Return a step after a decimation filter, at times in samples.

    The filter is a Hamming-windowed sinc.
    """
    return np.interp(late, *_smeared_table(taps))


@lru_cache(maxsize=16)
def roughnesses(axis: Axis) -> tuple[Roughness, ...]:
    """Return the smooth parts that are tried, with their prior probabilities.

    No smooth part has 1/2. Squared-exponential parts and Matérn 3/2 parts, which suit corners,
    share the other half.
    """
    period, harmonic = axis.period, np.arange(1, axis.harmonics + 1)
    shapes: list[tuple[str, float, float, Array]] = []

    def add(kind: str, length: float, amplitudes: tuple[float, ...], spectrum: Array) -> None:
        kept = np.where(spectrum >= FAINT * spectrum[0], spectrum, 0.0)
        shapes.extend((kind, a, length, a**2 * kept / kept.sum()) for a in amplitudes)

    length = shortest = max(SHORTEST, 0.78 * period / (axis.harmonics + 1))
    while length < period * LONGEST:
        add("smooth", length, AMPLITUDES, np.exp(-2 * (np.pi * harmonic * length / period) ** 2))
        length *= RATIO
    length = shortest * RATIO**2
    while length < period * LONGEST:
        spectrum = (1 + (2 * np.pi * harmonic * length / period) ** 2 / 3) ** -2.0
        add("with corners", length, AMPLITUDES[1:], spectrum)
        length *= RATIO**2
    # A prior weight of 0.98 for no smooth part would reduce the random error by up to a tenth where
    # stiffness only switches. But bands would cover 68 instead of 83 % of a change by 3 % in 40 s
    # of PRBS.
    share = math.log(0.5 / max(len(shapes), 1))
    none = np.zeros(2 * axis.harmonics + 1)
    none[0] = LEVEL**2
    out = [Roughness("none", 0.0, math.inf, math.log(0.5), none)]
    for kind, amplitude, length, spectrum in shapes:
        weights = np.concatenate([[LEVEL**2], np.repeat(spectrum, 2)])
        out.append(Roughness(kind, amplitude, length, share, weights))
    return tuple(out)
