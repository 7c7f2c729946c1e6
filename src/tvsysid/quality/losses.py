"""Sensors at their limits, signals that were lost, spikes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, median_filter, uniform_filter1d

from tvsysid.preprocess import find_gaps, find_mains
from tvsysid.quality.catalogue import FAULTS
from tvsysid.quality.fitted import FittedEnsemble, NotJudged, Seen, indices
from tvsysid.quality.statistics import innovations, over_usual
from tvsysid.signals import Array, Recording

ALIKE = 3  # realizations that must be at the limit at one time
SAME = 1e-3  # of a signal's standard deviation: values that are as near as that are the same
# of samples within half an RMS, below which a signal switches between two levels: Gaussian have
# 0.38
TWO_LEVELS = 0.2
WINDOW = 0.2  # in s, for losses
STILL = 0.1  # share of what is expected below which a signal does not move
LOUD = 4.0  # times the usual power from which on a window's residual is out of the ordinary
QUIET = 0.25  # share of a realization's windows that are quieter than what counts as its noise
LEAST_SAMPLES = 10  # of a window
BRIEF, LEAST_FAST = (
    0.06,
    40,
)  # s of a brief loss that are looked at together, and the samples that must be
SILENT, QUIETEST = (
    0.2,
    0.05,
)  # times a quantile of the noise's power, and which, below which a torque is silent
HALF_SPIKE = 3  # samples to either side from which a spike stands out
# Quantiles against which surprises and residual are held: a PRBS surprises at every switch, noise
# never.
USUAL_SURPRISE, USUAL_RESIDUAL = 0.99, 0.9
OUT_OF_LINE = 1.2  # times the usual distance from the median about it that makes a sample stand out
FAR_OUT_OF_LINE = 2.0  # the same, of a sample that is taken out before what is lost is looked for
DISTURBED = 4.5  # times the usual residual that a spike in the angle causes beside it
SCATTER = 2.0  # times the usual level that the level of one time has by chance
BESIDE = 6  # samples to either side over which the derivatives' filters spread a spike


def clipped(data: FittedEnsemble, which: str) -> Seen:
    """Times at which several realizations have the very same highest, or lowest, value.

    The mean over realizations may be subtracted, and with it a different value at each time:
    only within a time are values at a sensor's limit still the same.
    """
    values = data.given.signal(which)[:, data.given.core]
    if len(values) < 2 * ALIKE:
        raise NotJudged(f"it takes {2 * ALIKE} realizations")
    deviations = values - values.mean(axis=0)
    size = float(np.std(deviations))
    ordered = np.sort(values, axis=0)
    top = ordered[-1] - ordered[-ALIKE] <= SAME * size
    bottom = ordered[ALIKE - 1] - ordered[0] <= SAME * size
    tied = top | bottom
    if not tied.any():
        return Seen(0.0, f"no {which} stays at a limit")
    share = 100 * float(tied.mean())
    middle = len(ordered) // 2
    about = ordered[middle - ALIKE + 1 : middle + ALIKE]
    inside = (
        np.min(about[ALIKE - 1 :] - about[:ALIKE], axis=0) <= SAME * size
    )  # a multisine that repeats
    if inside.mean() > max(0.5 * tied.mean(), 0.01 * FAULTS[f"clipped-{which}"].limit):
        raise NotJudged(f"the same values of {which} come again and again, not only the extremes")
    if which == "angle" and float(np.mean(np.abs(deviations) < 0.5 * size)) < TWO_LEVELS:
        raise NotJudged("the angle switches between two levels, as a PRBS does")
    sides = "highest" if not bottom.any() else "lowest" if not top.any() else "highest and lowest"
    return Seen(
        share,
        f"at {share:.1f} % of the times at least {ALIKE} realizations have the same {sides} "
        f"{which}",
    )


def coarse_angle(data: FittedEnsemble) -> Seen:
    """Step in which the angle is recorded; seen only in what no filter has passed."""
    step = data.angle_step
    return Seen(step, f"the angle is recorded in steps of {step:.2g} % of its standard deviation")


def lost(data: FittedEnsemble, which: str, heights: Mapping[str, Array]) -> Seen:
    """Measure for how long one signal is lost while the other moves.

    A lost signal stands still, or is only what the subtracted mean left. Heights are those of
    :func:`spike_heights`.
    """
    samples = max(LEAST_SAMPLES, round(WINDOW * data.rate))
    answer, measured = data.white_parts.sum(axis=0), data.whitened(data.fit.torque)
    if measured.shape[1] < samples:
        raise NotJudged(f"realizations are shorter than {WINDOW:g} s")
    expected, there, left = (
        _window_power(values, samples) for values in (answer, measured, data.white_residual)
    )
    together = _window_power(answer, samples, measured)
    typical = float(np.median(left))
    # What is loud at this time in most realizations, or at most times in this one, is noise and no
    # loss.
    noise = np.maximum(
        np.median(left, axis=0), np.maximum(typical, np.quantile(left, QUIET, axis=1))[:, None]
    )
    if which == "torque":
        moving = expected > max(float(np.median(expected)), LOUD * typical)
        gone = moving & (there < STILL * expected) & (np.abs(together) < 2 * STILL * expected)
        # Filters of both channels leave hardly any noise, so that the errors of the fit look like a
        # loss when whitened.
        raw = (
            np.gradient(each, axis=1)[:, data.whitening :]
            for each in (data.fit.torque, data.fit.parts.sum(axis=0))
        )
        there, expected = (_window_power(each, samples) for each in raw)
        gone &= there < 2 * STILL * expected
    else:
        gone = (
            (left > LOUD * noise) & (expected < STILL * there) & (np.abs(together) < STILL * there)
        )
    # A spike in the other signal moves much, and is answered by nothing.
    other = "angle" if which == "torque" else "torque"
    alone = _against_neighbours(data, other) > FAR_OUT_OF_LINE
    spikes = maximum_filter1d(
        alone & (heights[other] > FAULTS[f"{other}-spikes"].limit), 2 * BESIDE + 1, axis=1
    )
    gone &= ~_windows(spikes, samples).any(axis=2)
    times = (
        np.repeat(gone, samples, axis=1)
        if gone.sum() > 1
        else np.zeros((len(gone), gone.shape[1] * samples), bool)
    )
    if which == "torque":
        times |= _held(data)[:, : times.shape[1]]
    if not times.any():
        return Seen(0.0, f"the {which} is there throughout")
    seconds, concerned = float(times.sum()) / data.rate, indices(times.any(axis=1))
    begin = data.seconds(int(np.argmax(times[concerned[0]])))
    what = (
        f"the {which} does not follow for {seconds:.2g} s in {len(concerned)} realizations, first "
        "in realization "
        f"{concerned[0]} from about {begin:.2g} s on"
    )
    return Seen(seconds, what, realizations=concerned)


def _held(data: FittedEnsemble) -> NDArray[np.bool_]:
    """Find times of some BRIEF seconds at which the torque is held.

    The torque is the same there, or should move and has no noise of its own either. The noise is
    what the torque's past does not predict at the rate that was given: at some 100 Hz, so short a
    time has too few samples. A torque that is held or zero has only what the subtracted mean left.
    Shape (realization, time - w).
    """
    given, fit = data.given, data.fit
    fast, slow = round(BRIEF * given.sampling_rate), max(5, round(BRIEF * data.rate))
    seconds = (
        np.arange(fit.torque.shape[1])[data.whitening :] + fit.first - data.ensemble.context
    ) / data.rate
    place = np.round(seconds * given.sampling_rate).astype(np.int64) + given.context
    # Where no mean was subtracted.
    still, count = np.abs(np.diff(given.torque, axis=1)) <= 1e-9 * given.torque.std(), fast
    if fast < LEAST_FAST:
        count = max(LEAST_SAMPLES, round(WINDOW * given.sampling_rate))
    held = maximum_filter1d(
        uniform_filter1d(still.astype(float), count, axis=1) > 1 - 0.5 / count, count, axis=1
    )
    held = held[:, np.clip(place, 0, held.shape[1] - 1)]
    if fast < LEAST_FAST:
        return np.asarray(held)
    order = 6
    noise = innovations(np.asarray(given.torque - given.torque.mean(axis=0)), order)
    power = uniform_filter1d(noise**2, fast, axis=1, mode="nearest")
    silent = maximum_filter1d(power < SILENT * np.quantile(power, QUIETEST), fast, axis=1)
    measured, expected, left = (
        _change(values, slow) for values in (fit.torque, fit.parts.sum(axis=0), fit.residual)
    )
    gone = (measured < STILL * expected) & (expected > LOUD * float(np.median(left)))
    gone = maximum_filter1d(gone, slow, axis=1)[:, data.whitening :]
    return np.asarray(held | (gone & silent[:, np.clip(place - order, 0, silent.shape[1] - 1)]))


def _change(values: Array, samples: int) -> Array:
    """Variance over so many samples about each of a signal's changes from sample to sample."""
    change = np.gradient(values, axis=1)
    mean, square = (uniform_filter1d(each, samples, axis=1) for each in (change, change**2))
    return np.asarray(np.maximum(square - mean**2, 0.0))


