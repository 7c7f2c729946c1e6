"""Check that realizations share one behaviour: none is offset, repeated, unlike or misplaced."""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import gaussian_filter1d, uniform_filter1d

from tvsysid.methods.cascade.reflex_test import MIN_TESTED_REALIZATIONS
from tvsysid.quality import statistics
from tvsysid.quality.fitted import ANSWERED, NO_ANSWER, FittedEnsemble, NotJudged, Seen, indices
from tvsysid.quality.statistics import (
    FOLDS,
    SIGNIFICANT,
    p_value,
    p_value_of,
    without,
)
from tvsysid.signals import Array

UNITS = {"angle": "rad", "torque": "N·m"}
FAR_OUT = (
    6.0  # robust standard deviations from the median at which a realization is unlike the others
)
OTHER_STIFFNESS = (
    0.3  # smallest relative difference in stiffness that makes a realization unlike the others
)
OTHER_ANSWER = 0.2  # the same for the whole torque's size
OTHER_NOISE = 1.7  # times the usual noise, whitened, that does, if few of the others come near it
SHIFT_STEP, SHORTEST_SHIFT = 0.02, 0.05  # in s
# digits after the point of values over their standard deviation that are alike in the same
# realizations
ROUNDED = 9
ABOUT = 0.1  # seconds over which the noise about a time is averaged
QUIETEST = 0.05  # share of the mean noise that no time is taken to have less of
BETTER, HALF = (
    0.2,
    0.5,
)  # shares of a realization's residual that a shift must take away; of its low-passed one
MOST = 0.5  # share of the realizations beyond which it is not misalignment
# correlation between the behaviour of odd and even realizations from which on it has a shape of its
# own
ALIKE = 0.7
DEEP = 0.1  # variation of the stiffness over its mean below which its shape tells nothing
# parts of a realization that must tell alike how it differs; those side by side share too much
PARTS = 10
BROAD = 2.5  # standard deviation in samples of that low-pass
SMOOTH = 1.5  # standard deviation in samples of the low-pass behind which realizations are compared
TINY = np.finfo(float).tiny


def mean_left(data: FittedEnsemble, which: str) -> Seen:
    """RMS of the mean over realizations over what chance leaves.

    The same of a common offset, if it is more.
    """
    ensemble = data.ensemble
    data.require(MIN_TESTED_REALIZATIONS, answer=False)
    if ensemble.mean_subtracted:
        raise NotJudged("the mean over realizations has been subtracted")
    left, unit = statistics.mean_left(ensemble.signal(which)[:, ensemble.core]), UNITS[which]
    what = (
        f"the mean over realizations has an RMS of {left.size:.2g} {unit}; chance would leave "
        f"{left.expected:.2g}"
    )
    return Seen(min(left.ratio, 1e6), what, left.significant)


def repeated(data: FittedEnsemble) -> Seen:
    """Realizations whose angle and torque are, to rounding, those of an earlier one."""
    ensemble = data.given
    both = np.concatenate(
        [ensemble.angle[:, ensemble.core], ensemble.torque[:, ensemble.core]], axis=1
    )
    scale = np.repeat([float(ensemble.angle.std()), float(ensemble.torque.std())], ensemble.samples)
    rounded = np.round(both / np.where(scale > 0, scale, 1.0), ROUNDED)
    _, first, which = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    original = first[which.ravel()]
    again = indices(np.arange(len(both)) != original)
    what = (
        f"{len(again)} of {len(both)} realizations {'is' if len(again) == 1 else 'are'} the "
        "same as another one"
    )
    if again:
        what += f", first realization {again[0]}, as realization {original[again[0]]}"
    return Seen(len(again), what, realizations=again)


def offset(data: FittedEnsemble, which: str) -> Seen:
    """Change of the realizations' means, along a line from the first to the last."""
    data.require(MIN_TESTED_REALIZATIONS, answer=False)
    values = data.core(which)
    means, size = values.mean(axis=1), float(np.sqrt(values.var(axis=1).mean()))
    if size == 0:
        raise NotJudged(f"the {which} does not move")
    line, unit = offset_line(data, which), UNITS[which]
    change, count = float(line[data.order[-1]] - line[data.order[0]]), len(means)
    power = float(np.sum(np.linspace(-0.5, 0.5, count) ** 2))
    error = math.sqrt(float(np.sum((means - means.mean() - line) ** 2)) / (count - 2) / power)
    what = (
        f"the {which} moves by {change:+.2g} {unit} from the first realization to the last, ± "
        f"{error:.1g} {unit}"
    )
    return Seen(100 * abs(change) / size, what, p_value(change, error, count) < SIGNIFICANT)


