"""Check for sensors at their limits, lost signals, mains hum and spikes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from tvsysid.preprocess import find_gaps, find_mains
from tvsysid.quality.checks import FAULTS, Measured, NotApplicable, check, indices
from tvsysid.quality.fitted import SPREAD_SAMPLES, FittedEnsemble
from tvsysid.quality.statistics import innovations
from tvsysid.signals import Array, Recording

MAX_STANDSTILL_S = {"angle": 0.25, "torque": 0.08}
MIN_TIED_REALIZATIONS = 3  # at a limit at the same time
TIE_TOLERANCE = 1e-3  # of a standard deviation
MAX_REPEATED_SHARE = 0.5  # of values tied in the middle, relative to those tied at the limits
MIN_MIDDLE_SHARE = 0.2  # of samples within half an RMS; Gaussian numbers have 0.38
MIN_STEP = 1e-6  # of a standard deviation; smaller differences are rounding
WINDOW_S, MIN_WINDOW_SAMPLES = 0.2, 10  # in which losses are looked for
STILL_SHARE = 0.1  # of the expected power, below which a signal does not move
LOUD_RATIO = 4.0  # to the usual power of the residual
QUIET_WINDOWS = 0.25  # share of a realization's windows that are quieter than its noise
MIN_LONELINESS = 2.0  # of a spike that is no loss of the other signal
BRIEF_S, MIN_BRIEF_SAMPLES = 0.06, 40  # of brief losses; at lower rates they do not show
SILENT_SHARE, SILENT_QUANTILE = 0.2, 0.05  # of the noise's power: a silent torque has less
NOISE_PAST_SAMPLES = 6  # from which the torque's noise is predicted
SAME_TORQUE = 1e-9  # of a standard deviation
EXCLUDE = "exclude the realizations concerned"
INTERPOLATE = "interpolate the samples or exclude the realizations; check the cables"


@check(
    "clipped-torque",
    "The torque is clipped",
    "times at which the highest or lowest values of several realizations are equal",
    2,
    "%",
    effect="the sensor stays at its limit where the torque is large: the stiffness comes out too "
    "low where it is high",
    remedy=f"widen the sensor's range; {EXCLUDE}",
    which="torque",
)
@check(
    "clipped-angle",
    "The angle is clipped",
    "times at which the highest or lowest values of several realizations are equal",
    2,
    "%",
    effect="the torque changes while the sensor stays at its limit: the stiffness comes out too "
    "high",
    remedy=f"widen the sensor's range; {EXCLUDE}",
    which="angle",
)
def clipped(data: FittedEnsemble, which: str) -> Measured:
    """Return the share of times at which several realizations tie at the highest or lowest value.

    The mean over realizations may have been subtracted. So values at a sensor's limit are the same
    only at one time.
    """
    tied_count = MIN_TIED_REALIZATIONS
    values = data.given.signal(which)[:, data.given.core]
    if len(values) < 2 * tied_count:
        raise NotApplicable(f"it takes {2 * tied_count} realizations")
    deviations, ordered = values - values.mean(axis=0), np.sort(values, axis=0)
    size = np.std(deviations)
    ranges = ordered[tied_count - 1 :] - ordered[: 1 - tied_count]
    bottom, top = (ranges[end] <= TIE_TOLERANCE * size for end in (0, -1))
    tied = (top | bottom).mean()
    if tied == 0:
        return Measured(0.0, f"no {which} stays at a limit")
    middle = len(values) // 2 - tied_count + 1
    repeats = ranges[middle : middle + tied_count].min(axis=0) <= TIE_TOLERANCE * size
    limit = 0.01 * FAULTS[f"clipped-{which}"].limit
    if repeats.mean() > max(MAX_REPEATED_SHARE * tied, limit):  # as of a multisine
        raise NotApplicable(
            f"the same values of {which} come again and again, not only the extremes"
        )
    if which == "angle" and np.mean(np.abs(deviations) < 0.5 * size) < MIN_MIDDLE_SHARE:
        raise NotApplicable("the angle switches between two levels, as a PRBS does")
    sides = [name for name, side in (("highest", top), ("lowest", bottom)) if side.any()]
    what = (
        f"at {100 * tied:.1f} % of the times at least {tied_count} realizations have the same "
        f"{' and '.join(sides)} {which}"
    )
    return Measured(100 * tied, what)


@check(
    "coarse-angle",
    "The angle is recorded in coarse steps",
    "smallest step between values of the angle, over its standard deviation",
    10,
    "%",
    effect="the steps are noise in the angle, mostly in the acceleration: inertia and viscosity "
    "come out too low, the stiffness a little",
    remedy="record the angle with a finer converter, or a gain that uses its range; trust only the "
    "stiffness",
)
def coarse_angle(data: FittedEnsemble) -> Measured:
    """Return the smallest step between values of the angle, which shows before any filter only."""
    angle = data.given.angle[:, data.given.core]
    values = np.sort(angle - angle.mean(axis=0), axis=0)
    size, steps = np.std(values), np.diff(values, axis=0)
    step = np.min(steps, initial=np.inf, where=steps > MIN_STEP * size)
    # A signal of two levels, such as a PRBS, is not coarse.
    value = 100 * step / size if np.ptp(values, axis=0).max() > 1.5 * step else 0.0
    what = f"the angle is recorded in steps of {value:.2g} % of its standard deviation"
    return Measured(value, what)


@check(
    "lost-torque",
    "The torque is lost for a while",
    "time during which the angle moves and the torque does not",
    MAX_STANDSTILL_S["torque"],
    "s",
    effect="while the torque is held or zero, the joint seems to have no stiffness",
    remedy=EXCLUDE,
    which="torque",
)
@check(
    "lost-angle",
    "The angle is lost for a while",
    "time during which the torque moves and the angle does not",
    MAX_STANDSTILL_S["angle"],
    "s",
    effect="the torque seems to change by itself, which adds noise and mostly lowers the stiffness",
    remedy=EXCLUDE,
    which="angle",
)
def lost(data: FittedEnsemble, which: str) -> Measured:
    """Return for how long one signal is lost while the other moves.

    A lost signal stands still, or is only what a subtracted mean left.
    """
    samples = max(MIN_WINDOW_SAMPLES, round(WINDOW_S * data.rate))
    if data.white_residual.shape[1] < samples:
        raise NotApplicable(f"realizations are shorter than {WINDOW_S:g} s")
    windows = _lost_windows(data, which, samples)
    # A spike in the other signal moves much, and nothing responds to it.
    other = "angle" if which == "torque" else "torque"
    is_spike = data.spike_heights[other] > FAULTS[f"{other}-spikes"].limit
    is_spike &= data.loneliness(other) > MIN_LONELINESS
    windows &= ~_windows(maximum_filter1d(is_spike, SPREAD_SAMPLES, axis=1), samples).any(axis=2)
    times = np.repeat(windows & (windows.sum() > 1), samples, axis=1)
    if which == "torque":
        times |= _held_torque(data)[:, : times.shape[1]]
    if not times.any():
        return Measured(0.0, f"the {which} is there throughout")
    seconds, concerned = times.sum() / data.rate, indices(times.any(axis=1))
    begin = data.seconds(int(np.argmax(times[concerned[0]])))
    what = (
        f"the {which} does not follow for {seconds:.2g} s in {len(concerned)} realizations, first "
        f"in realization {concerned[0]} from about {begin:.2g} s on"
    )
    return Measured(seconds, what, realizations=concerned)


def _lost_windows(data: FittedEnsemble, which: str, samples: int) -> NDArray[np.bool_]:
    """Return windows in which only the other signal moves, shape (realization, window)."""
    fit = data.fit
    response, measured = data.white_parts.sum(axis=0), data.whitened(fit.torque)
    expected, there, left = (
        _window_power(each, each, samples) for each in (response, measured, data.white_residual)
    )
    common = np.abs(_window_power(response, measured, samples))
    usual = np.median(left)
    if which == "torque":
        lost = expected > max(np.median(expected), LOUD_RATIO * usual)
        lost &= (there < STILL_SHARE * expected) & (common < 2 * STILL_SHARE * expected)
        # Filters of both channels leave hardly any noise. Then the fit's error looks like a loss
        # when whitened.
        there, expected = (
            _window_power(change, change, samples)
            for change in (
                np.gradient(each, axis=1)[:, data.whitening :]
                for each in (fit.torque, fit.parts.sum(axis=0))
            )
        )
        return np.asarray(lost & (there < 2 * STILL_SHARE * expected))
    # What is loud at this time in most realizations, or at most times in this one, is noise.
    noise = np.maximum(usual, np.quantile(left, QUIET_WINDOWS, axis=1))[:, None]
    noise = np.maximum(np.median(left, axis=0), noise)
    is_still = (expected < STILL_SHARE * there) & (common < STILL_SHARE * there)
    return np.asarray((left > LOUD_RATIO * noise) & is_still)


def _held_torque(data: FittedEnsemble) -> NDArray[np.bool_]:
    """Find brief times at which the torque is held, shape (realization, time - w).

    It keeps one value, or should move and has no noise of its own either. A torque that is held or
    zero has only what the subtracted mean left. The noise is what the torque's past does not
    predict at the given rate. At some 100 Hz, so short a time has too few samples.
    """
    given, fit, rate = data.given, data.fit, data.given.sampling_rate
    count, slow = round(BRIEF_S * rate), max(5, round(BRIEF_S * data.rate))
    is_fast = count >= MIN_BRIEF_SAMPLES
    if not is_fast:
        count = max(MIN_WINDOW_SAMPLES, round(WINDOW_S * rate))
    sample = np.arange(data.white_region.start, data.white_region.stop) - data.ensemble.context
    place = np.round(sample / data.rate * rate).astype(np.int64) + given.context

    def at_fit(is_there: NDArray[np.bool_], first: int) -> NDArray[np.bool_]:
        """Return what is there about the fit's samples, from samples of the given rate on."""
        about = maximum_filter1d(is_there, count, axis=1)
        return np.asarray(about[:, np.clip(place - first, 0, about.shape[1] - 1)])

    is_same = np.abs(np.diff(given.torque, axis=1)) <= SAME_TORQUE * given.torque.std()
    held = at_fit(uniform_filter1d(is_same.astype(float), count, axis=1) > 1 - 0.5 / count, 0)
    if not is_fast:
        return held
    noise = innovations(given.torque - given.torque.mean(axis=0), NOISE_PAST_SAMPLES)
    power = uniform_filter1d(noise**2, count, axis=1, mode="nearest")
    is_silent = power < SILENT_SHARE * np.quantile(power, SILENT_QUANTILE)
    measured, expected, left = (
        _change_power(each, slow) for each in (fit.torque, fit.parts.sum(axis=0), fit.residual)
    )
    is_still = measured < STILL_SHARE * expected
    is_still &= expected > LOUD_RATIO * np.median(left)
    is_still = maximum_filter1d(is_still, slow, axis=1)[:, data.whitening :]
    return np.asarray(held | (is_still & at_fit(is_silent, NOISE_PAST_SAMPLES)))


