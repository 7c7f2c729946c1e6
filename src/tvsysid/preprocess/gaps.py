"""Gaps: where nothing was recorded, and both signals were held, set to zero or interpolated."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tvsysid.signals import Recording

SHORTEST_S, SHORTEST = 0.03, 10  # of a gap, in s and in samples
FEW, LARGEST_SHARE = 3, 0.05  # more gaps than that, of more of a record, are rests, or coarse steps
STRAIGHT, ROUNDING = (
    1e-2,
    1e-12,
)  # share of the usual bend, and of the largest value, below which a signal is straight
STEPS = 1.5  # of the torque's converter that a torque at rest bends by at most


class Gap(NamedTuple):
    """Number of the trial that a gap is in, and when it starts and stops, in s of the trial as it was recorded."""

    trial: int
    start: float
    stop: float


def find_gaps(recording: Recording) -> tuple[Gap, ...]:
    """Find where angle and torque both stand still, or lie on a straight line, for 30 ms and 10 samples or more.

    Give them to :func:`tvsysid.preprocess.segment`. Look for them before decimation, which hides
    them. Signals that rest, recorded in coarse steps, are no gap: they leave a rest by one step,
    rest for 10 ms more often than for 30, or rest more than three times for more than a twentieth
    of the record.

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
    moves = (np.maximum(beside[first], beside[last + 1]) > STEPS * step) | (
        torque[first] > tolerance[1]
    )
    length, shortest = last - first + 2, max(SHORTEST_S * rate, SHORTEST)
    gap = moves & (length >= shortest)
    brief = (length >= shortest / 3) & (length < shortest)
    if brief.sum() > gap.sum() or (
        gap.sum() > FEW and length[gap].sum() > LARGEST_SHARE * len(recording)
    ):
        return ()
    trials = np.searchsorted(starts, first[gap], "right") - 1
    within = np.stack([first[gap], last[gap] + 2]) - starts[trials]
    times = recording.origin + recording.start + within / rate
    return tuple(
        Gap(int(trial), float(start), float(stop))
        for trial, start, stop in zip(trials, *times, strict=True)
    )
