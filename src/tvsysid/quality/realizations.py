"""Check that all realizations share one movement: none drifts, differs or is misplaced."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len
from scipy.ndimage import uniform_filter1d

from tvsysid.methods.cascade.reflex_test import MIN_TESTED_REALIZATIONS
from tvsysid.quality.checks import Measured, NotApplicable, check, indices
from tvsysid.quality.fit import SI_UNITS, FittedEnsemble, SecondOrderFit, low_passed
from tvsysid.quality.statistics import (
    FOLDS,
    SIGNIFICANT,
    TINY,
    is_mean_significant,
    is_significant,
    without,
)
from tvsysid.signals import Array, Ensemble

# Of outliers: distance from the median in robust standard deviations, ratio to the usual noise, and
# smallest relative differences of the stiffness and of the whole response.
MAX_DISTANCE, MIN_NOISE_RATIO, MIN_CHANGE, MIN_RESPONSE_CHANGE = 6.0, 2.5, 0.3, 0.2
ROBUST = 1.4826  # standard deviations of Gaussian numbers per median absolute deviation
PARTS = 10  # of a realization; only parts that are not neighbours have independent noise
NOISE_LOW_PASS_SAMPLES = 1.5  # after which realizations are compared
SHIFT_STEP, MIN_STEPS = 2, 3  # step of shifts in samples, and least shift in steps
SHIFT_LOW_PASS_SAMPLES = 2.5
# Shares of the residual's power that the right shift may leave, and after a low-pass.
MAX_LEFT = np.array([[0.8], [0.5]])
MIN_REPEAT = 0.7  # correlation of the stiffness in odd and even realizations
# Cycles per realization that may be another period; the clock of a PRBS is faster.
MIN_CYCLES, MAX_CYCLES = 0.3, 3.3
RESOLUTION = 0.25  # step in frequency, times the record's length
# Distance from a harmonic, times the record's length, within which a line is no other period. The
# second is for a movement that drifts.
MIN_DISTANCE, MIN_DISTANCE_DRIFTING = 0.2, 4.0
# Share of a harmonic's number within which a period near the given one is named
HARMONIC_TOLERANCE = 0.1
BEAT_RATIO = 1.25  # of a line in the inertia to the same in the stiffness: a beat, no movement


@check(
    "drift",
    "Stiffness drifts over the experiment",
    "change of stiffness from the first half to the second, with one factor for all times",
    10,
    "%",
    "doubtful",
    effect="the result is a mean of different stiffnesses and describes none of them",
    remedy="identify the parts of the experiment separately, as in "
    "tv.compare(prepared.ensemble.select(range(30))); let people rest or warm up before",
)
def drift(data: FittedEnsemble) -> Measured:
    """Compare the stiffness of the second half with that of the first."""
    data.require(2 * MIN_TESTED_REALIZATIONS)
    grams, moments, _ = data.fit.own_moments
    influences = [
        moments[half] @ np.linalg.pinv(grams[half].sum(axis=0), hermitian=True)[:, 0]
        for half in data.halves
    ]
    before, after = (1 + each.sum() for each in influences)
    error = math.sqrt(sum(len(each) * each.var(ddof=1) for each in influences))
    value = 100 * (after - before) / max(abs(before), 0.01)
    what = (
        f"with one factor for all times, stiffness changes by {value:+.2g} ± {100 * error:.2g} % "
        "from the first half to the second"
    )
    return Measured(value, what, is_significant(after - before, error, len(data)))


@check(
    "torque-offset",
    "The torque's offset drifts",
    "change of the realizations' mean from start to end, over the standard deviation about that "
    "mean",
    100,
    "%",
    "minor",
    effect="the drift counts as noise: as torque that the angle does not explain",
    remedy="subtract a line or slow components from the recording before cutting; check the sensor",
    which="torque",
)
@check(
    "angle-offset",
    "The angle's offset drifts",
    "change of the realizations' mean from start to end, over the standard deviation about that "
    "mean",
    100,
    "%",
    "minor",
    effect="the drift counts as movement without a response: the stiffness comes out too low",
    remedy="subtract a line or slow components from the recording before cutting; check the sensor",
    which="angle",
)
def offset(data: FittedEnsemble, which: str) -> Measured:
    """Return the change of the realizations' means along a line, from the first to the last."""
    data.require(response=False)
    size = math.sqrt(data.core(which).var(axis=1).mean())
    line, error = _drift_of_offset(data, which)
    change, unit = line[-1] - line[0], SI_UNITS[which]
    what = (
        f"the {which} moves by {change:+.2g} {unit} from the first realization to the last, ± "
        f"{error:.1g} {unit}"
    )
    value = 100 * abs(change) / max(size, TINY)
    return Measured(value, what, is_significant(change, error, len(data)))


