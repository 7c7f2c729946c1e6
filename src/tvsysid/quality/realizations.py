"""Whether the realizations are of one behaviour: no mean or offset left, none repeated, unlike or misplaced."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, uniform_filter1d

from tvsysid.quality.finding import NotJudged, Seen
from tvsysid.quality.fit import fit_motion
from tvsysid.quality.fitted import ANSWERED, NO_ANSWER, FittedEnsemble
from tvsysid.quality.limits import mean_left as left_mean
from tvsysid.quality.statistics import FOLDS, LEAST_REALIZATIONS, SIGNIFICANT, p_value, p_value_of, without
from tvsysid.signals import Array

UNITS = {"angle": "rad", "torque": "N·m"}
FAR_OUT = 6.0
"""Robust standard deviations from the median at which a realization is unlike the others."""
OTHER_STIFFNESS = 0.3
"""Smallest relative difference in stiffness that makes a realization unlike the others."""
OTHER_ANSWER = 0.2
"""The same for the whole torque's size."""
OTHER_NOISE = 1.7
"""Times the usual noise, whitened, that makes a realization unlike the others, if few of the others come near it."""
SHIFT_STEP, SHORTEST_SHIFT = 0.02, 0.05
"""In s."""
ROUNDED = 9
"""Digits after the point of values over their standard deviation that are alike in the same realizations."""
ABOUT = 0.1
"""Seconds over which the noise about a time is averaged."""
QUIETEST = 0.05
"""Share of the mean noise that no time is taken to have less of."""
BETTER = 0.2
"""Share of a realization's residual that a shift must take away."""
MOST = 0.5
"""Share of the realizations beyond which it is not misalignment."""
ALIKE = 0.7
"""Correlation between the behaviour of odd and even realizations from which on it has a shape of its own."""
DEEP = 0.1
"""Variation of the stiffness over its mean below which its shape tells nothing."""
PARTS = 10
"""Parts of a realization that must tell alike how it differs from the others; those side by side share too much."""
SMOOTH = 1.5
"""Standard deviation in samples of the low-pass behind which realizations are compared."""


def mean_left(data: FittedEnsemble, which: str) -> Seen:
    """RMS of the mean over realizations over what chance leaves; the same of a common offset, if it is more."""
    ensemble = data.ensemble
    values = ensemble.signal(which)[:, ensemble.core]
    data.require(LEAST_REALIZATIONS, answer=False)
    if ensemble.mean_subtracted:
        raise NotJudged("the mean over realizations has been subtracted")
    left, unit = left_mean(values), UNITS[which]
    what = f"the mean over realizations has an RMS of {left.size:.2g} {unit}; chance would leave {left.expected:.2g}"
    return Seen(min(left.ratio, 1e6), what, left.significant)


def repeated(data: FittedEnsemble) -> Seen:
    """Realizations whose angle and torque are, to rounding, those of an earlier one."""
    ensemble = data.given
    both = np.concatenate([ensemble.angle[:, ensemble.core], ensemble.torque[:, ensemble.core]], axis=1)
    scale = np.repeat([float(ensemble.angle.std()), float(ensemble.torque.std())], ensemble.samples)
    rounded = np.round(both / np.where(scale > 0, scale, 1.0), ROUNDED)
    _, first, which = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    original = first[which.ravel()]
    again = np.flatnonzero(np.arange(len(both)) != original)
    what = f"{len(again)} of {len(both)} realizations {'is' if len(again) == 1 else 'are'} the same as another one"
    if len(again):
        what += f", first realization {again[0]}, as realization {original[again[0]]}"
    return Seen(len(again), what, realizations=_indices(again))


