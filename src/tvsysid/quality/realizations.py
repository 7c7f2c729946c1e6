"""Check that all realizations share one behaviour: none drifts, differs or is misplaced."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from tvsysid.methods.cascade.reflex_test import MIN_TESTED_REALIZATIONS
from tvsysid.quality.checks import Measured, NotApplicable, check, indices
from tvsysid.quality.fit import SecondOrderFit, low_passed
from tvsysid.quality.fitted import FittedEnsemble
from tvsysid.quality.statistics import (
    FOLDS,
    SIGNIFICANT,
    is_mean_significant,
    is_significant,
    without,
)
from tvsysid.signals import Array

TINY = np.finfo(float).tiny
# Of outliers: robust standard deviations from the median, ratio to the usual noise, and smallest
# relative differences of stiffness and of the whole response.
MAX_DISTANCE, MIN_NOISE_RATIO, MIN_CHANGES = 6.0, 2.5, np.array([[0.3], [0.2]])
ROBUST = 1.4826  # standard deviations of Gaussian numbers per median absolute deviation
PARTS = 10  # of a realization that must show the same difference; neighbours share too much
NOISE_LOW_PASS_SAMPLES = 1.5  # after which realizations are compared
SHIFT_STEP_S, MIN_SHIFT_S = 0.02, 0.05
NOISE_WINDOW_S, MIN_NOISE_POWER = 0.1, 0.05  # the latter as a share of the mean
MIN_GAIN, MAX_SLOW_LEFT = 0.2, 0.5  # share of a residual that a shift must, and may not, explain
SLOW_LOW_PASS_SAMPLES = 2.5
MAX_MISALIGNED = 0.5  # share of realizations; if more fit better elsewhere, their place is right
MIN_VARIATION, MIN_REPEAT = 0.1, 0.7  # of stiffness: over its mean; correlation of odd and even


@check(
    "drift",
    "The behaviour drifts over the experiment",
    "stiffness of the second half minus that of the first, over the first",
    10,
    "%",
    effect="the result is a mean of different behaviours and describes none of them",
    remedy="identify the parts of the experiment separately; let people rest or warm up before",
)
def drift(data: FittedEnsemble) -> Measured:
    """Compare the stiffness of the second half with that of the first."""
    data.require(2 * MIN_TESTED_REALIZATIONS)
    grams, moments = data.fit.own_moments
    influences = [
        moments[half] @ np.linalg.pinv(grams[half].sum(axis=0), hermitian=True)[:, 0]
        for half in data.halves
    ]
    before, after = (1 + each.sum() for each in influences)
    error = math.sqrt(sum(len(each) * each.var(ddof=1) for each in influences))
    value = 100 * (after - before) / max(abs(before), 0.01)
    what = (
        f"the stiffness of the second half is {abs(value):.2g} % "
        f"{'higher' if value > 0 else 'lower'} than that of the first, ± {100 * error:.2g} %"
    )
    return Measured(value, what, is_significant(after - before, error, len(data)))


@check(
    "torque-offset",
    "The torque's offset drifts",
    "change of the realizations' mean from start to end, over the standard deviation about that "
    "mean",
    100,
    "%",
    effect="the drift counts as torque that the angle does not explain: the fits see much more "
    "noise",
    remedy="subtract a line, or components slower than a realization, from the recording before "
    "cutting; check the sensor",
    which="torque",
)
@check(
    "angle-offset",
    "The angle's offset drifts",
    "change of the realizations' mean from start to end, over the standard deviation about that "
    "mean",
    100,
    "%",
    effect="the drift counts as movement without a response: the stiffness comes out too low",
    remedy="subtract a line, or components slower than a realization, from the recording before "
    "cutting; check the sensor",
    which="angle",
)
def offset(data: FittedEnsemble, which: str) -> Measured:
    """Return the change of the realizations' means along a line, from the first to the last."""
    data.require(response=False)
    size = math.sqrt(data.core(which).var(axis=1).mean())
    if size == 0:
        raise NotApplicable(f"the {which} does not move")
    line, error = _drift_of_offset(data, which)
    change, unit = np.ptp(line) * np.sign(line[-1]), {"angle": "rad", "torque": "N·m"}[which]
    what = (
        f"the {which} moves by {change:+.2g} {unit} from the first realization to the last, ± "
        f"{error:.1g} {unit}"
    )
    return Measured(100 * abs(change) / size, what, is_significant(change, error, len(data)))


def _drift_of_offset(data: FittedEnsemble, which: str) -> tuple[Array, float]:
    """Return a line through the means of the realizations as recorded, and its rise's error."""
    means, place = data.core(which).mean(axis=1)[data.order], np.linspace(-0.5, 0.5, len(data))
    power = place @ place
    line = place @ means / power * place
    squares = np.sum((means - means.mean() - line) ** 2)
    return line, math.sqrt(squares / (len(data) - 2) / power)