def _change_power(values: Array, samples: int) -> Array:
    """Return the variance of a signal's changes over so many samples about each."""
    change = np.gradient(values, axis=1)
    mean, square = (uniform_filter1d(each, samples, axis=1) for each in (change, change**2))
    return np.asarray(np.maximum(square - mean**2, 0.0))


def _windows(values: NDArray[np.generic], samples: int) -> NDArray[np.generic]:
    """Return windows side by side, shape (realization, window, sample)."""
    count = values.shape[1] // samples
    return values[:, : count * samples].reshape(len(values), count, samples)


def _window_power(first: Array, second: Array, samples: int) -> Array:
    """Return products of deviations from each window's mean, summed, (realization, window)."""
    blocks = [_windows(each, samples) for each in (first, second)]
    deviations = [block - block.mean(axis=2, keepdims=True) for block in blocks]
    return np.asarray(np.einsum("rws,rws->rw", *deviations))


@check(
    "gaps",
    "Gaps in the recording",
    "gaps of 30 ms and more in both signals",
    0,
    "gaps",
    effect="held, zero or interpolated values count as the joint's response: the stiffness is "
    "wrong, and bands are too narrow",
    remedy="tvsysid identify --period leaves out realizations with gaps; in Python, "
    "tv.preprocess.segment(decimated, period, gaps=tv.preprocess.find_gaps(recording))",
)
def gaps(recording: Recording) -> Measured:
    """Count the gaps in both signals of a recording."""
    found = find_gaps(recording)
    if not found:
        return Measured(0.0, "no gap in both signals")
    longest = max(found, key=lambda gap: gap.stop - gap.start)
    more = f", and {len(found) - 1} times more" if len(found) > 1 else ""
    what = (
        f"both signals stand still, or are interpolated, for {longest.stop - longest.start:.2g} s "
        f"at {longest.start:.4g} s in trial {longest.trial + 1}{more}"
    )
    return Measured(len(found), what)