def offset(data: FittedEnsemble, which: str) -> Seen:
    """Change of the realizations' means, along a line from the first to the last."""
    data.require(LEAST_REALIZATIONS, answer=False)
    values = data.core(which)
    means, size = values.mean(axis=1), float(np.sqrt(values.var(axis=1).mean()))
    if size == 0:
        raise NotJudged(f"the {which} does not move")
    line, unit = offset_line(data, which), UNITS[which]
    change, count = float(line[data.order[-1]] - line[data.order[0]]), len(means)
    power = float(np.sum(np.linspace(-0.5, 0.5, count) ** 2))
    error = math.sqrt(float(np.sum((means - means.mean() - line) ** 2)) / (count - 2) / power)
    what = f"the {which} moves by {change:+.2g} {unit} from the first realization to the last, ± {error:.1g} {unit}"
    return Seen(100 * abs(change) / size, what, p_value(change, error, count) < SIGNIFICANT)


def offset_line(data: FittedEnsemble, which: str) -> Array:
    """Line through the means of realizations in the order of recording, about zero, shape (realization,)."""
    means, place = data.core(which).mean(axis=1), np.linspace(-0.5, 0.5, len(data))
    line = np.empty(len(data))
    line[data.order] = place * float(place @ means[data.order] / (place @ place))
    return line


def misaligned(data: FittedEnsemble) -> Seen:
    """Realizations that the behaviour of all explains clearly better when it is shifted."""
    data.require(LEAST_REALIZATIONS)
    if not _has_a_shape(data):
        raise NotJudged("stiffness hardly varies within a realization, so that no shift shows")
    fit, again, rate = data.fit, data.white_fit, data.rate
    late = ((data.whitening, 0),)
    stiffness = fit.stiffness[fit.bins] * (1 + np.pad(again.stiffness[again.bins], late, "edge"))
    viscosity = fit.viscosity[fit.bins] * (1 + np.pad(again.viscosity[again.bins], late, "edge"))
    step = max(1, round(SHIFT_STEP * rate))
    reach = len(stiffness) // 4 // step
    shifts = np.arange(-reach, reach + 1) * step
    inertial = fit.torque - data.parts[2] * (1 + again.inertia)
    left = np.empty((len(shifts), len(fit.torque)))
    weights = 1 / _local_noise(data)
    for row, shift in zip(left, shifts, strict=True):
        answer = np.roll(stiffness, shift) * fit.motion[0] + np.roll(viscosity, shift) * fit.motion[1]
        row[:] = data.whitened(inertial - answer) ** 2 @ weights
    best = np.argmin(left, axis=0)
    gain = 1 - left[best, np.arange(left.shape[1])] / np.maximum(left[reach], np.finfo(float).tiny)
    seconds = shifts[best] / rate
    out = (gain > BETTER) & (np.abs(seconds) >= SHORTEST_SHIFT)
    # Likelihood ratio of white noise whose level is the realization's own: the best of so many shifts, and of all.
    likelier = 0.5 * len(weights) * -np.log1p(-np.clip(gain, 0.0, 1 - 1e-12))
    out &= likelier > math.log(left.size / SIGNIFICANT)
    count = int(out.sum())
    what = f"{count} of {len(out)} realizations {'fits' if count == 1 else 'fit'} better elsewhere"
    if count:
        farthest = np.flatnonzero(out)[np.argmax(np.abs(seconds[out]))]
        what += f", such as realization {farthest} by {seconds[farthest]:+.2g} s"
    # One may fit better elsewhere by chance; if most do, it is not their place that is wrong.
    return Seen(100 * count / len(out), what, 1 < count < MOST * len(out), _indices(np.flatnonzero(out)))


def _indices(realizations: NDArray[np.intp]) -> tuple[int, ...]:
    return tuple(int(each) for each in realizations)


def _local_noise(data: FittedEnsemble) -> Array:
    """Power of the whitened residual about each time, the median over realizations, shape (time - w,).

    Voluntary torque may be louder at one time of the behaviour than at another; what a few realizations do does not
    show.
    """
    size = min(max(1, round(ABOUT * data.rate)), data.white_residual.shape[1])
    power = np.median(uniform_filter1d(data.white_residual**2, size, axis=1, mode="nearest"), axis=0)
    return np.asarray(np.maximum(power, QUIETEST * float(power.mean()) + np.finfo(float).tiny))


