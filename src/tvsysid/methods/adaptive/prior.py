r"""Prior of a function of time: a constant, perhaps a smooth Gaussian process, and switches.

.. math:: x(t) = c + f(t) + \sum_j \Delta_j\, h_{s_j}(t)

All sizes are in units of the function's mean size, all times in samples.
"""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from tvsysid.numerics import Array

LEVEL = 30.0  # standard deviation of the constant
AMPLITUDES = (0.02, 0.05, 0.125, 0.3, 0.7)  # prior standard deviations of a smooth part
MIN_LENGTH = 4.0  # samples; shortest length of a smooth part
LENGTH_RATIO = 1.6  # from one length to the next
# Periods. The longest length exceeds MAX_LENGTH / LENGTH_RATIO = 0.52: of a squared-exponential
# process, only the first harmonic is then above MIN_VARIANCE.
MAX_LENGTH = 1 / 1.2
# Cycles per length up to which a squared-exponential process has all but 1e-6 of its variance
MAX_FREQUENCY = 0.78
MIN_VARIANCE = 1e-7  # of a harmonic, relative to the first; fainter ones are left out
MAX_HARMONICS = 160  # with long realizations, the shortest lengths would need more
SWITCH_SIZES = (0.05, 0.2, 0.8)  # prior standard deviations of switches, equally likely
USUAL_SWITCH_SIZE = SWITCH_SIZES[1]  # where only one is tried
DECIMATOR_REACH = 15  # samples before decimation to either side that its filter reaches
USUAL_FILTER_REACH = 1.5  # samples that the filter reaches after decimation by 10
FILTER_SPREAD = 0.33  # standard deviation of the decimation filter's impulse response in samples
JITTERS = (1.0, 1.4, 2.0, 2.8, 4.0)  # candidate standard deviations of a switch's time, in samples


class SmoothPrior(NamedTuple):
    """Prior of a constant and a smooth part.

    ``variances`` (feature,) are those of the coefficients of the constant, and of the cosines and
    sines of each harmonic. ``log_prior`` is the log of this prior's weight among all.
    """

    log_prior: float
    variances: Array


class Axis(NamedTuple):
    """Time axis of a function, and how a recording smears its switches.

    The axis has ``times`` samples. If ``periodic``, the end continues at the beginning. A low-pass
    before sampling smears a step over ``filter_reach`` samples to either side, 0 for none.
    ``jitter`` is the standard deviation of a switch's time between ``realizations``.
    """

    times: int
    periodic: bool
    filter_reach: float = USUAL_FILTER_REACH
    jitter: float = 0.0
    realizations: int = 1

    @property
    def period(self) -> int:
        """Period of the Fourier series.

        Without repetition it is twice as long as the axis, so that it represents any process.
        """
        return self.times if self.periodic else 2 * self.times

    @property
    def harmonics(self) -> int:
        """Number of harmonics that the shortest length needs."""
        return min(MAX_HARMONICS, max(1, int(MAX_FREQUENCY * self.period / MIN_LENGTH)))

    def offset(self, later: ArrayLike, earlier: ArrayLike) -> Array:
        """Return the time from one position to another, at most half a period if periodic."""
        offset = np.subtract(later, earlier)
        if self.periodic:
            offset = offset - self.times * np.floor(offset / self.times + 0.5)
        return offset

    def steps(self, positions: Array, recorded: bool = False) -> Array:
        """Return unit steps at positions, averaged over realizations, shape (time, position).

        ``recorded`` steps are smeared by the low-pass, too. On a periodic axis, a step is a
        sawtooth that jumps by 1.
        """
        late = self.offset(np.arange(self.times)[:, None], positions)
        if self.jitter:
            steps = ndtr(late / math.hypot(self.jitter, FILTER_SPREAD * recorded))
        elif recorded and self.filter_reach:
            steps = np.interp(late, *_smeared_step(self.filter_reach))
        else:
            steps = late >= 0
        return np.asarray(steps - 0.5 - late / self.times if self.periodic else steps, dtype=float)

    def jitter_variance(self, positions: Array) -> Array:
        """Return the variance of the mean of jittered unit steps, shape (time, position)."""
        share = ndtr(self.offset(np.arange(self.times)[:, None], positions) / self.jitter)
        return share * (1 - share) / self.realizations


@lru_cache(maxsize=8)
def _smeared_step(filter_reach: float) -> tuple[Array, Array]:
    """Return times and a unit step after a decimation filter, which is a Hamming-windowed sinc."""
    late = np.linspace(-filter_reach, filter_reach, 1201)
    response = np.sinc(late) * (0.54 + 0.46 * np.cos(np.pi * late / filter_reach))
    step = np.append(0.0, np.cumsum(response[1:] + response[:-1]))
    return late, step / step[-1]


def fourier_features(axis: Axis) -> Array:
    """Return a constant, and cosines and sines of the harmonics, shape (time, feature)."""
    cycles = np.outer(np.arange(axis.times), np.arange(1, axis.harmonics + 1)) / axis.period
    return np.hstack([np.ones((axis.times, 1)), np.exp(2j * np.pi * cycles).view(np.float64)])


def squared_exponential(frequencies: Array) -> Array:
    """Return the spectrum of a smooth kernel at angular frequencies times its length."""
    return np.exp(-(frequencies**2) / 2)


def matern(frequencies: Array) -> Array:
    """Return the spectrum of the Matérn 3/2 kernel, which suits corners."""
    return (1 + frequencies**2 / 3) ** -2.0


def smooth_priors(axis: Axis) -> list[SmoothPrior]:
    """Return the priors of the smooth part, one for each kernel, length and amplitude.

    The first prior has no smooth part. Its weight is 1/2, and so is that of all kernels together.
    Sums of few harmonics are added later (``few_harmonics``), with a weight of 1/10 besides.

    The spectrum of a kernel gives the variances of the cosines and sines of each harmonic. To add a
    stationary kernel, write its spectrum, and add it with lengths and amplitudes to ``kernels``.
    It is cut off at ``axis.harmonics``, which suit the squared exponential.
    """
    frequencies = 2 * np.pi * np.arange(1, axis.harmonics + 1) / axis.period
    shortest = max(MIN_LENGTH, MAX_FREQUENCY * axis.period / (axis.harmonics + 1))
    count = math.ceil(math.log(axis.period * MAX_LENGTH / shortest, LENGTH_RATIO))
    all_lengths = [shortest * LENGTH_RATIO**power for power in range(count)]
    kernels = (
        (squared_exponential, all_lengths, AMPLITUDES),
        (matern, all_lengths[2::2], AMPLITUDES[1:]),  # fewer, to save time
    )
    # A prior probability of 0.98 for no smooth part would reduce the random error by up to a tenth
    # where stiffness only switches. But with a change of stiffness by 3 % in 40 s of PRBS, 68 % of
    # the bands would hold the truth instead of 83 %.
    none = np.append(LEVEL**2, np.zeros(2 * axis.harmonics))
    out = [SmoothPrior(math.log(0.5), none)]
    for spectrum_of, lengths, amplitudes in kernels:
        for length, amplitude in product(lengths, amplitudes):
            spectrum = spectrum_of(frequencies * length)
            spectrum[spectrum < MIN_VARIANCE * spectrum[0]] = 0.0
            variances = np.append(LEVEL**2, np.repeat(amplitude**2 * spectrum / spectrum.sum(), 2))
            log_prior = math.log(0.5 / len(kernels) / len(lengths) / len(amplitudes))
            out.append(SmoothPrior(log_prior, variances))
    return out