@check(
    "mains",
    "Mains hum in the angle",
    "RMS of a line at 50 or 60 Hz, over that of the angle",
    1,
    "%",
    effect="the hum has a large acceleration without a response: the inertia comes out too low, "
    "and the stiffness wrong",
    remedy="tvsysid identify subtracts it; in Python, tv.preprocess.remove_mains(recording, 50) "
    "before decimation",
)
def mains(recording: Recording) -> Measured:
    """Return the size of mains hum in the angle of a recording."""
    frequency, share = find_mains(recording)
    return Measured(share, f"a line at {frequency:g} Hz has {share:.2g} % of the angle's RMS")


@check(
    "torque-spikes",
    "Spikes in the torque",
    "highest sample that neither the joint's model nor the past predicts, over the 90th percentile "
    "of all",
    8,
    "times",
    effect="single samples with large errors dominate a least-squares fit",
    remedy=INTERPOLATE,
    which="torque",
)
@check(
    "angle-spikes",
    "Spikes in the angle",
    "highest sample that the angle's past does not predict, over the 99th percentile of all",
    2.5,
    "times",
    effect="a spike has a large acceleration without a response: the inertia comes out too low",
    remedy=INTERPOLATE,
    which="angle",
)
def spikes(data: FittedEnsemble, which: str) -> Measured:
    """Return the height of the highest spike."""
    heights = data.spike_heights[which]
    value = heights.max()
    if value == 0:
        return Measured(0.0, "none")
    realization, sample = np.unravel_index(int(np.argmax(heights)), heights.shape)
    beyond = heights > FAULTS[f"{which}-spikes"].limit
    count = int(np.count_nonzero(beyond))
    what = (
        f"the highest is {value:.3g} times as high as is usual, in realization {realization} at "
        f"{data.seconds(int(sample)):.3g} s{f'; {count} samples stand out' if count > 1 else ''}"
    )
    return Measured(value, what, realizations=indices(beyond.any(axis=1)))
