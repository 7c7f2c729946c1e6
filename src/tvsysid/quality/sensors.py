"""Check for sensors at their limits, lost signals, mains hum and spikes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import maximum_filter1d, median_filter, uniform_filter1d

from tvsysid.preprocess import find_gaps, find_mains
from tvsysid.quality.checks import FAULTS, Measured, NotApplicable, check, indices
from tvsysid.quality.fit import SecondOrderFit
from tvsysid.quality.fitted import FittedEnsemble
from tvsysid.quality.statistics import innovations, over_usual
from tvsysid.signals import Array, Recording

MIN_TIED_REALIZATIONS = 3  # at a limit at the same time
TIE_TOLERANCE = 1e-3  # of a standard deviation
MAX_REPEATED_SHARE = 0.5  # of values tied in the middle, relative to those tied at the limits
MIN_MIDDLE_SHARE = 0.2  # of samples within half an RMS; Gaussian numbers have 0.38
MIN_STEP = 1e-6  # of a standard deviation; smaller differences are rounding
WINDOW_S, MIN_WINDOW_SAMPLES = 0.2, 10  # in which losses are looked for
BRIEF_S, MIN_BRIEF_SAMPLES = 0.06, 40  # of brief losses; at lower rates they do not show
SILENT_SHARE, SILENT_QUANTILE = 0.2, 0.05  # of the noise's power: a silent torque has less
NOISE_PAST_SAMPLES = 6  # from which the torque's noise is predicted
STILL_SHARE = 0.1  # of the expected power, below which a signal does not move
LOUD_RATIO = 4.0  # to the usual power of the residual
QUIET_WINDOWS = 0.25  # share of a realization's windows that are quieter than its noise
# Quantiles over which spikes are measured. A PRBS surprises at every switch, noise never.
USUAL_SURPRISE, USUAL_RESIDUAL = 0.99, 0.9
SPIKE_SAMPLES, SPREAD_SAMPLES = 7, 13  # widths of a median filter, and of a spike's derivatives
# Distance from the median beside it, over the usual, of a spike, and of one that is no loss.
MIN_ALONE, MIN_FAR = 1.2, 2.0
MIN_DISTURBANCE = 4.5  # residual beside a spike in the angle, over the usual
SCATTER = 2.0  # of the residual's level at one time by chance, over the usual level
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
    count, values = MIN_TIED_REALIZATIONS, data.given.signal(which)[:, data.given.core]
    data.require(2 * count, response=False)
    deviations, ordered = values - values.mean(axis=0), np.sort(values, axis=0)
    size = np.std(deviations)
    is_tied = ordered[count - 1 :] - ordered[: 1 - count] <= TIE_TOLERANCE * size
    tied = np.mean(is_tied[0] | is_tied[-1])
    if tied == 0:
        return Measured(0.0, f"no {which} stays at a limit")
    middle = len(values) // 2 - count + 1
    repeated = np.mean(is_tied[middle : middle + count].any(axis=0))
    limit = 0.01 * FAULTS[f"clipped-{which}"].limit
    if repeated > max(MAX_REPEATED_SHARE * tied, limit):  # as of a multisine
        raise NotApplicable(
            f"the same values of {which} come again and again, not only the extremes"
        )
    if which == "angle" and np.mean(np.abs(deviations) < 0.5 * size) < MIN_MIDDLE_SHARE:
        raise NotApplicable("the angle switches between two levels, as a PRBS does")
    what = (
        f"at {100 * tied:.1f} % of the times at least {count} realizations have the same highest "
        f"or lowest {which}"
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
    0.08,
    "s",
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
    effect="the torque seems to change by itself, which adds noise and mostly lowers the stiffness",
    remedy=EXCLUDE,
    which="angle",
)
def lost(data: FittedEnsemble, which: str) -> Measured:
    """Return for how long one signal is lost while the other moves.

    A lost signal stands still, or is only what a subtracted mean left.
    """
    samples = max(MIN_WINDOW_SAMPLES, round(WINDOW_S * data.rate))
    if data.fit.white_residual.shape[1] < samples:
        raise NotApplicable(f"realizations are shorter than {WINDOW_S:g} s")
    windows = (_torque_windows if which == "torque" else _angle_windows)(data.fit, samples)
    # A spike in the other signal moves much, and nothing responds to it.
    other = _distance_from_median(data, "angle" if which == "torque" else "torque")
    is_spike = maximum_filter1d(other > MIN_FAR, SPREAD_SAMPLES, axis=1)
    windows &= ~_blocks(is_spike, samples).any(axis=-1)
    times = np.repeat(windows & (windows.sum() > 1), samples, axis=1)
    if which == "torque" and BRIEF_S * data.given.sampling_rate >= MIN_BRIEF_SAMPLES:
        times |= _held_torque(data)[:, : times.shape[1]]
    if not times.any():
        return Measured(0.0, f"the {which} is there throughout")
    duration, concerned = times.sum() / data.rate, indices(times.any(axis=1))
    begin = data.time[data.fit.whitening + np.argmax(times[concerned[0]])]
    what = (
        f"the {which} does not follow for {duration:.2g} s in {len(concerned)} realizations, first "
        f"in realization {concerned[0]} from about {begin:.2g} s on"
    )
    return Measured(duration, what, realizations=concerned)


def _torque_windows(fit: SecondOrderFit, samples: int) -> NDArray[np.bool_]:
    """Return windows in which only the angle moves, shape (realization, window)."""
    expected, there, left = _white_powers(fit, samples)
    is_lost = expected > np.maximum(np.median(expected), LOUD_RATIO * np.median(left))
    is_lost &= there < STILL_SHARE * expected
    # Filters of both channels leave hardly any noise. Then the fit's error looks like a loss when
    # whitened.
    changes = np.gradient([fit.parts.sum(axis=0), fit.torque], axis=2)[:, :, fit.whitening :]
    expected, there = _blocks(changes, samples).var(axis=3)
    return np.asarray(is_lost & (there < 2 * STILL_SHARE * expected))


def _angle_windows(fit: SecondOrderFit, samples: int) -> NDArray[np.bool_]:
    """Return windows in which only the torque moves, shape (realization, window)."""
    expected, there, left = _white_powers(fit, samples)
    # What is loud at this time in most realizations, or at most times in this one, is noise.
    noise = np.maximum(np.median(left), np.quantile(left, QUIET_WINDOWS, axis=1))[:, None]
    noise = np.maximum(np.median(left, axis=0), noise)
    is_lost = (left > LOUD_RATIO * noise) & (expected < STILL_SHARE * there)
    common = 0.5 * np.abs(expected + there - left)
    return np.asarray(is_lost & (common < STILL_SHARE * there))


def _white_powers(fit: SecondOrderFit, samples: int) -> Array:
    """Return the variance in windows of response, torque and residual, all whitened."""
    response, residual = fit.white_parts.sum(axis=0), fit.white_residual
    return np.asarray(_blocks([response, response + residual, residual], samples).var(axis=3))


def _held_torque(data: FittedEnsemble) -> NDArray[np.bool_]:
    """Find brief times at which the torque is held at a high rate, shape (realization, time - w).

    It does not follow the angle, and has no noise of its own, which is what the torque's past does
    not predict at the given rate. At some 100 Hz, so short a time has too few samples.
    """
    torque, fit, rate = data.given.torque, data.fit, data.given.sampling_rate
    noise = innovations(torque - torque.mean(axis=0), NOISE_PAST_SAMPLES)
    count, slow_count = (round(BRIEF_S * each) for each in (rate, data.rate))
    power = uniform_filter1d(noise**2, count, axis=1)
    silent = power < SILENT_SHARE * np.quantile(power, SILENT_QUANTILE)
    places = np.round(data.time * rate).astype(np.int64) + data.given.context
    silent = maximum_filter1d(silent, count, axis=1)[:, places.clip(max=silent.shape[1] - 1)]
    residual = uniform_filter1d(np.gradient(fit.residual, axis=1) ** 2, slow_count, axis=1)
    is_loud = maximum_filter1d(residual > LOUD_RATIO * np.median(residual), slow_count, axis=1)
    return np.asarray((silent & is_loud)[:, fit.whitening :])


def _blocks(signals: ArrayLike, samples: int) -> NDArray[Any]:
    """Return blocks of samples side by side, shape (..., block, sample)."""
    values = np.asarray(signals)
    count = values.shape[-1] // samples
    return values[..., : count * samples].reshape(*values.shape[:-1], count, samples)


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
    heights = _spike_heights(data)[which]
    value = heights.max()
    if value == 0:
        return Measured(0.0, "none")
    realization, sample = np.unravel_index(np.argmax(heights), heights.shape)
    is_spike = heights > FAULTS[f"{which}-spikes"].limit
    what = (
        f"the highest is {value:.3g} times as high as is usual, in realization {realization} at "
        f"{data.time[data.fit.whitening + sample]:.3g} s"
    )
    if (count := np.count_nonzero(is_spike)) > 1:
        what += f"; {count} samples stand out"
    return Measured(value, what, realizations=indices(is_spike.any(axis=1)))


def _spike_heights(data: FittedEnsemble) -> dict[str, Array]:
    """Return the height of spikes in angle and torque over the usual, zero elsewhere.

    Neither its past nor its neighbours predict a spike in the angle, and the torque does not
    respond to it. Neither the fit nor the past predicts one in the torque, and none in the
    angle explains it. Shape (realization, time - w).
    """
    white = data.fit.white_residual
    angle, torque, residual = (
        over_usual(np.abs(values), quantile)
        for values, quantile in (
            (data.unpredicted(data.angle), USUAL_SURPRISE),
            (data.unpredicted(data.torque), USUAL_SURPRISE),
            (white, USUAL_RESIDUAL),
        )
    )
    is_spike = maximum_filter1d(residual, SPREAD_SAMPLES, axis=1) > MIN_DISTURBANCE
    is_spike &= _distance_from_median(data, "angle") > MIN_ALONE
    # A residual that is high at this time in most realizations is no spike, but a change of
    # stiffness within a bin. Spikes at one time leave their mean in all others.
    level = np.median(np.abs(white - np.median(white, axis=0)), axis=0)
    usual = max(SCATTER * float(np.median(level)), np.finfo(float).tiny)
    nearby = maximum_filter1d(angle, 2 * SPREAD_SAMPLES - 1, axis=1)
    is_angle = nearby > FAULTS["angle-spikes"].limit
    return {
        "angle": np.where(is_spike, angle, 0.0),
        "torque": np.where(
            (torque > angle) & ~is_angle, residual / np.maximum(1.0, level / usual), 0.0
        ),
    }


def _distance_from_median(data: FittedEnsemble, which: str) -> Array:
    """Return the distance of each sample from the median beside it, over the usual.

    A step has none, and a spike all of its height. Shape (realization, time - w).
    """
    values = data.signal(which)
    distance = np.abs(values - median_filter(values, (1, SPIKE_SAMPLES)))
    return over_usual(distance, USUAL_SURPRISE)[:, data.white_region]