def _drift_of_offset(data: FittedEnsemble, which: str) -> tuple[Array, float]:
    """Return a line through the means in the order of recording, and the error of its rise."""
    means = data.core(which).mean(axis=1)[data.order]
    place = np.linspace(-0.5, 0.5, len(data))
    power = place @ place
    line = place @ means / power * place
    squares = np.sum((means - means.mean() - line) ** 2)
    return line, math.sqrt(squares / (len(data) - 2) / power)


def without_drifting_offsets(data: FittedEnsemble) -> FittedEnsemble:
    """Subtract a line from the offsets of angle and torque where they drift."""
    back = np.argsort(data.order)
    return data.changed(
        **{
            name: data.ensemble.signal(name) - _drift_of_offset(data, name)[0][back, None]
            for name in ("angle", "torque")
            if data.finding(f"{name}-offset").found
        }
    )


@check(
    "unlike-realizations",
    "Some realizations are outliers",
    "realizations whose stiffness or noise lies far outside the scatter of the others",
    0,
    "realizations",
    "minor",
    effect="they count as much as the others and pull the result towards theirs",
    remedy="look at them and exclude them (ensemble.select; for a task with a target, "
    "tv.preprocess.prepare_experiment does it)",
)
def unlike_realizations(data: FittedEnsemble) -> Measured:
    """Count realizations of other stiffness, response or noise that are not only misaligned."""
    data.require()
    fit, noise = data.fit, data.fit.relative_noise
    grams, moments, inverses = fit.own_moments
    whole = np.maximum(grams.sum(axis=(1, 2)), TINY)
    # The stiffness of a realization that hardly moved, or is loud, is uncertain.
    error = np.sqrt(np.mean(fit.white_residual**2)) * np.maximum(noise, 1)
    uncertainty = error * np.sqrt(inverses[:, 0, 0])
    response = 1 + moments.sum(axis=1) / whole
    # Voluntary torque differs between realizations; the loudest of many is not unlike the others.
    level = np.log(np.maximum(noise, TINY))
    outlying = _is_outlying(fit.relative_stiffness, MIN_CHANGE, uncertainty)
    outlying |= _is_outlying(response, MIN_RESPONSE_CHANGE, error / np.sqrt(whole))
    outlying |= _is_outlying(level, math.log(MIN_NOISE_RATIO))
    outlying[list(data.finding("misaligned-realizations").realizations)] = False
    found = indices(outlying)
    what = f"{len(found)} of {len(data)} realizations are outliers"
    return Measured(len(found), what, realizations=found)


def _is_outlying(values: Array, least: float, errors: Array | float = 0.0) -> NDArray[np.bool_]:
    """Whether values are farther from the median than scatter, errors and ``least`` allow."""
    distance = np.abs(values - np.median(values))
    usual = np.maximum(ROBUST * np.median(distance), errors)
    return distance > np.maximum(MAX_DISTANCE * usual, least)


@check(
    "scattered-realizations",
    "Realizations are of different movements",
    "standard deviation over realizations of the stiffness, beyond noise and drift, over the RMS "
    "of the stiffness",
    10,
    "%",
    "doubtful",
    effect="the result is a mean of different movements and describes none; bands do not show it",
    remedy="sort the realizations by what may differ (task, muscle activity, instruction), and "
    "identify each kind separately; if the cause was recorded, identify stiffness as a function of "
    "it (tvsysid identify … --scheduling CHANNEL)",
)
def scattered_realizations(data: FittedEnsemble) -> Measured:
    """Test whether stiffness differs between realizations by more than noise and drift.

    The deviation of each realization's stiffness from the mean is estimated in ten parts of time. A
    realization of another movement deviates in all parts, in a pattern that such realizations
    share. Noise of parts that are not neighbours is independent. So the mean product of two such
    parts, weighted by the pattern of the other realizations, is the variance beyond noise. It is
    tested by its scatter over realizations. This holds for any number of realizations that differ,
    where a median breaks down at half of them. Outliers are left out.
    """
    if data.finding("wrong-period").found:
        raise NotApplicable("the period is wrong")
    outliers = data.finding("unlike-realizations").realizations
    order = data.order[~np.isin(data.order, outliers)]
    if len(order) < 2 * MIN_TESTED_REALIZATIONS:
        raise NotApplicable(f"it takes {2 * MIN_TESTED_REALIZATIONS} realizations")
    variances = _shared_variances(_stiffness_changes(data.fit)[order])
    variance = max(0.0, variances.mean())
    significant = variance > 0 and is_mean_significant(variances)
    if not significant:  # realizations of opposite sign leave no mean response
        data.require()
    size = math.sqrt(np.mean(data.fit.impedance[0] ** 2) + variance)
    value = 100 * math.sqrt(variance) / max(size, TINY)
    what = (
        f"beyond noise and drift, the stiffness differs by {value:.2g} % (standard deviation) "
        "between realizations"
    )
    return Measured(value, what, significant)


