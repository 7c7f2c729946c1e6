"""Find gaps: stretches that were not recorded, but held, set to zero or interpolated."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tvsysid.signals import Recording

MIN_GAP_S, MIN_GAP_SAMPLES = 0.03, 10
# A record with more gaps than this, over a larger share of it, holds rests or coarse steps.
MAX_GAPS, MAX_SHARE = 3, 0.05
# A signal is straight where it bends by less than these shares of its median bend and its maximum.
STRAIGHT, ROUNDING = 1e-2, 1e-12
MAX_REST_STEPS = 1.5  # resolution steps by which a torque at rest bends at most


class Gap(NamedTuple):
    """Gap in a trial, from ``start`` to ``stop`` in s of the trial as it was recorded."""

    trial: int
    start: float
    stop: float


def find_gaps(recording: Recording) -> tuple[Gap, ...]:
    """Find where both angle and torque are constant or straight for 30 ms and 10 samples or more.

    Give them to :func:`tvsysid.preprocess.segment`. Look for gaps before decimation, which hides
    them. Rests of signals recorded in coarse steps are no gaps. They end with a change by one step,
    last 10 ms more often than 30 ms, or occur more than three times in more than a twentieth of the
    record.

    Examples
    --------
    >>> import numpy as np
    >>> angle, torque = np.random.default_rng(0).normal(size=(2, 2000))
    >>> angle[500:550], torque[500:550] = angle[500], 0.0
    >>> find_gaps(Recording(angle, torque, sampling_rate=1000))
    (Gap(trial=0, start=0.5, stop=0.55),)
    """
    rate, starts = recording.sampling_rate, np.array(recording.trial_starts)
    signals = np.stack([recording.angle, recording.torque])
    slopes = np.diff(signals, axis=1)
    bends = np.abs(np.diff(slopes, axis=1))
    if not bends.size:
        return ()
    tolerance = STRAIGHT * np.median(bends, axis=1) + ROUNDING * np.abs(signals).max(axis=1)
    straight = (bends <= tolerance[:, None]).all(axis=0)
    for begin in starts[1:]:
        straight[begin - 2 : begin] = False
    first, last = np.flatnonzero(np.diff(np.pad(straight, 1))).reshape(-1, 2).T
    torque = np.abs(slopes[1])
    step = np.min(torque, where=torque > tolerance[1], initial=np.inf)
    beside = np.pad(bends[1], 1)
    largest = np.maximum(beside[first], beside[last + 1])
    is_no_rest = (largest > MAX_REST_STEPS * step) | (torque[first] > tolerance[1])
    length, shortest = last - first + 2, max(MIN_GAP_S * rate, MIN_GAP_SAMPLES)
    is_gap = is_no_rest & (length >= shortest)
    brief = (length >= shortest / 3) & (length < shortest)
    many = is_gap.sum() > MAX_GAPS and length[is_gap].sum() > MAX_SHARE * len(recording)
    if many or brief.sum() > is_gap.sum():
        return ()
    trials = np.searchsorted(starts, first[is_gap], "right") - 1
    within = np.stack([first[is_gap], last[is_gap] + 2]) - starts[trials]
    times = recording.origin + recording.start + within / rate
    return tuple(map(Gap, trials.tolist(), *times.tolist()))
