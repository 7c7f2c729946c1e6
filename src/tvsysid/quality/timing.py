"""Whether the behaviour stays the same, and repeats with the period that was given."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.ndimage import uniform_filter1d

from tvsysid.methods.cascade.reflex_test import MIN_TESTED_REALIZATIONS
from tvsysid.quality.fitted import (
    ANSWERED,
    NO_ANSWER,
    NOT_SEPARATE,
    FittedEnsemble,
    NotJudged,
    Seen,
)
from tvsysid.quality.statistics import SIGNIFICANT, p_value
from tvsysid.signals import Array

SLOWEST, FASTEST = (
    0.3,
    3.3,
)  # cycles in a realization that may be another period: the clock of a PRBS is faster
BEAT = 1.25  # times as coherent in the inertia as in the stiffness that a line is no behaviour
# Distance from a harmonic, in one over the record's length, where no line is another period; so if
# all drifts.
BESIDE, BESIDE_DRIFT = 0.2, 4.0
NEAR_HARMONIC = 0.1  # share of a harmonic's number by which a line may be off it
RESOLUTION = 0.25  # step in frequency, as a share of one over the record's length
# Harmonics of stiffness by which it repeats within a realization, and Hz: a perturbation's lines
# beat faster.
MOST_HARMONICS, FASTEST_CHANGE = 12, 3.0
# RMS of what does not repeat there, over that of what does: of a constant both are noise, and alike
ALIKE = 0.25
LEAST_VARIATION = 0.05  # RMS of what repeats over the mean stiffness
BEYOND_NOISE = 5.0  # power of what repeats over that of its noise


def drift(data: FittedEnsemble) -> Seen:
    """Stiffness of the second half against that of the first, in the order of recording."""
    data.require(2 * MIN_TESTED_REALIZATIONS, answer=False)
    if data.explained < ANSWERED:
        return _contradiction(data)
    grams, moments = data.own_fits
    halves = []
    for half in data.half_orders:
        influence = moments[half] @ np.linalg.pinv(grams[half].sum(axis=0), hermitian=True)[:, 0]
        halves.append((1 + influence.sum(), len(half) * influence.var(ddof=1)))
    (first, first_variance), (second, second_variance) = halves
    change, error = second - first, math.sqrt(first_variance + second_variance)
    value = 100 * change / max(abs(first), 0.01)
    what = (
        f"the stiffness of the second half is {abs(value):.2g} % "
        f"{'higher' if change > 0 else 'lower'} than that of "
        f"the first, ± {100 * error:.2g} %"
    )
    return Seen(value, what, p_value(change, error, len(data)) < SIGNIFICANT)


def _contradiction(data: FittedEnsemble) -> Seen:
    """Whether the halves answer and contradict each other, as when a sign was turned in between."""
    if min(half.explained for half in data.halves) < ANSWERED:
        raise NotJudged(NO_ANSWER)
    (before, first_error), (after, second_error) = (
        (float(values[0]), float(errors[0]))
        for values, errors in (half.mean_impedance for half in data.halves)
    )
    if not math.isfinite(after - before):
        raise NotJudged(NOT_SEPARATE)
    error = math.hypot(first_error, second_error)
    value = 100 * (after - before) / max(abs(before), np.finfo(float).tiny)
    what = (
        f"the stiffness is {before:.3g} N·m/rad in the first half and {after:.3g} in the "
        f"second, ± {error:.2g}"
    )
    return Seen(value, what, p_value(after - before, error, len(data)) < SIGNIFICANT)


def wrong_period(data: FittedEnsemble, drifts: bool) -> Seen:
    """Stiffness that varies with a frequency of which no whole number fits into a realization.

    What the fit left is projected on the torque of stiffness at each sample; a line in that
    series between the harmonics of the period is a behaviour of another period. The series has
    no part at the harmonics only if it is of the signals that were fitted: as they are whitened,
    stiffness and viscosity are fitted again, for the first fit's error, which slow noise makes
    large, is the same in all realizations. The test compares the power of a line with that of
    realizations of random phase. No line is looked for near the harmonics of a behaviour that
    ``drifts``.
    """
    ensemble, trials = data.ensemble, _trials(data)
    if len(trials) == len(data):
        raise NotJudged("each realization is a trial of its own")
    data.require(MIN_TESTED_REALIZATIONS)
    left = data.white_fit.residual
    frequencies, coherent, power = lines(left * data.white_parts[0], data)
    # An inertia is constant: a line that shows in it even more is the beat of a PRBS' clock with
    # the sampling.
    _, beating, _ = lines(left * data.white_parts[2], data)
    width = 2 * round(1 / RESOLUTION) + 1
    beat = uniform_filter1d(beating, width) > BEAT * uniform_filter1d(coherent, width)
    cycles = frequencies * ensemble.duration
    beside = np.abs(cycles - np.round(cycles)) * _longest(data, trials) / ensemble.duration
    coherent = np.where(beat | (beside < (BESIDE_DRIFT if drifts else BESIDE)), 0.0, coherent)
    amplitude = 200 * np.sqrt(power) / float(np.sum(data.white_parts[0] ** 2))
    best = int(np.argmax(np.where(coherent > 1, amplitude, 0.0)))
    independent = max(1.0, len(frequencies) * RESOLUTION)
    probability = independent * max(0.0, 1 - float(coherent[best]) / len(data)) ** (len(data) - 1)
    # A line near a harmonic is that harmonic of a period near the one that was given.
    number = max(1, round(float(cycles[best])))
    number = number if abs(float(cycles[best]) - number) < NEAR_HARMONIC * number else 1
    period, given = number / float(frequencies[best]), ensemble.duration
    digits = next((n for n in range(3, 6) if f"{period:.{n}g}" != f"{given:.{n}g}"), 6)
    what = (
        f"stiffness varies by {amplitude[best]:.2g} % of its mean with {period:.{digits}g} s, "
        "beside what "
        f"repeats every {given:g} s"
    )
    ratio = period / given
    factor = max(ratio, 1 / ratio)
    if round(factor) > 1 and abs(factor / round(factor) - 1) < 1.5 * period / _longest(
        data, trials
    ):
        side = "higher" if ratio > 1 else "lower"
        what += (
            f"; if that should be {given:g} s, the sampling rate is {round(factor)} times "
            f"{side} than stated"
        )
    return Seen(float(amplitude[best]), what, probability < SIGNIFICANT)


def shorter_period(data: FittedEnsemble) -> tuple[str, ...]:
    """Report whether the stiffness repeats itself with a third or a half of the period.

    The text says what segments of that length gain. Harmonics of stiffness are fitted to the
    realization, not whitened, as that takes its beginning away. Those that such a period has make
    up what repeats, the others what does not.
    """
    ensemble, fit, given = data.ensemble, data.fit, data.ensemble.duration
    count = min(MOST_HARMONICS, int(FASTEST_CHANGE * given))
    if len(data) < MIN_TESTED_REALIZATIONS or data.explained < ANSWERED:
        return ()
    angle, (steady, _) = fit.motion[0], data.mean_impedance
    left = fit.torque - np.tensordot(steady, fit.motion, 1)
    phase = (
        2
        * np.pi
        * (np.arange(fit.torque.shape[1]) + fit.first - ensemble.context)
        / ensemble.samples
    )
    numbers = np.arange(1, count + 1)
    waves = np.concatenate(
        [f(numbers[:, None] * phase) for f in (np.cos, np.sin)] + [np.ones((1, len(phase)))]
    )
    inverse = np.linalg.pinv(
        (waves * np.einsum("rt,rt->t", angle, angle)) @ waves.T, hermitian=True
    )
    found = inverse @ (waves @ np.einsum("rt,rt->t", angle, left))
    influence = ((left - angle * (found @ waves)) * angle) @ waves.T @ inverse
    power, noise = (
        values[:-1].reshape(2, -1).sum(axis=0)
        for values in (found**2, np.sum(influence**2, axis=0))
    )
    for parts, words in ((3, "three times"), (2, "twice")):
        own = numbers % parts == 0
        repeats, differs = float(power[own].sum()), float(power[~own].sum())
        varies = math.sqrt(repeats / 2) > LEAST_VARIATION * abs(float(steady[0] + found[-1]))
        same = differs < min(ALIKE**2 * repeats, BEYOND_NOISE * noise[~own].sum())
        if varies and same and repeats > BEYOND_NOISE * noise[own].sum():
            share = 100 * math.sqrt(differs / repeats)
            return (
                f"stiffness repeats every {given / parts:.4g} s; what does not repeat, "
                f"{share:.0f} % of its variation, "
                f"is hardly more than noise: cut with that period, there are {words} as many "
                "realizations, and the "
                f"random error is some {100 * (1 - parts**-0.5):.0f} % smaller (birf and kbr "
                "follow faster changes "
                "instead)",
            )
    return ()


def _trials(data: FittedEnsemble) -> list[NDArray[np.intp]]:
    """Realizations of each trial."""
    trials = np.asarray(data.ensemble.trials)
    return [np.flatnonzero(trials == number) for number in np.unique(trials)]


def _longest(data: FittedEnsemble, trials: list[NDArray[np.intp]]) -> float:
    """Seconds from the first realization of a trial to the end of its last, of the longest."""
    onsets = np.asarray(data.ensemble.onsets)
    return max(float(np.ptp(onsets[trial])) for trial in trials) + data.ensemble.duration


def lines(scores: Array, data: FittedEnsemble) -> tuple[Array, Array, Array]:
    """Frequencies in Hz; power of trials over that of realizations of random phase.

    And power of trials.

    Trials are put together and transformed at once; the power of single realizations follows
    from the sum of their autocorrelations, so that memory and time grow with the record's length
    and no faster.
    """
    duration, rate, trials, samples = (
        data.ensemble.duration,
        data.rate,
        _trials(data),
        scores.shape[1],
    )
    onsets = np.asarray(data.ensemble.onsets)
    length = next_fast_len(
        math.ceil(_longest(data, trials) * rate / RESOLUTION) + 2 * samples, real=True
    )
    frequencies = np.arange(length // 2 + 1) * rate / length
    looked = (frequencies >= SLOWEST / duration) & (
        frequencies < min(FASTEST / duration, 0.25 * rate)
    )
    together = np.zeros(int(looked.sum()))
    for trial in trials:
        series = np.zeros(length)
        first = np.round((onsets[trial] - onsets[trial].min()) * rate).astype(np.int64)
        np.add.at(series, first[:, None] + np.arange(samples), scores[trial])
        together += np.abs(rfft(series)[looked]) ** 2
    own = np.sum(np.abs(rfft(scores, 2 * samples, axis=1)) ** 2, axis=0)
    correlation = irfft(own, 2 * samples)
    apart = np.zeros(length)
    apart[:samples] = correlation[:samples]
    apart[length - samples + 1 :] = correlation[samples + 1 :]
    alone = np.maximum(rfft(apart)[looked].real, np.finfo(float).tiny)
    return frequencies[looked], together / alone, together