def _windows(values: NDArray[np.generic], samples: int) -> NDArray[np.generic]:
    """Values as windows side by side, shape (realization, window, sample)."""
    count = values.shape[1] // samples
    return values[:, : count * samples].reshape(len(values), count, samples)


def _window_power(values: Array, samples: int, others: Array | None = None) -> Array:
    """Products of deviations from the mean of each window, summed, shape (realization, window)."""
    blocks = [_windows(each, samples) for each in (values, values if others is None else others)]
    return np.asarray(
        np.einsum("rws,rws->rw", *(block - block.mean(axis=2, keepdims=True) for block in blocks))
    )


def spike_heights(data: FittedEnsemble) -> dict[str, Array]:
    """Return by how much outlying samples of each signal exceed the usual.

    Both have shape (realization, time - w). In the angle, samples that neither past nor neighbours
    predict, and that the torque does not answer. In the torque, those that neither the model nor
    the past of what it leaves predicts, and that are not the angle's. Others are zero.
    """
    angle, torque = (
        over_usual(np.abs(data.unpredicted(own)), USUAL_SURPRISE)
        for own in (data.angle, data.torque)
    )
    residual = over_usual(np.abs(data.white_residual), USUAL_RESIDUAL)
    standing_out = (angle > 0) & (_against_neighbours(data, "angle") > OUT_OF_LINE)
    standing_out &= maximum_filter1d(residual, 2 * BESIDE + 1, axis=1) > DISTURBED
    # What is high at this time in most realizations is not a spike: a change of stiffness that the
    # bins do not follow.
    # Spikes at one time leave their mean in all the others.
    together = np.median(
        np.abs(data.white_residual - np.median(data.white_residual, axis=0)), axis=0
    )
    residual = residual / np.maximum(
        1.0, together / max(SCATTER * float(np.median(together)), np.finfo(float).tiny)
    )
    of_angle = maximum_filter1d(angle, 4 * BESIDE + 1, axis=1) > FAULTS["angle-spikes"].limit
    return {
        "angle": np.where(standing_out, angle, 0.0),
        "torque": np.where((torque > angle) & ~of_angle, residual, 0.0),
    }