def without_drifting_offsets(data: FittedEnsemble) -> FittedEnsemble:
    """Subtract a line from the offsets of angle and torque where they drift."""
    which = [name for name in ("angle", "torque") if data.finding(f"{name}-offset").found]
    back = np.argsort(data.order)
    steady = {
        name: data.ensemble.signal(name) - _drift_of_offset(data, name)[0][back, None]
        for name in which
    }
    return data.changed(**steady) if steady else data


@check(
    "unlike-realizations",
    "Some realizations are outliers",
    "realizations whose stiffness or noise lies far outside the scatter of the others",
    0,
    "realizations",
    effect="they count as much as the others and pull the result towards theirs",
    remedy="look at them and exclude them (ensemble.select; tv.preprocess.prepare does it for a "
    "task with a target)",
)
def unlike_realizations(data: FittedEnsemble) -> Measured:
    """Count realizations of other stiffness, response or noise that are not only misaligned."""
    data.require()
    fit, (grams, moments) = data.fit, data.fit.own_moments
    stiffness, noise = fit.relative_stiffness, fit.relative_noise
    whole = np.maximum(grams.sum(axis=(1, 2)), TINY)
    values = np.stack([stiffness, 1 + moments.sum(axis=1) / whole])
    distance = np.abs(values - np.median(values, axis=1, keepdims=True))
    # The stiffness of a realization that hardly moved, or is loud, is uncertain.
    inverse = np.linalg.pinv(grams, hermitian=True)[:, 0, 0]
    power = np.mean(fit.white_residual**2) * np.maximum(noise, 1) ** 2
    usual = ROBUST * np.median(distance, axis=1, keepdims=True)
    usual = np.maximum(usual, np.sqrt(power * [inverse, 1 / whole]))
    outlying = ((distance > MAX_DISTANCE * usual) & (distance > MIN_CHANGES)).any(axis=0)
    # Voluntary torque differs between realizations; the loudest of many is not unlike the others.
    level = np.log(np.maximum(noise, TINY))
    is_loud = level > MAX_DISTANCE * ROBUST * np.median(np.abs(level))
    outlying |= is_loud & (noise > MIN_NOISE_RATIO)
    outlying[list(data.finding("misaligned-realizations").realizations)] = False
    found = indices(outlying)
    what = f"{len(found)} of {len(data)} realizations are outliers"
    if found:
        first = found[0]
        what += (
            f", first realization {first}: stiffness {stiffness[first]:.2g}, noise "
            f"{noise[first]:.2g} times the usual"
        )
    return Measured(len(found), what, realizations=found)


@check(
    "scattered-realizations",
    "Realizations are of different behaviours",
    "standard deviation over realizations of the stiffness, beyond noise and drift, over the RMS "
    "of the stiffness",
    10,
    "%",
    effect="the result is a mean of different behaviours and describes none of them; bands do not "
    "show it",
    remedy="sort the realizations by what may differ (task, muscle activity, instruction), and "
    "identify each kind separately; if it was recorded, let the joint follow it (tvsysid identify "
    "… --scheduling CHANNEL)",
)
def scattered_realizations(data: FittedEnsemble) -> Measured:
    """Test whether stiffness differs between realizations by more than noise and drift.

    How far a realization's stiffness is from that of all is estimated in each tenth of its time.
    Noise differs from part to part. A realization of another behaviour differs in all parts, by
    the pattern in time of others that differ. So the products of two parts that are no neighbours,
    weighted by the pattern of other realizations, are on average the variance that is sought. The
    noise need not be known. The test is by their scatter over realizations. It holds for any number
    of realizations that differ, where a median breaks down at half of them.

    Realizations with another fault are left out. With a wrong period, each realization holds
    another part of the behaviour anyway.
    """
    misaligned = data.finding("misaligned-realizations")
    reported = data.finding("unlike-realizations").realizations
    reported += misaligned.realizations if misaligned.found else ()
    if data.finding("wrong-period").found:
        raise NotApplicable("the period is wrong")
    order = data.order[~np.isin(data.order, reported)]
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
    return np.asarray(np.add.reduceat(alone * left, edges, axis=1) / power)