def _has_a_shape(data: FittedEnsemble) -> bool:
    """Whether the stiffness varies, and alike in odd and even realizations."""
    fit = data.fit
    odd, even = (fit_motion(fit.motion[:, half::2], fit.torque[half::2], data.rate, fit.first) for half in (0, 1))
    profiles = odd.stiffness[odd.bins], even.stiffness[even.bins]
    depth = float(np.std(fit.stiffness)) / max(abs(float(np.mean(fit.stiffness))), np.finfo(float).tiny)
    if depth < DEEP or min(float(np.std(each)) for each in profiles) == 0:
        return False
    return float(np.corrcoef(*profiles)[0, 1]) > ALIKE


def unlike(data: FittedEnsemble, misplaced: tuple[int, ...]) -> Seen:
    """Realizations of other stiffness, size of answer, or noise; those only misplaced are none."""
    data.require(LEAST_REALIZATIONS)
    grams, moments = data.own_fits
    whole = np.maximum(grams.sum(axis=(1, 2)), np.finfo(float).tiny)
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
    # Noise of voluntary torque differs from realization to realization: the loudest of many is not unlike them.
    level = np.log(np.maximum(noise, np.finfo(float).tiny))
    usual = 1.4826 * float(np.median(np.abs(level)))
    out |= (noise > OTHER_NOISE) & (level > FAR_OUT * usual)
    out[list(misplaced)] = False
    what = f"{int(out.sum())} of {len(out)} realizations {'lies' if out.sum() == 1 else 'lie'} far out"
    if out.any():
        first = int(np.flatnonzero(out)[0])
        what += (
            f", first realization {first}: stiffness {stiffness[first]:.2g}, noise {noise[first]:.2g} times the usual"
        )
    return Seen(int(out.sum()), what, realizations=_indices(np.flatnonzero(out)))


def scattered(data: FittedEnsemble, told: tuple[int, ...], other_period: bool) -> Seen:
    """Standard deviation over realizations of the stiffness beyond noise and drift, over the stiffness' RMS.

    How far the stiffness of a realization is from that of all is estimated in each tenth of its time. Noise differs
    from part to part, a realization of another behaviour differs in all of them by the pattern in time of the others
    that differ. So the products of two parts that are no neighbours, weighed by the pattern of other realizations, are
    on average the variance that is sought, with no need to know the noise; their scatter over realizations is the base
    of the test. It does not matter how many realizations differ, where a median breaks down at half of them.

    Parameters
    ----------
    told
        Realizations that are left out, as something else is wrong with them.
    other_period
        Whether the period was found to be wrong: then each realization holds another part of the behaviour anyway.
    """
    if other_period:
        raise NotJudged("the period is wrong")
    order = data.order[~np.isin(data.order, told)]
    count = len(order)
    if count < 2 * LEAST_REALIZATIONS:
        raise NotJudged(f"it takes {2 * LEAST_REALIZATIONS} realizations")
    # Near half the sampling rate the fit's error goes with the switches of a PRBS, whose clock beats with the sampling.
    motion, left = (
        gaussian_filter1d(values, SMOOTH, axis=-1) for values in (data.whitened(data.fit.motion), data.white_residual)
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
        variances[out] = np.einsum("rj,jl,rl->r", apart[out], weights, apart[out]) / (PARTS * np.sum(weights**2))
    variance = max(0.0, float(variances.mean()))
    significant = variance > 0 and p_value_of(variances) < SIGNIFICANT
    if data.explained < ANSWERED and not significant:
        raise NotJudged(NO_ANSWER)
    size = math.sqrt(float(np.mean(data.fit.stiffness[data.fit.bins] ** 2)) + variance)
    value = 100 * math.sqrt(variance) / size if size > 0 else 0.0
    what = f"beyond noise and drift, the stiffness differs by {value:.2g} % (standard deviation) between realizations"
    return Seen(value, what, significant)