def offset_line(data: FittedEnsemble, which: str) -> Array:
    """Return a line through the means of realizations in the order of recording.

    It is about zero, shape (realization,).
    """
    means, place = data.core(which).mean(axis=1), np.linspace(-0.5, 0.5, len(data))
    line = np.empty(len(data))
    line[data.order] = place * float(place @ means[data.order] / (place @ place))
    return line


def misaligned(data: FittedEnsemble) -> Seen:
    """Realizations that the behaviour of all explains clearly better when it is shifted."""
    data.require(MIN_TESTED_REALIZATIONS)
    if not _has_a_shape(data):
        raise NotJudged("stiffness hardly varies within a realization, so that no shift shows")
    fit, again, rate = data.fit, data.white_fit, data.rate
    stiffness, viscosity, _ = fit.impedance * (
        1 + np.pad(again.impedance, ((0, 0), (data.whitening, 0)), "edge")
    )
    step = max(1, round(SHIFT_STEP * rate))
    reach = len(stiffness) // 4 // step
    shifts = np.arange(-reach, reach + 1) * step
    inertial = fit.torque - fit.parts[2] * (1 + again.inertia)
    weights = 1 / _local_noise(data)

    def error(shift: int, which: int | slice = slice(None)) -> Array:
        """Return the whitened residual if the common behaviour comes ``shift`` samples later."""
        answer = (
            np.roll(stiffness, shift) * fit.motion[0, which]
            + np.roll(viscosity, shift) * fit.motion[1, which]
        )
        return data.whitened(inertial[which] - answer)

    left = np.stack([error(int(shift)) ** 2 @ weights for shift in shifts])
    best = np.argmin(left, axis=0)
    gain = 1 - left[best, np.arange(left.shape[1])] / np.maximum(left[reach], TINY)
    seconds = shifts[best] / rate
    # Likelihood ratio of white noise whose level is the realization's own: the best of so many
    # shifts, and of all.
    likelier = 0.5 * len(weights) * -np.log1p(-np.clip(gain, 0.0, 1 - 1e-12))
    clear = (gain > BETTER) & (likelier > math.log(left.size / SIGNIFICANT))
    # Equal filters leave hardly any noise at high frequency, so that there the error of the fit is
    # all that is seen.
    for realization in np.flatnonzero(clear).tolist():
        slow = [
            gaussian_filter1d(error(int(shift), realization), BROAD)
            for shift in (shifts[best[realization]], 0)
        ]
        clear[realization] = slow[0] ** 2 @ weights < HALF * (slow[1] ** 2 @ weights)
    out = indices(clear & (np.abs(seconds) >= SHORTEST_SHIFT))
    count, every = len(out), len(data)
    what = f"{count} of {every} realizations {'fits' if count == 1 else 'fit'} better elsewhere"
    if out:
        farthest = max(out, key=lambda realization: abs(seconds[realization]))
        what += f", such as realization {farthest} by {seconds[farthest]:+.2g} s"
    # One may fit better elsewhere by chance; if most do, it is not their place that is wrong.
    return Seen(100 * count / every, what, 1 < count < MOST * every, out)


def _local_noise(data: FittedEnsemble) -> Array:
    """Return the power of the whitened residual about each time, shape (time - w,).

    It is the median over realizations, so that what a few realizations do does not show. Voluntary
    torque may be louder at one time of the behaviour than at another.
    """
    size = min(max(1, round(ABOUT * data.rate)), data.white_residual.shape[1])
    power = np.median(
        uniform_filter1d(data.white_residual**2, size, axis=1, mode="nearest"), axis=0
    )
    return np.asarray(np.maximum(power, QUIETEST * float(power.mean()) + TINY))


def _has_a_shape(data: FittedEnsemble) -> bool:
    """Whether the stiffness varies, and alike in odd and even realizations."""
    fit = data.fit
    profiles = [fit.of(slice(half, None, 2)).impedance[0] for half in (0, 1)]
    depth = float(np.std(fit.stiffness)) / max(abs(float(np.mean(fit.stiffness))), TINY)
    if depth < DEEP or min(float(np.std(each)) for each in profiles) == 0:
        return False
    return float(np.corrcoef(*profiles)[0, 1]) > ALIKE


