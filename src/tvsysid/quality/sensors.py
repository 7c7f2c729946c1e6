"""Check for sensors at their limits, lost signals, mains hum and spikes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import maximum_filter1d, median_filter

from tvsysid.preprocess import find_gaps, find_mains
from tvsysid.quality.checks import FAULTS, Measured, NotApplicable, check, indices
from tvsysid.quality.fit import NOISE_PAST, FittedEnsemble
from tvsysid.quality.statistics import TINY, over_usual
from tvsysid.signals import Array, Recording

MIN_TIED_REALIZATIONS = 3  # at a limit at the same time
TIE_TOLERANCE = 1e-3  # of a standard deviation
# Largest share of times with values tied in the middle: relative to the limits, and by chance.
MAX_REPEATED_SHARE, CHANCE = 0.5, 0.01
MIN_MIDDLE_SHARE = 0.2  # of samples within half an RMS; Gaussian numbers have 0.38
WINDOW_SAMPLES = 20  # in which losses are looked for
STILL_SHARE = 0.1  # of the expected power, below which a signal does not move
LOUD_RATIO = 4.0  # to the usual power of the residual
# Quantiles over which spikes are measured. A PRBS surprises at every switch, noise never.
USUAL_SURPRISE, USUAL_RESIDUAL = 0.99, 0.9
SPIKE_SAMPLES, SPREAD_SAMPLES = 7, 13  # widths of a median filter, and of a spike's derivatives
# Distance from the median beside it, over the usual: of a spike, and of one that looks like a loss.
MIN_ALONE, MIN_FAR = 1.2, 2.0
MIN_DISTURBANCE = 4.5  # residual beside a spike in the angle, over the usual
SCATTER = 2.0  # level of the residual at one time that is due to chance, over the usual level
EXCLUDE = "exclude the realizations concerned"
INTERPOLATE = "interpolate the samples or exclude the realizations; check the cables"


@check(
    "clipped-torque",
    "The torque is clipped",
    "times at which the highest or lowest values of several realizations are equal",
    2,
    "%",
    "serious",
    effect="a large torque is measured too small: stiffness comes out too low where it is high",
    remedy=f"widen the sensor's range; {EXCLUDE}",
    which="torque",
)
@check(
    "clipped-angle",
    "The angle is clipped",
    "times at which the highest or lowest values of several realizations are equal",
    2,
    "%",
    "serious",
    effect="the torque changes while the angle stays at a limit: stiffness comes out too high",
    remedy=f"widen the sensor's range; {EXCLUDE}",
    which="angle",
)
def clipped(data: FittedEnsemble, which: str) -> Measured:
    """Return the share of times at which several realizations tie at the highest or lowest value.

    The mean over realizations may have been subtracted. So values at a sensor's limit are the same
    only at one time.
    """
    count = MIN_TIED_REALIZATIONS
    values = data.given.signal(which)[:, data.given.core]
    data.require(2 * count, response=False)
    deviations = values - values.mean(axis=0)
    ordered = np.sort(values, axis=0)
    size = np.std(deviations)
    is_tied = ordered[count - 1 :] - ordered[: 1 - count] <= TIE_TOLERANCE * size
    tied = np.mean(is_tied[0] | is_tied[-1])
    if tied == 0:
        return Measured(0.0, f"no {which} stays at a limit")
    middle = len(values) // 2 - count + 1
    if np.mean(is_tied[middle : middle + count].any(axis=0)) > MAX_REPEATED_SHARE * tied + CHANCE:
        raise NotApplicable(  # as of a multisine
            f"values of the {which} repeat, not only extremes: no sign of clipping"
        )
    if np.mean(np.abs(deviations) < 0.5 * size) < MIN_MIDDLE_SHARE:
        raise NotApplicable(f"the {which} switches between two levels, as a PRBS does")
    what = (
        f"at {100 * tied:.1f} % of the times at least {count} realizations have the same highest "
        f"or lowest {which}"
    )
    return Measured(100 * tied, what)


@check(
    "lost-torque",
    "The torque is lost for a while",
    "time during which the angle moves and the torque does not",
    0.08,
    "s",
    "doubtful",
    effect="while the torque is held or zero, the joint seems to have no stiffness",
    remedy=EXCLUDE,
    which="torque",
)
@check(
    "lost-angle",
    "The angle is lost for a while",
    "time during which the torque moves and the angle does not",
    0.25,
    "s",
    "minor",
    effect="the torque seems to change by itself, which adds noise and mostly lowers the stiffness",
    remedy=EXCLUDE,
    which="angle",
)
def lost(data: FittedEnsemble, which: str) -> Measured:
    """Return for how long one signal is lost while the other moves.

    A lost signal stands still, or is only what a subtracted mean left.
    """
    fit = data.fit
    response = fit.white_parts.sum(axis=0)
    residual = fit.white_residual
    expected, there, left = _blocks([response, response + residual, residual]).var(axis=3)
    if which == "torque":
        # Filters of both channels leave hardly any noise. Then the fit's error looks like a loss
        # when whitened.
        changes = np.gradient([fit.parts.sum(axis=0), fit.torque], axis=2)[:, :, NOISE_PAST:]
        moved, followed = _blocks(changes).var(axis=3)
        is_lost = (there < STILL_SHARE * expected) & (followed < 2 * STILL_SHARE * moved)
        is_lost &= expected > LOUD_RATIO * np.median(left)
    else:
        # What is loud at this time in most realizations is noise.
        noise = np.maximum(np.median(left, axis=0), np.median(left))
        common = 0.5 * np.abs(expected + there - left)
        is_lost = np.maximum(expected, common) < STILL_SHARE * there
        is_lost &= left > LOUD_RATIO * noise
    # A spike in the other signal moves much, and nothing responds to it.
    other = _distance_from_median(data, "angle" if which == "torque" else "torque")
    is_spike = maximum_filter1d(other > MIN_FAR, SPREAD_SAMPLES, axis=1)
    is_lost &= ~_blocks(is_spike).any(axis=-1)
    duration = is_lost.sum() * WINDOW_SAMPLES / data.rate
    what = f"the {which} does not follow for {duration:.2g} s"
    return Measured(duration, what, realizations=indices(is_lost.any(axis=1)))


def _blocks(signals: ArrayLike) -> NDArray[Any]:
    """Return windows of samples side by side, shape (..., window, sample)."""
    values = np.asarray(signals)
    count = values.shape[-1] // WINDOW_SAMPLES
    return values[..., : count * WINDOW_SAMPLES].reshape(*values.shape[:-1], count, WINDOW_SAMPLES)


@check(
    "gaps",
    "Gaps in the recording",
    "gaps of 30 ms and more in both signals",
    0,
    "gaps",
    "doubtful",
    effect="held, zero or interpolated values count as the joint's response: the stiffness is "
    "wrong, and bands are too narrow",
    remedy="tvsysid identify --period leaves out realizations with gaps; in Python, "
    "tv.preprocess.segment(decimated, period, gaps=tv.preprocess.find_gaps(recording))",
)
def gaps(recording: Recording) -> Measured:
    """Count the gaps in both signals of a recording."""
    found = find_gaps(recording)
    longest = max((gap.stop - gap.start for gap in found), default=0.0)
    what = (
        f"both signals stand still, or are interpolated, for up to {longest:.2g} s: {len(found)} "
        "times"
    )
    return Measured(len(found), what)


@check(
    "mains",
    "Mains hum in the angle",
    "RMS of a line at 50 or 60 Hz, over that of the angle",
    1,
    "%",
    "doubtful",
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
    "highest sample that neither model nor past predicts, over the 90th percentile of all",
    8,
    "times",
    "minor",
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
    "minor",
    effect="a spike has a large acceleration without a response: the inertia comes out too low",
    remedy=INTERPOLATE,
    which="angle",
)
def spikes(data: FittedEnsemble, which: str) -> Measured:
    """Return the height of the highest spike, over what is usual.

    Neither its past nor its neighbours predict a spike in the angle, and the torque does not
    respond to it. Neither the fit nor the past predicts one in the torque, and none in the
    angle explains it.
    """
    white = data.fit.white_residual
    angle, torque = (
        over_usual(np.abs(data.unpredicted(each)), USUAL_SURPRISE)
        for each in (data.angle, data.torque)
    )
    residual = over_usual(np.abs(white), USUAL_RESIDUAL)
    if which == "angle":
        is_spike = maximum_filter1d(residual, SPREAD_SAMPLES, axis=1) > MIN_DISTURBANCE
        is_spike &= _distance_from_median(data, "angle") > MIN_ALONE
        heights = np.where(is_spike, angle, 0.0)
    else:
        # A residual that is high at this time in most realizations is no spike, but a change of
        # stiffness within a bin. Spikes at one time leave their mean in all others.
        level = np.median(np.abs(white - np.median(white, axis=0)), axis=0)
        usual = max(SCATTER * float(np.median(level)), TINY)
        nearby = maximum_filter1d(angle, 2 * SPREAD_SAMPLES - 1, axis=1)
        is_spike = (torque > angle) & (nearby <= FAULTS["angle-spikes"].limit)
        heights = np.where(is_spike, residual / np.maximum(1.0, level / usual), 0.0)
    value = heights.max()
    what = f"the highest is {value:.3g} times as high as is usual"
    concerned = (heights > FAULTS[f"{which}-spikes"].limit).any(axis=1)
    return Measured(value, what, realizations=indices(concerned))


def _distance_from_median(data: FittedEnsemble, which: str) -> Array:
    """Return the distance of each sample from the median beside it, over the usual.

    A step has none, and a spike all of its height. Shape (realization, time - w).
    """
    values = data.signal(which)
    distance = np.abs(values - median_filter(values, (1, SPIKE_SAMPLES)))
    return over_usual(distance, USUAL_SURPRISE)[:, data.region][:, NOISE_PAST:]