def _against_neighbours(data: FittedEnsemble, which: str) -> Array:
    """Distance of each sample from the median about it over what is usual.

    A step has none, a spike has all of it.
    """
    values = data.signal(which)
    distance = np.abs(values - median_filter(values, (1, 2 * HALF_SPIKE + 1)))
    return over_usual(distance, USUAL_SURPRISE)[:, data.white_region]


def spikes(data: FittedEnsemble, which: str, heights: Mapping[str, Array]) -> Seen:
    """Highest of the samples that stand out; heights as of :func:`spike_heights`."""
    own = heights[which]
    value = float(own.max())
    if value == 0:
        return Seen(0.0, "none")
    realization, sample = np.unravel_index(int(np.argmax(own)), own.shape)
    beyond = own > FAULTS[f"{which}-spikes"].limit
    count = int(np.count_nonzero(beyond))
    what = f"the highest is {value:.3g} times as high as is usual, in realization {realization} at "
    what += f"{data.seconds(int(sample)):.3g} s" + (
        f"; {count} samples stand out" if count > 1 else ""
    )
    return Seen(value, what, realizations=indices(beyond.any(axis=1)))


def gaps(recording: Recording) -> Seen:
    """Gaps in both signals of a record."""
    found = find_gaps(recording)
    if not found:
        return Seen(0.0, "no gap in both signals")
    longest = max(found, key=lambda gap: gap.stop - gap.start)
    what = (
        f"for {longest.stop - longest.start:.2g} s at {longest.start:.4g} s in trial "
        f"{longest.trial + 1}"
    )
    more = f", and {len(found) - 1} times more" if len(found) > 1 else ""
    return Seen(len(found), f"both signals stand still, or are interpolated, {what}{more}")


def mains(recording: Recording) -> Seen:
    """Line of the mains in a record's angle."""
    frequency, share = find_mains(recording)
    return Seen(share, f"a line at {frequency:g} Hz has {share:.2g} % of the angle's RMS")