def unlike(data: FittedEnsemble, misplaced: tuple[int, ...]) -> Seen:
    """Realizations of other stiffness, size of answer, or noise; those only misplaced are none."""
    data.require(MIN_TESTED_REALIZATIONS)
    grams, moments = data.own_fits
    whole = np.maximum(grams.sum(axis=(1, 2)), TINY)
    answers = 1 + moments.sum(axis=1) / whole
    stiffness, noise = data.relative_stiffness, data.relative_noise
    power = float(np.mean(data.white_residual**2))
    own = np.linalg.pinv(grams, hermitian=True)[:, 0, 0]
    out = np.zeros(len(noise), dtype=bool)
    for values, least, error in (
        (stiffness, OTHER_STIFFNESS, np.sqrt(power * own)),
        (answers, OTHER_ANSWER, np.sqrt(power / whole)),
    ):
        distance = np.abs(values - np.median(values))
        usual = 1.4826 * float(np.median(distance))
        # A realization that hardly moved tells little of its stiffness, whatever comes out.
        out |= (distance > FAR_OUT * np.maximum(usual, error)) & (distance > least)
    # Noise of voluntary torque differs from realization to realization: the loudest of many is not
    # unlike them.
    level = np.log(np.maximum(noise, TINY))
    out |= (noise > OTHER_NOISE) & (level > FAR_OUT * 1.4826 * float(np.median(np.abs(level))))
    out[list(misplaced)] = False
    found = indices(out)
    what = f"{len(found)} of {len(out)} realizations {'lies' if len(found) == 1 else 'lie'} far out"
    if found:
        own_stiffness, own_noise = stiffness[found[0]], noise[found[0]]
        what += (
            f", first realization {found[0]}: stiffness {own_stiffness:.2g}, noise "
            f"{own_noise:.2g} times the usual"
        )
    return Seen(len(found), what, realizations=found)


def scattered(data: FittedEnsemble, told: tuple[int, ...], other_period: bool) -> Seen:
    """Test whether stiffness differs between realizations by more than noise and drift.

    The value is the standard deviation over realizations, relative to the RMS of the stiffness. How
    far the stiffness of a realization is from that of all is estimated in each tenth of its time.
    Noise differs from part to part, a realization of another behaviour differs in all of them by
    the pattern in time of the others that differ. So the products of two parts that are no
    neighbours, weighed by the pattern of other realizations, are on average the variance that is
    sought, with no need to know the noise; their scatter over realizations is the base of the test.
    It does not matter how many realizations differ, where a median breaks down at half of them.

    Realizations in which something else is wrong (``told``) are left out; of a wrong period
    (``other_period``) each realization holds another part of the behaviour anyway.
    """
    if other_period:
        raise NotJudged("the period is wrong")
    order = data.order[~np.isin(data.order, told)]
    count = len(order)
    if count < 2 * MIN_TESTED_REALIZATIONS:
        raise NotJudged(f"it takes {2 * MIN_TESTED_REALIZATIONS} realizations")
    # Near half the sampling rate the fit's error goes with the switches of a PRBS, whose clock
    # beats with the sampling.
    motion, left = (
        gaussian_filter1d(values, SMOOTH, axis=-1)
        for values in (data.whitened(data.fit.motion), data.white_residual)
    )
    alone = without(motion[0], motion[1:])
    edges = np.linspace(0, alone.shape[1], PARTS, endpoint=False).astype(np.int64)
    power = np.add.reduceat(np.mean(alone * motion[0], axis=0), edges)
    if power.min() <= 0:
        raise NotJudged("the angle does not move at all times")
    apart = np.add.reduceat(alone * left, edges, axis=1)[order] / power
    # Drift is a check of its own: a line, and a step in the middle.
    place = np.linspace(-1, 1, count)
    slow = np.stack([np.ones(count), place, np.sign(place)], axis=1)
    apart -= slow @ np.linalg.lstsq(slow, apart, rcond=None)[0]
    far = np.abs(np.subtract.outer(np.arange(PARTS), np.arange(PARTS))) > 1
    variances = np.empty(count)
    for out in np.array_split(np.arange(count), FOLDS):
        others = np.delete(apart, out, axis=0)
        pattern = np.linalg.eigh(np.where(far, others.T @ others, 0.0))[1][:, -1]
        weights = np.where(far, np.outer(pattern, pattern), 0.0)
        variances[out] = np.einsum("rj,jl,rl->r", apart[out], weights, apart[out]) / (
            PARTS * np.sum(weights**2)
        )
    variance = max(0.0, float(variances.mean()))
    significant = variance > 0 and p_value_of(variances) < SIGNIFICANT
    if data.explained < ANSWERED and not significant:
        raise NotJudged(NO_ANSWER)
    size = math.sqrt(float(np.mean(data.fit.impedance[0] ** 2)) + variance)
    value = 100 * math.sqrt(variance) / size if size > 0 else 0.0
    what = (
        f"beyond noise and drift, the stiffness differs by {value:.2g} % (standard deviation) "
        "between realizations"
    )
    return Seen(value, what, significant)