def _stiffness_changes(fit: SecondOrderFit) -> Array:
    """Return how far stiffness is from that of all in N·m/rad, shape (realization, part)."""
    # Near half the sampling rate the error of the fit follows the switches of a PRBS, whose clock
    # beats with the sampling.
    motion, left = (
        low_passed(each, NOISE_LOW_PASS_SAMPLES)
        for each in (fit.whitened(fit.motion), fit.white_residual)
    )
    alone = without(motion[0], motion[1:])
    edges = np.linspace(0, alone.shape[1], PARTS, endpoint=False).astype(np.int64)
    power = np.add.reduceat(np.mean(alone * motion[0], axis=0), edges)
    if power.min() <= 0:
        raise NotApplicable("the angle does not move at all times")
    return np.add.reduceat(alone * left, edges, axis=1) / power


def _shared_variances(change: Array) -> Array:
    """Return the variance of changes (realization, part) that parts share, (realization,)."""
    # A line and a step in the middle belong to the check for drift.
    place = np.linspace(-1, 1, len(change))
    slow = np.stack([np.ones_like(place), place, np.sign(place)], axis=1)
    change = change - slow @ np.linalg.lstsq(slow, change, rcond=None)[0]
    parts = np.arange(PARTS)
    is_far = np.abs(np.subtract.outer(parts, parts)) > 1
    variances = np.empty(len(change))
    for out in np.array_split(np.arange(len(change)), FOLDS):
        others = np.delete(change, out, axis=0)
        pattern = np.linalg.eigh(is_far * (others.T @ others))[1][:, -1]
        scores = change[out] * pattern
        products = np.sum(scores @ is_far * scores, axis=1)
        variances[out] = products / (PARTS * (pattern**2 @ is_far @ pattern**2))
    return variances


@check(
    "misaligned-realizations",
    "Some realizations come early or late",
    "share of the realizations that fit clearly better when they are shifted",
    2,
    "%",
    "doubtful",
    effect="changes of stiffness are smeared over time, and peaks come out too low",
    remedy="align them before the mean is subtracted (tv.preprocess.align), or exclude them",
)
def misaligned_realizations(data: FittedEnsemble) -> Measured:
    """Return the share of realizations that the common movement explains better when shifted.

    Equal filters of both channels leave hardly any noise at high frequency, where only the error
    of the fit shows. So a shift must also show after a low-pass.
    """
    data.require()
    fit = data.fit
    odd, even = (fit.of(slice(first, None, 2)).impedance[0] for first in (0, 1))
    if np.corrcoef(odd, even)[0, 1] < MIN_REPEAT:
        raise NotApplicable("stiffness hardly varies within a realization, so that no shift shows")
    rest = fit.torque - fit.parts[2]
    reach = fit.torque.shape[1] // 4 // SHIFT_STEP
    left = []
    for step in range(-reach, reach + 1):
        shifted = np.roll(fit.impedance[:2], step * SHIFT_STEP, axis=1)
        error = fit.whitened(rest - np.einsum("at,art->rt", shifted, fit.motion[:2]))
        slow = low_passed(error, SHIFT_LOW_PASS_SAMPLES)
        left.append([np.sum(error**2, axis=1), np.sum(slow**2, axis=1)])
    fits = np.asarray((np.array(left) < MAX_LEFT * left[reach]).all(axis=1))
    fits[reach - MIN_STEPS + 1 : reach + MIN_STEPS] = False
    found = indices(fits.any(axis=0))
    what = f"{len(found)} of {len(data)} realizations fit better when shifted"
    # One may fit better elsewhere by chance.
    return Measured(100 * len(found) / len(data), what, len(found) > 1, found)


