"""Check whether the behaviour repeats with the period that was given."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.ndimage import uniform_filter1d

from tvsysid.methods.cascade.reflex_test import MIN_TESTED_REALIZATIONS
from tvsysid.numerics.bases import FourierSeries
from tvsysid.quality.checks import Measured, NotApplicable, check
from tvsysid.quality.fitted import MIN_EXPLAINED, FittedEnsemble
from tvsysid.quality.statistics import SIGNIFICANT
from tvsysid.signals import Array

# Cycles per realization that may be another period; the clock of a PRBS is faster.
MIN_CYCLES, MAX_CYCLES = 0.3, 3.3
RESOLUTION = 0.25  # step in frequency, in one over the record's length
# Distance from a harmonic, likewise, within which a line is no other period; the second of a
# behaviour that drifts.
NEAR, NEAR_DRIFTING = 0.2, 4.0
NEAR_HARMONIC = 0.1  # the same as a share of the harmonic's number, for the name of the period
BEAT_RATIO = 1.25  # of a line in the inertia to the same in the stiffness: a beat, no behaviour
# Harmonics of stiffness by which it may repeat within a realization; lines of a perturbation beat
# faster than the second, in Hz.
MAX_HARMONICS, MAX_CHANGE_HZ = 12, 3.0
MIN_VARIATION = 0.05  # RMS of what repeats, over the mean stiffness
MAX_DIFFERENCE = 0.25  # RMS of what does not repeat, over that of what does
MIN_POWER = 5.0  # of what repeats, over the power of its noise


@check(
    "wrong-period",
    "The movement does not repeat with this period, or the sampling rate is wrong",
    "variation of the stiffness with another period, as a share of the mean",
    10,
    "%",
    effect="each realization holds another part of the movement, so the time variation averages "
    "out",
    remedy="cut with the period that is named here, if there is one, or sort realizations by what "
    "the stiffness depends on; check the sampling rate: if half of the true one is stated, the "
    "period doubles",
)
def wrong_period(data: FittedEnsemble) -> Measured:
    """Find stiffness that varies with a period of which no whole number fits a realization.

    The residual is projected on the torque of stiffness at each sample. A line in that series
    between harmonics of the period is a behaviour of another period. The series has no part at
    the harmonics only if it is that of the fitted signals. So stiffness and viscosity are fitted
    again to the whitened signals. The test compares the power of a line with that of realizations
    of random phase. Near the harmonics of a behaviour that drifts, no line is looked for.
    """
    given, trials = data.ensemble.duration, _trials(data)
    if len(trials) == len(data):
        raise NotApplicable("each realization is a trial of its own")
    data.require(MIN_TESTED_REALIZATIONS)
    left, longest = data.white_fit.residual, _longest(data)
    frequencies, coherent, power = lines(left * data.white_parts[0], data)
    # Inertia is constant. A line that is even stronger in it is a PRBS' clock beating with the
    # sampling.
    beating = lines(left * data.white_parts[2], data)[1]
    width = 2 * round(1 / RESOLUTION) + 1
    is_beat = uniform_filter1d(beating, width) > BEAT_RATIO * uniform_filter1d(coherent, width)
    cycles = frequencies * given
    beside = np.abs(cycles - np.round(cycles)) * longest / given
    is_harmonic = beside < (NEAR_DRIFTING if data.finding("drift").found else NEAR)
    coherent = np.where(is_beat | is_harmonic, 0.0, coherent)
    amplitude = 200 * np.sqrt(power) / np.sum(data.white_parts[0] ** 2)
    best = int(np.argmax(np.where(coherent > 1, amplitude, 0.0)))
    chance = max(0.0, 1 - coherent[best] / len(data)) ** (len(data) - 1)
    chance *= max(1.0, len(frequencies) * RESOLUTION)  # of independent frequencies
    # A line near a harmonic is that harmonic of a period near the given one.
    number = max(1, round(cycles[best]))
    number = number if abs(cycles[best] - number) < NEAR_HARMONIC * number else 1
    period = number / frequencies[best]
    digits = next((n for n in range(3, 6) if f"{period:.{n}g}" != f"{given:.{n}g}"), 6)
    what = (
        f"stiffness varies by {amplitude[best]:.2g} % of its mean with {period:.{digits}g} s, "
        f"beside what repeats every {given:g} s"
    )
    factor = max(period / given, given / period)
    if round(factor) > 1 and abs(factor / round(factor) - 1) < 1.5 * period / longest:
        what += (
            f"; if that should be {given:g} s, the sampling rate is {round(factor)} times "
            f"{'higher' if period > given else 'lower'} than stated"
        )
    return Measured(amplitude[best], what, chance < SIGNIFICANT)


def shorter_period(data: FittedEnsemble) -> list[str]:
    """Return a remark if the stiffness repeats with a third or a half of the period.

    Harmonics of stiffness are fitted to the signals, not whitened, which would shorten the
    realization. Those that the shorter period has make up what repeats, the others what does not.
    """
    fit, given = data.fit, data.ensemble.duration
    if len(data) < MIN_TESTED_REALIZATIONS or data.explained < MIN_EXPLAINED:
        return []
    angle, (steady, _) = fit.motion[0], data.mean_impedance
    left = fit.torque - np.tensordot(steady, fit.motion, 1)
    count = min(MAX_HARMONICS, int(MAX_CHANGE_HZ * given))
    samples = np.arange(data.region.start, data.region.stop) - data.ensemble.context
    waves = FourierSeries(count)(samples / data.ensemble.samples).T
    gram = (waves * np.einsum("rt,rt->t", angle, angle)) @ waves.T
    inverse = np.linalg.pinv(gram, hermitian=True)
    weights = inverse @ (waves @ np.einsum("rt,rt->t", angle, left))
    scores = ((left - angle * (weights @ waves)) * angle) @ waves.T @ inverse
    power, noise = (
        squares[1:].reshape(-1, 2).sum(axis=1)
        for squares in (weights**2, np.sum(scores**2, axis=0))
    )
    for parts, words in ((3, "three times"), (2, "twice")):
        own = np.arange(1, count + 1) % parts == 0
        repeats, differs = power[own].sum(), power[~own].sum()
        varies = repeats > (MIN_VARIATION * (steady[0] + weights[0])) ** 2
        is_noise = differs < min(MAX_DIFFERENCE**2 * repeats, MIN_POWER * noise[~own].sum())
        if varies and is_noise and repeats > MIN_POWER * noise[own].sum():
            return [
                f"stiffness repeats every {given / parts:.4g} s; what does not repeat, "
                f"{100 * math.sqrt(differs / repeats):.0f} % of its variation, is hardly more than "
                f"noise: cut with that period, there are {words} as many realizations, and the "
                f"random error is some {100 * (1 - parts**-0.5):.0f} % smaller (birf and kbr "
                "follow faster changes instead)"
            ]
    return []


def _trials(data: FittedEnsemble) -> list[NDArray[np.intp]]:
    """Return the realizations of each trial."""
    trials = np.asarray(data.ensemble.trials)
    return [np.flatnonzero(trials == number) for number in np.unique(trials)]


def _longest(data: FittedEnsemble) -> float:
    """Return the duration in s of the longest trial, as far as it was cut."""
    onsets = np.asarray(data.ensemble.onsets)
    return max(np.ptp(onsets[trial]) for trial in _trials(data)) + data.ensemble.duration


def lines(scores: Array, data: FittedEnsemble) -> tuple[Array, Array, Array]:
    """Return frequencies in Hz, power over that of realizations of random phase, and power.

    Each trial is put together and transformed at once. The power of single realizations follows
    from the sum of their autocorrelations. So memory and time grow with the record's length and no
    faster.
    """
    duration, rate, samples = data.ensemble.duration, data.rate, scores.shape[1]
    onsets = np.asarray(data.ensemble.onsets)
    needed = math.ceil(_longest(data) * rate / RESOLUTION) + 2 * samples
    length = next_fast_len(needed, real=True)
    frequencies = np.arange(length // 2 + 1) * rate / length
    top = min(MAX_CYCLES / duration, 0.25 * rate)
    shown = (frequencies >= MIN_CYCLES / duration) & (frequencies < top)
    power = np.zeros(int(shown.sum()))
    for trial in _trials(data):
        series = np.zeros(length)
        first = np.round((onsets[trial] - onsets[trial].min()) * rate).astype(np.int64)
        np.add.at(series, first[:, None] + np.arange(samples), scores[trial])
        power += np.abs(rfft(series)[shown]) ** 2
    own = np.sum(np.abs(rfft(scores, 2 * samples, axis=1)) ** 2, axis=0)
    correlation = irfft(own, 2 * samples)
    alone = 2 * rfft(correlation[:samples], length)[shown].real - correlation[0]
    alone = np.maximum(alone, np.finfo(float).tiny)
    return frequencies[shown], power / alone, power
