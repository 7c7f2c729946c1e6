"""Check whether the behaviour repeats with the period that was given."""

from __future__ import annotations

import math

import numpy as np
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
MAX_DIFFERENCE = 0.25  # RMS of what does not repeat, beyond noise, over that of what does
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
    if len(np.unique(data.ensemble.trials)) == len(data):
        raise NotApplicable("each realization is a trial of its own")
    data.require(MIN_TESTED_REALIZATIONS)
    given, longest, fit = data.ensemble.duration, _longest(data), data.fit
    frequencies, coherent, power = lines(fit.correction.residual * fit.white_parts[0], data)
    # Inertia is constant. A line that is even stronger in it is a PRBS' clock beating with the
    # sampling.
    beating = lines(fit.correction.residual * fit.white_parts[2], data)[1]
    width = 2 * round(1 / RESOLUTION) + 1
    is_beat = uniform_filter1d(beating, width) > BEAT_RATIO * uniform_filter1d(coherent, width)
    cycles = frequencies * given
    beside = np.abs(cycles - np.round(cycles)) * longest / given
    is_harmonic = beside < (NEAR_DRIFTING if data.finding("drift").found else NEAR)
    coherent[is_beat | is_harmonic] = 0
    amplitude = 200 * np.sqrt(power) / np.sum(fit.white_parts[0] ** 2)
    best = int(np.argmax(np.where(coherent > 1, amplitude, 0.0)))
    chance = max(0.0, 1 - coherent[best] / len(data)) ** (len(data) - 1)
    chance *= max(1.0, len(frequencies) * RESOLUTION)  # of independent frequencies
    what = f"stiffness varies by {amplitude[best]:.2g} % of its mean with "
    what += _described_period(frequencies[best], given, longest)
    return Measured(amplitude[best], what, chance < SIGNIFICANT)


def _described_period(frequency: float, given: float, longest: float) -> str:
    """Describe the period of a line beside the given one."""
    # A line near a harmonic is that harmonic of a period near the given one.
    number = max(1, round(frequency * given))
    is_near = abs(frequency * given - number) < NEAR_HARMONIC * number
    period = (number if is_near else 1) / frequency
    digits = next((n for n in range(3, 6) if f"{period:.{n}g}" != f"{given:.{n}g}"), 6)
    what = f"{period:.{digits}g} s, beside what repeats every {given:g} s"
    ratio, side = max((period / given, "higher"), (given / period, "lower"))
    if round(ratio) > 1 and abs(ratio / round(ratio) - 1) < 1.5 * period / longest:
        what += (
            f"; if that should be {given:g} s, the sampling rate is {round(ratio)} times {side} "
            "than stated"
        )
    return what


def shorter_period(data: FittedEnsemble) -> list[str]:
    """Return a remark if the stiffness repeats with a third or a half of the period.

    Harmonics of the stiffness that the shorter period has make up what repeats, the others what
    does not. Their noise is half the difference between odd and even realizations.
    """
    given, fit = data.ensemble.duration, data.fit
    if len(data) < MIN_TESTED_REALIZATIONS or fit.explained < MIN_EXPLAINED:
        return []
    count = min(MAX_HARMONICS, int(MAX_CHANGE_HZ * given))
    halves = [fit.of(slice(first, None, 2)).impedance[0] for first in (0, 1)]
    waves = FourierSeries(count)(data.time / given)
    odd, even = np.linalg.lstsq(waves, np.transpose(halves), rcond=None)[0].T / 2
    power, noise = (
        np.sum(each[1:].reshape(-1, 2) ** 2, axis=1) for each in (odd + even, odd - even)
    )
    for parts, words in ((3, "three times"), (2, "twice")):
        own = np.arange(1, count + 1) % parts == 0
        repeats, differs = power[own].sum(), power[~own].sum()
        by_chance, other_chance = (noise.mean() * each.sum() for each in (own, ~own))
        varies = repeats > max((MIN_VARIATION * (odd[0] + even[0])) ** 2, MIN_POWER * by_chance)
        is_noise = differs < min(
            other_chance + MAX_DIFFERENCE**2 * repeats, MIN_POWER * other_chance
        )
        if varies and is_noise:
            return [
                f"stiffness repeats every {given / parts:.4g} s; what does not repeat, "
                f"{100 * math.sqrt(differs / repeats):.0f} % of its variation, is hardly more than "
                f"noise: cut with that period, there are {words} as many realizations, and the "
                f"random error is some {100 * (1 - parts**-0.5):.0f} % smaller (birf and kbr "
                "follow faster changes instead)"
            ]
    return []


def _longest(data: FittedEnsemble) -> float:
    """Return the duration in s of the longest trial, as far as it was cut."""
    onsets, trials = data.ensemble.onsets, data.ensemble.trials
    longest = max(np.ptp(onsets[trials == trial]) for trial in trials)
    return float(longest + data.ensemble.duration)


def lines(scores: Array, data: FittedEnsemble) -> tuple[Array, Array, Array]:
    """Return frequencies in Hz, power over that of realizations of random phase, and power.

    Each trial is put together and transformed at once. The power of single realizations follows
    from the sum of their autocorrelations. So memory and time grow with the record's length and no
    faster.
    """
    duration, rate, samples = data.ensemble.duration, data.rate, scores.shape[1]
    onsets, trials = data.ensemble.onsets, data.ensemble.trials
    needed = math.ceil(_longest(data) * rate / RESOLUTION) + 2 * samples
    length = next_fast_len(needed, real=True)
    frequencies = np.arange(length // 2 + 1) * rate / length
    top = min(MAX_CYCLES / duration, 0.25 * rate)
    shown = (frequencies >= MIN_CYCLES / duration) & (frequencies < top)
    power = np.zeros(np.count_nonzero(shown))
    for trial in np.unique(trials):
        own, series = trials == trial, np.zeros(length)
        first = np.round((onsets[own] - onsets[own].min()) * rate).astype(np.int64)
        np.add.at(series, first[:, None] + np.arange(samples), scores[own])
        power += np.abs(rfft(series)[shown]) ** 2
    squares = np.sum(np.abs(rfft(scores, 2 * samples, axis=1)) ** 2, axis=0)
    correlation = irfft(squares, 2 * samples)
    alone = 2 * rfft(correlation[:samples], length)[shown].real - correlation[0]
    return frequencies[shown], power / np.maximum(alone, np.finfo(float).tiny), power
