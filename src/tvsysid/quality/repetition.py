"""Whether the realizations are of one behaviour: no mean left, no drift, none unlike or shifted, the right period."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.ndimage import gaussian_filter1d, uniform_filter1d

from tvsysid.numerics.moments import mean_subtracted
from tvsysid.quality.evidence import CHANCE, FOLDS, LEAST_REALIZATIONS, Evidence, chance, without
from tvsysid.quality.excitation import ANSWERED, NO_ANSWER
from tvsysid.quality.finding import Finding, judged, unjudged
from tvsysid.quality.fit import SecondOrder, fit_motion

Array = NDArray[np.float64]

TOO_FEW = f"it takes {LEAST_REALIZATIONS} realizations"
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
"""Variation of the stiffness over its mean below which nothing can be told from its shape."""
SLOWEST, FASTEST = 0.3, 3.3
"""Cycles in a realization that are looked for as another period: the clock of a PRBS is faster."""
BEAT = 1.25
"""Times as coherent in the inertia as in the stiffness that a line is no behaviour."""
PARTS = 10
"""Parts of a realization that must tell alike how it differs from the others; those side by side share too much."""
BESIDE, BESIDE_DRIFT = 0.2, 4.0
"""Distance from a harmonic, in one over the record's length, where no line is another period; so if all drifts."""
NEAR_HARMONIC = 0.1
"""Share of a harmonic's number by which a line may be off it."""
SMOOTH = 1.5
"""Standard deviation in samples of the low-pass behind which realizations are compared."""
RESOLUTION = 0.25
"""Step in frequency, as a share of one over the record's length."""


def mean_left(evidence: Evidence, which: str) -> Finding:
    """RMS of the mean over realizations over what chance leaves; the same of a common offset, if it is more.

    Noise is alike at neighbouring times, so that its mean is not averaged out over time: hence an allowance of 2.5.
    """
    name = f"mean-{which}"
    ensemble = evidence.ensemble
    values = (ensemble.torque if which == "torque" else ensemble.angle)[:, ensemble.core]
    count = len(values)
    if count < LEAST_REALIZATIONS:
        return unjudged(name, TOO_FEW)
    if mean_subtracted(values):
        return unjudged(name, "the mean over realizations has been subtracted")
    mean, offsets = values.mean(axis=0), values.mean(axis=1)
    size = float(np.sqrt(np.mean(mean**2)))
    expected = math.sqrt(float(values.var(axis=0, ddof=1).mean()) / count)
    ratio = size / expected if expected > 0 else math.inf
    certain = chance(_by_others(values)) < CHANCE
    offset = abs(float(offsets.mean()))
    if offset > 0 and chance(offsets) < CHANCE / 10:
        # A common offset shows in the means of realizations long before it does at single times.
        error = float(offsets.std(ddof=1)) / math.sqrt(count)
        ratio, certain = max(ratio, offset / error if error > 0 else math.inf), True
    unit = "N·m" if which == "torque" else "rad"
    ratio = min(ratio, 1e6)
    what = f"the mean over realizations has an RMS of {size:.2g} {unit}; chance would leave {expected:.2g}"
    return judged(name, ratio, what, significant=certain)


def _by_others(values: Array) -> Array:
    """Products of each realization with the mean of the others, less its neighbours: above zero if they share one."""
    count = len(values)
    products = values @ values.T
    near = np.abs(np.subtract.outer(np.arange(count), np.arange(count))) <= 1
    return np.asarray(np.where(near, 0.0, products).sum(axis=1))


def repeated(evidence: Evidence) -> Finding:
    """Realizations whose angle and torque are, to rounding, those of an earlier one."""
    ensemble = evidence.given
    both = np.concatenate([ensemble.angle[:, ensemble.core], ensemble.torque[:, ensemble.core]], axis=1)
    scale = np.repeat([float(ensemble.angle.std()), float(ensemble.torque.std())], ensemble.samples)
    rounded = np.round(both / np.where(scale > 0, scale, 1.0), ROUNDED)
    _, first, which = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    again = np.flatnonzero(np.arange(len(both)) != first[which.ravel()])
    what = f"{len(again)} of {len(both)} realizations {'is' if len(again) == 1 else 'are'} the same as another one"
    if len(again):
        what += f", first realization {again[0]}, as realization {first[which.ravel()[again[0]]]}"
    return judged("repeated-realizations", len(again), what)


