"""Take the ends off each trial."""

from __future__ import annotations

import numpy as np

from tvsysid.errors import InputError
from tvsysid.preprocess.steps import check_seconds, every_signal
from tvsysid.signals import Array, Recording


def trim(recording: Recording, ends: float, margin: float = 0.0) -> Recording:
    """Remove the first and last seconds of each trial, and count its time from where what is left begins.

    Parameters
    ----------
    recording
        What to trim.
    ends
        Seconds to remove at both ends of each trial.
    margin
        Seconds of the ends that are kept for context, at negative times and after the end.

    Returns
    -------
    Recording
        Begins ``margin`` seconds before time 0.

    Raises
    ------
    InputError
        If the margin is longer than the ends, or a trial has nothing left.
    """
    check_seconds("trim", ends=ends, margin=margin)
    if margin > ends:
        raise InputError(f"trim: a margin of {margin:g} s cannot be kept of ends of {ends:g} s; give a shorter one")
    rate = recording.sampling_rate
    outside, kept_outside = round(ends * rate), round(margin * rate)
    cut = outside - kept_outside
    shortest = min(trial.stop - trial.start for trial in recording.trials)
    if shortest <= 2 * outside:
        raise InputError(f"trim: ends of {ends:g} s leave nothing of a trial of {shortest / rate:g} s")
    inner = [slice(trial.start + cut, trial.stop - cut) for trial in recording.trials]
    lengths = [trial.stop - trial.start for trial in inner]

    def trimmed(x: Array) -> Array:
        return np.concatenate([x[trial] for trial in inner])

    starts = tuple(int(first) for first in np.cumsum([0, *lengths[:-1]]))
    return Recording(
        **every_signal(recording, trimmed), sampling_rate=rate, start=-kept_outside / rate, trial_starts=starts
    )