def _shared_variances(change: Array) -> Array:
    """Return the variance of changes (realization, part) that parts share, (realization,)."""
    # A line and a step in the middle belong to the check for drift.
    place = np.linspace(-1, 1, len(change))
    slow = np.stack([np.ones_like(place), place, np.sign(place)], axis=1)
    change = change - slow @ np.linalg.lstsq(slow, change, rcond=None)[0]
    is_far = np.abs(np.subtract.outer(np.arange(PARTS), np.arange(PARTS))) > 1
    variances = np.empty(len(change))
    for out in np.array_split(np.arange(len(change)), FOLDS):
        others = np.delete(change, out, axis=0)
        pattern = np.linalg.eigh(is_far * (others.T @ others))[1][:, -1]
        weights = is_far * np.outer(pattern, pattern)
        products = np.einsum("rj,jl,rl->r", change[out], weights, change[out])
        variances[out] = products / (PARTS * np.sum(weights**2))
    return variances


@check(
    "misaligned-realizations",
    "Some realizations come early or late",
    "share of the realizations that fit clearly better when they are shifted",
    2,
    "%",
    effect="changes of stiffness are smeared over time, and peaks come out too low",
    remedy="align them before the mean is subtracted (tv.preprocess.align), or exclude them",
)
def misaligned_realizations(data: FittedEnsemble) -> Measured:
    """Return the share of realizations that the common behaviour explains better when shifted."""
    data.require()
    if not _varies(data.fit):
        raise NotApplicable("stiffness hardly varies within a realization, so that no shift shows")
    shifts, left, slowly_left = _left_by_shifts(data.fit)
    best, still = np.argmin(left, axis=0), len(shifts) // 2
    place = best, np.arange(len(data))
    gain = 1 - left[place] / np.maximum(left[still], TINY)
    seconds = shifts[best] / data.rate
    # Likelihood ratio for white noise of each realization's own level: the best of all shifts.
    samples = data.fit.white_residual.shape[1]
    log_ratio = 0.5 * samples * -np.log1p(-np.clip(gain, 0.0, 1 - 1e-12))
    is_clear = (gain > MIN_GAIN) & (log_ratio > math.log(left.size / SIGNIFICANT))
    is_clear &= slowly_left[place] < MAX_SLOW_LEFT * slowly_left[still]
    found = indices(is_clear & (np.abs(seconds) >= MIN_SHIFT_S))
    count = len(found)
    what = f"{count} of {len(data)} realizations fit better when shifted"
    if found:
        farthest = max(found, key=lambda each: abs(seconds[each]))
        what += f", such as realization {farthest} by {seconds[farthest]:+.2g} s"
    # One may fit better elsewhere by chance.
    significant = 1 < count < MAX_MISALIGNED * len(data)
    return Measured(100 * count / len(data), what, significant, found)


def _left_by_shifts(fit: SecondOrderFit) -> tuple[NDArray[np.int64], Array, Array]:
    """Return shifts of the common behaviour in samples, and the power that each leaves.

    The power has shape (shift, realization). The second is after a low-pass: equal filters of both
    channels leave hardly any noise at high frequency, where only the error of the fit shows.
    """
    change = fit.correction.impedance
    relative = np.pad(change, ((0, 0), (fit.whitening, 0)), "edge")
    behaviour = (fit.impedance * (1 + relative))[:2]
    rest = fit.torque - fit.parts[2] * (1 + change[2, 0])
    step = max(1, round(SHIFT_STEP_S * fit.rate))
    reach = behaviour.shape[1] // 4 // step
    shifts = np.arange(-reach, reach + 1) * step
    weights, left = 1 / _local_noise(fit), []
    for shift in shifts:
        shifted = np.roll(behaviour, shift, axis=1)
        error = fit.whitened(rest - np.einsum("at,art->rt", shifted, fit.motion[:2]))
        slow = low_passed(error, SLOW_LOW_PASS_SAMPLES)
        left.append([error**2 @ weights, slow**2 @ weights])
    return shifts, *np.swapaxes(left, 0, 1)


def _local_noise(fit: SecondOrderFit) -> Array:
    """Return the power of the whitened residual about each time, median over realizations.

    Voluntary torque may be louder at one time than at another. What few realizations do does not
    count.
    """
    size = min(max(1, round(NOISE_WINDOW_S * fit.rate)), fit.white_residual.shape[1])
    power = uniform_filter1d(fit.white_residual**2, size, axis=1, mode="nearest")
    usual = np.median(power, axis=0)
    return np.asarray(np.maximum(usual, MIN_NOISE_POWER * usual.mean() + TINY))


def _varies(fit: SecondOrderFit) -> bool:
    """Whether the stiffness varies over a realization, alike in odd and even realizations."""
    stiffness = fit.impedance[0]
    halves = [fit.of(slice(first, None, 2)).impedance[0] for first in (0, 1)]
    if min(map(np.std, halves)) == 0:
        return False
    varies = stiffness.std() >= MIN_VARIATION * abs(stiffness.mean())
    return bool(varies and np.corrcoef(*halves)[0, 1] > MIN_REPEAT)