@check(
    "wrong-period",
    "The movement does not repeat with this period, or the sampling rate is wrong",
    "variation of the stiffness with another period, as a share of the mean",
    10,
    "%",
    "invalid",
    effect="each realization holds another part of the movement; the time variation averages out",
    remedy="cut with the period that is named here, if there is one, or sort realizations by what "
    "the stiffness depends on; check the sampling rate: half of the true rate doubles the "
    "period",
)
def wrong_period(data: FittedEnsemble) -> Measured:
    """Find stiffness that varies with a period of which no whole number fits a realization.

    The residual is projected on the torque of stiffness at each sample. A line in that series
    between harmonics of the period is a movement of another period. Only the residual of the
    signals that were fitted has no power at the harmonics. So stiffness and viscosity are fitted
    again to the whitened signals. The test compares the power of a line with that of realizations
    of random phase. Near the harmonics of a movement that drifts, no line is looked for.
    """
    ensemble, fit, count = data.ensemble, data.fit, len(data)
    data.require()
    left = SecondOrderFit(fit.white_parts, fit.white_residual).residual
    frequencies, coherent, power = lines(left * fit.white_parts[0], ensemble)
    # Inertia is constant. A line that is even stronger in it is a PRBS' clock beating with the
    # sampling.
    beating = lines(left * fit.white_parts[2], ensemble)[1]
    width = 2 * round(1 / RESOLUTION) + 1
    is_beat = uniform_filter1d(beating, width) > BEAT_RATIO * uniform_filter1d(coherent, width)
    given = ensemble.duration
    beside = np.abs(frequencies - np.round(frequencies * given) / given) * _longest(ensemble)
    is_harmonic = beside < (MIN_DISTANCE_DRIFTING if data.finding("drift").found else MIN_DISTANCE)
    coherent[is_beat | is_harmonic] = 0
    amplitude = 200 * np.sqrt(power) / np.sum(fit.white_parts[0] ** 2)
    best = int(np.argmax(np.where(coherent > 1, amplitude, 0.0)))
    chance = max(0.0, 1 - coherent[best] / count) ** (count - 1)
    chance *= max(1.0, len(frequencies) * RESOLUTION)  # of independent frequencies
    what = (
        f"stiffness varies by {amplitude[best]:.2g} % of its mean with a period of "
        f"{_period(frequencies[best], given):.3g} s, beside what repeats every {given:g} s"
    )
    return Measured(amplitude[best], what, chance < SIGNIFICANT)


def _period(frequency: float, given: float) -> float:
    """Return the period of a line in s; near a harmonic it is one near the given period."""
    number = max(1, round(frequency * given))
    is_near = abs(frequency * given - number) < HARMONIC_TOLERANCE * number
    return (number if is_near else 1) / frequency


def _longest(ensemble: Ensemble) -> float:
    """Return the duration in s of the longest trial, as far as it was cut."""
    trials = ensemble.trials
    spans = (np.ptp(ensemble.onsets[trials == trial]) for trial in np.unique(trials))
    return float(max(spans) + ensemble.duration)


def lines(scores: Array, ensemble: Ensemble) -> tuple[Array, Array, Array]:
    """Return frequencies in Hz, power over that of realizations of random phase, and power.

    The scores have shape (realization, time). The realizations of a trial are transformed together,
    each turned by its onset. The frequencies are few: some cycles per realization.
    """
    duration = ensemble.duration
    rate = ensemble.sampling_rate
    samples = scores.shape[1]
    needed = math.ceil(_longest(ensemble) * rate / RESOLUTION) + 2 * samples
    frequencies = np.arange(needed) * rate / next_fast_len(needed, real=True)
    top = min(MAX_CYCLES / duration, 0.25 * rate)
    frequencies = frequencies[(frequencies >= MIN_CYCLES / duration) & (frequencies < top)]
    turns = -2j * np.pi * frequencies
    spectra = scores @ np.exp(np.outer(np.arange(samples) / rate, turns))
    alone = np.sum(np.abs(spectra) ** 2, axis=0)
    spectra *= np.exp(np.outer(np.round(ensemble.onsets * rate) / rate, turns))
    is_of_trial = ensemble.trials == np.unique(ensemble.trials)[:, None]
    power = np.sum(np.abs(is_of_trial @ spectra) ** 2, axis=0)
    return frequencies, power / np.maximum(alone, TINY), power