def offset(evidence: Evidence, which: str) -> tuple[Finding, Array]:
    """Line through the means of realizations, in the order of recording, and what it is in each if it was found."""
    name, line = f"{which}-offset", np.zeros(len(evidence.ensemble))
    if len(evidence.ensemble) < LEAST_REALIZATIONS:
        return unjudged(name, TOO_FEW), line
    values = (evidence.angle if which == "angle" else evidence.torque)[:, evidence.ensemble.core][evidence.order]
    means, size = values.mean(axis=1), float(np.sqrt(values.var(axis=1).mean()))
    if size == 0:
        return unjudged(name, f"the {which} does not move"), line
    count = len(means)
    place = np.linspace(-0.5, 0.5, count)
    change = float(place @ means / (place @ place))
    error = math.sqrt(float(np.sum((means - means.mean() - change * place) ** 2)) / (count - 2) / float(place @ place))
    unit = "N·m" if which == "torque" else "rad"
    check = judged(
        name,
        100 * abs(change) / size,
        f"the {which} moves by {change:+.2g} {unit} from the first realization to the last, ± {error:.1g} {unit}",
        significant=chance(_scores(change, error, count)) < CHANCE,
    )
    if check.found:
        line[evidence.order] = change * place
    return check, line


def drift(evidence: Evidence) -> Finding:
    """Stiffness of the second half against that of the first, in the order of recording."""
    name = "drift"
    if len(evidence.ensemble) < 2 * LEAST_REALIZATIONS:
        return unjudged(name, f"it takes {2 * LEAST_REALIZATIONS} realizations")
    order = evidence.order
    if evidence.explained < ANSWERED:
        # The halves may answer and contradict each other, as when a sign was turned in between.
        if min(half.explained for half in evidence.halves) < ANSWERED:
            return unjudged(name, NO_ANSWER)
        (before, error_before), (after, error_after) = (
            (float(values[0]), float(errors[0])) for values, errors in (half.mean_impedance for half in evidence.halves)
        )
        error = math.hypot(error_before, error_after)
        return judged(
            name,
            100 * (after - before) / max(abs(before), np.finfo(float).tiny),
            f"the stiffness is {before:.3g} N·m/rad in the first half and {after:.3g} in the second, ± {error:.2g}",
            significant=chance(_scores(after - before, error, len(order))) < CHANCE,
        )
    grams, moments = _own_fits(evidence)
    halves = []
    for half in (order[: len(order) // 2], order[len(order) // 2 :]):
        influence = moments[half] @ np.linalg.pinv(grams[half].sum(axis=0), hermitian=True)[:, 0]
        halves.append((1 + influence.sum(), len(half) * influence.var(ddof=1)))
    (first, error_first), (second, error_second) = halves
    change = second - first
    error = math.sqrt(error_first + error_second)
    value = 100 * change / max(abs(first), 0.01)
    return judged(
        name,
        value,
        f"the stiffness of the second half is {abs(value):.2g} % {'higher' if change > 0 else 'lower'} than that of "
        f"the first, ± {100 * error:.2g} %",
        significant=chance(_scores(change, error, len(order))) < CHANCE,
    )


def _scores(mean: float, error: float, count: int) -> Array:
    """Numbers of a mean with a standard error, for a test by :func:`chance`."""
    pattern = np.where(np.arange(count) % 2 == 0, 1.0, -1.0)
    pattern -= pattern.mean()
    return mean + pattern * (error * math.sqrt(count) / float(pattern.std(ddof=1)))


def _own_fits(evidence: Evidence) -> tuple[Array, Array]:
    """Second moments of each realization's torque parts, and theirs with its residual: (r, 3, 3) and (r, 3)."""
    parts = evidence.white_parts.transpose(1, 0, 2)
    return parts @ parts.transpose(0, 2, 1), (parts @ evidence.white_residual[..., None])[..., 0]


def relative_stiffness(evidence: Evidence) -> Array:
    """Stiffness of each realization over the median of all, shape (realization,)."""
    grams, moments = _own_fits(evidence)
    stiffness = 1 + np.einsum("rb,rb->r", np.linalg.pinv(grams, hermitian=True)[:, 0], moments)
    usual = float(np.median(stiffness))
    return np.asarray(stiffness / usual) if usual > 0 else stiffness


def relative_noise(evidence: Evidence) -> Array:
    """RMS of each realization's whitened residual over the median of all, shape (realization,)."""
    size = np.sqrt(np.mean(evidence.white_residual**2, axis=1))
    usual = float(np.median(size))
    return np.asarray(size / usual) if usual > 0 else np.ones_like(size)


def local_noise(evidence: Evidence) -> Array:
    """Power of the whitened residual about each time, the median over realizations, shape (time - w,).

    Voluntary torque may be louder at one time of the behaviour than at another; what a few realizations do does not
    show.
    """
    size = min(max(1, round(ABOUT * evidence.rate)), evidence.white_residual.shape[1])
    power = np.median(uniform_filter1d(evidence.white_residual**2, size, axis=1, mode="nearest"), axis=0)
    return np.asarray(np.maximum(power, QUIETEST * float(power.mean()) + np.finfo(float).tiny))


def misaligned(evidence: Evidence) -> tuple[Finding, NDArray[np.bool_]]:
    """Realizations that the behaviour of all explains clearly better when it is shifted, and which these are."""
    name, line = "misaligned-realizations", np.zeros(len(evidence.ensemble), dtype=bool)
    if len(evidence.ensemble) < LEAST_REALIZATIONS:
        return unjudged(name, TOO_FEW), line
    if evidence.explained < ANSWERED:
        return unjudged(name, NO_ANSWER), line
    if not _has_a_shape(evidence):
        return unjudged(name, "stiffness hardly varies within a realization, so that no shift shows"), line
    fit, rate = evidence.fit, evidence.rate
    again = _again(evidence)
    late = ((evidence.whitening, 0),)
    stiffness = fit.stiffness[fit.bins] * (1 + np.pad(again.stiffness[again.bins], late, "edge"))
    viscosity = fit.viscosity[fit.bins] * (1 + np.pad(again.viscosity[again.bins], late, "edge"))
    step = max(1, round(SHIFT_STEP * rate))
    reach = len(stiffness) // 4 // step
    shifts = np.arange(-reach, reach + 1) * step
    inertial = fit.torque - evidence.parts[2] * (1 + again.inertia)
    left = np.empty((len(shifts), len(fit.torque)))
    weights = 1 / local_noise(evidence)
    for row, shift in zip(left, shifts, strict=True):
        answer = np.roll(stiffness, shift) * fit.motion[0] + np.roll(viscosity, shift) * fit.motion[1]
        row[:] = evidence.whitened(inertial - answer) ** 2 @ weights
    best = np.argmin(left, axis=0)
    gain = 1 - left[best, np.arange(left.shape[1])] / np.maximum(left[reach], np.finfo(float).tiny)
    seconds = shifts[best] / rate
    out = (gain > BETTER) & (np.abs(seconds) >= SHORTEST_SHIFT)
    # Likelihood ratio of white noise whose level is the realization's own: the best of so many shifts, and of all.
    likelier = 0.5 * len(weights) * -np.log1p(-np.clip(gain, 0.0, 1 - 1e-12))
    out &= likelier > math.log(left.size / CHANCE)
    count = int(out.sum())
    what = f"{count} of {len(out)} realizations {'fits' if count == 1 else 'fit'} better elsewhere"
    if count:
        farthest = np.flatnonzero(out)[np.argmax(np.abs(seconds[out]))]
        what += f", such as realization {farthest} by {seconds[farthest]:+.2g} s"
    # One may fit better elsewhere by chance; if most do, it is not their place that is wrong.
    return judged(name, 100 * count / len(out), what, significant=1 < count < MOST * len(out)), out


def _again(evidence: Evidence) -> SecondOrder:
    """Fit to what the fit left, whitened, which slow noise makes much less wrong; shares of the first one's values."""
    return fit_motion(evidence.white_parts, evidence.white_residual, evidence.rate, 0)


def _has_a_shape(evidence: Evidence) -> bool:
    """Whether the stiffness varies, and alike in odd and even realizations."""
    fit = evidence.fit
    odd, even = (fit_motion(fit.motion[:, half::2], fit.torque[half::2], evidence.rate, fit.first) for half in (0, 1))
    profiles = odd.stiffness[odd.bins], even.stiffness[even.bins]
    depth = float(np.std(fit.stiffness)) / max(abs(float(np.mean(fit.stiffness))), np.finfo(float).tiny)
    if depth < DEEP or min(float(np.std(each)) for each in profiles) == 0:
        return False
    return float(np.corrcoef(*profiles)[0, 1]) > ALIKE


def unlike(evidence: Evidence, misaligned_ones: NDArray[np.bool_]) -> tuple[Finding, NDArray[np.bool_]]:
    """Realizations of other stiffness, size of answer, or noise, and which these are; those only shifted are none."""
    name, none = "unlike-realizations", np.zeros(len(evidence.ensemble), dtype=bool)
    if len(evidence.ensemble) < LEAST_REALIZATIONS:
        return unjudged(name, TOO_FEW), none
    if evidence.explained < ANSWERED:
        return unjudged(name, NO_ANSWER), none
    grams, moments = _own_fits(evidence)
    whole = np.maximum(grams.sum(axis=(1, 2)), np.finfo(float).tiny)
    answers = 1 + moments.sum(axis=1) / whole
    stiffness, noise = relative_stiffness(evidence), relative_noise(evidence)
    power = float(np.mean(evidence.white_residual**2))
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
    out &= ~misaligned_ones
    what = f"{int(out.sum())} of {len(out)} realizations {'lies' if out.sum() == 1 else 'lie'} far out"
    if out.any():
        first = int(np.flatnonzero(out)[0])
        what += (
            f", first realization {first}: stiffness {stiffness[first]:.2g}, noise {noise[first]:.2g} times the usual"
        )
    return judged(name, int(out.sum()), what), out


def scattered(evidence: Evidence, told: NDArray[np.bool_]) -> Finding:
    """Standard deviation over realizations of the stiffness beyond noise and drift, over the stiffness' RMS.

    How far the stiffness of a realization is from that of all is estimated in each tenth of its time. Noise differs
    from part to part, a realization of another behaviour differs in all of them by the pattern in time of the others
    that differ. So the products of two parts that are no neighbours, weighed by the pattern of other realizations, are
    on average the variance that is sought, with no need to know the noise; their scatter over realizations tells
    chance. It does not matter how many realizations differ, where a median breaks down at half of them.

    Parameters
    ----------
    told
        Realizations that are left out, as something else is wrong with them, shape (realization,).
    """
    name = "scattered-realizations"
    order = evidence.order[~told[evidence.order]]
    count = len(order)
    if count < 2 * LEAST_REALIZATIONS:
        return unjudged(name, f"it takes {2 * LEAST_REALIZATIONS} realizations")
    # Near half the sampling rate the fit's error goes with the switches of a PRBS, whose clock beats with the sampling.
    motion, left = (
        gaussian_filter1d(values, SMOOTH, axis=-1)
        for values in (evidence.whitened(evidence.fit.motion), evidence.white_residual)
    )
    alone = without(motion[0], motion[1:])
    edges = np.linspace(0, alone.shape[1], PARTS, endpoint=False).astype(np.int64)
    power = np.add.reduceat(np.mean(alone * motion[0], axis=0), edges)
    if power.min() <= 0:
        return unjudged(name, "the angle does not move at all times")
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
    certain = variance > 0 and chance(variances) < CHANCE
    if evidence.explained < ANSWERED and not certain:
        return unjudged(name, NO_ANSWER)
    size = math.sqrt(float(np.mean(evidence.fit.stiffness[evidence.fit.bins] ** 2)) + variance)
    value = 100 * math.sqrt(variance) / size if size > 0 else 0.0
    what = f"beyond noise and drift, the stiffness differs by {value:.2g} % (standard deviation) between realizations"
    return judged(name, value, what, significant=certain)


def wrong_period(evidence: Evidence, drifts: bool) -> Finding:
    """Stiffness that varies with a frequency of which no whole number fits into a realization.

    What the fit left is projected on the torque of stiffness at each sample; a line in that series between the
    harmonics of the period is a behaviour of another period. The series has no part at the harmonics only if it is of
    the signals that were fitted: as they are whitened, stiffness and viscosity are fitted again, for the first fit's
    error, which slow noise makes large, is the same in all realizations. The power of a line over what realizations of
    random phase would give tells chance.

    Parameters
    ----------
    drifts
        Whether the behaviour was found to drift, which shows beside the harmonics: no line is looked for there then.
    """
    name = "wrong-period"
    ensemble = evidence.ensemble
    assert ensemble.onsets is not None
    assert ensemble.trials is not None
    numbers = np.unique(ensemble.trials)
    if len(numbers) == len(ensemble):
        return unjudged(name, "each realization is a trial of its own")
    if len(ensemble) < LEAST_REALIZATIONS:
        return unjudged(name, TOO_FEW)
    if evidence.explained < ANSWERED:
        return unjudged(name, NO_ANSWER)
    again = _again(evidence)
    left = evidence.white_residual - again.parts.sum(axis=0)
    frequencies, coherent, power = _lines(left * evidence.white_parts[0], evidence)
    # An inertia is constant: a line that shows in it even more is the beat of a PRBS' clock with the sampling.
    _, beating, _ = _lines(left * evidence.white_parts[2], evidence)
    width = 2 * round(1 / RESOLUTION) + 1
    beat = uniform_filter1d(beating, width) > BEAT * uniform_filter1d(coherent, width)
    cycles = frequencies * ensemble.duration
    record = max(float(np.ptp(ensemble.onsets[ensemble.trials == number])) for number in numbers) + ensemble.duration
    beside = np.abs(cycles - np.round(cycles)) * record / ensemble.duration
    coherent = np.where(beat | (beside < (BESIDE_DRIFT if drifts else BESIDE)), 0.0, coherent)
    amplitude = 200 * np.sqrt(power) / float(np.sum(evidence.white_parts[0] ** 2))
    best = int(np.argmax(np.where(coherent > 1, amplitude, 0.0)))
    largest = len(ensemble) / len(numbers)
    independent = max(1.0, len(frequencies) * RESOLUTION)
    probability = independent * max(0.0, 1 - float(coherent[best]) / (largest * len(numbers))) ** (len(ensemble) - 1)
    # A line near a harmonic is that harmonic of a period near the one that was given.
    number = max(1, round(float(cycles[best])))
    number = number if abs(float(cycles[best]) - number) < NEAR_HARMONIC * number else 1
    period, given = number / float(frequencies[best]), ensemble.duration
    digits = next((n for n in range(3, 6) if f"{period:.{n}g}" != f"{given:.{n}g}"), 6)
    what = (
        f"stiffness varies by {amplitude[best]:.2g} % of its mean with {period:.{digits}g} s, beside what "
        f"repeats every {given:g} s"
    )
    return judged(name, float(amplitude[best]), what, significant=probability < CHANCE)


def _lines(scores: Array, evidence: Evidence) -> tuple[Array, Array, Array]:
    """Frequencies in Hz; power of trials over that of realizations of random phase; and power of trials.

    Trials are put together and transformed at once; the power of single realizations follows from the sum of their
    autocorrelations, so that memory and time grow with the record's length and no faster.
    """
    ensemble, rate = evidence.ensemble, evidence.rate
    assert ensemble.onsets is not None
    assert ensemble.trials is not None
    numbers, samples = np.unique(ensemble.trials), scores.shape[1]
    runs = [np.flatnonzero(ensemble.trials == number) for number in numbers]
    longest = max(float(np.ptp(ensemble.onsets[run])) for run in runs) + ensemble.duration
    length = next_fast_len(math.ceil(longest * rate / RESOLUTION) + 2 * samples, real=True)
    frequencies = np.arange(length // 2 + 1) * rate / length
    highest = min(FASTEST / ensemble.duration, 0.25 * rate)
    looked = (frequencies >= SLOWEST / ensemble.duration) & (frequencies < highest)
    together = np.zeros(int(looked.sum()))
    for run in runs:
        series = np.zeros(length)
        first = np.round((ensemble.onsets[run] - ensemble.onsets[run].min()) * rate).astype(np.int64)
        np.add.at(series, first[:, None] + np.arange(samples), scores[run])
        together += np.abs(rfft(series)[looked]) ** 2
    own = np.sum(np.abs(rfft(scores, 2 * samples, axis=1)) ** 2, axis=0)
    correlation = irfft(own, 2 * samples)
    apart = np.zeros(length)
    apart[:samples] = correlation[:samples]
    apart[length - samples + 1 :] = correlation[samples + 1 :]
    alone = np.maximum(rfft(apart)[looked].real, np.finfo(float).tiny)
    return frequencies[looked], together / alone, together
