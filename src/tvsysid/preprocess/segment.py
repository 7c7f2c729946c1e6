"""Take the ends off a recording, and cut it into realizations."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from tvsysid.errors import InputError
from tvsysid.preprocess.gaps import Gap
from tvsysid.preprocess.trials import map_signals, map_trials, shortest_trial
from tvsysid.signals import Ensemble, Recording
from tvsysid.validators import between, not_negative, positive

SMEARED_S = 0.015  # to either side of a gap, by the filter of decimation


def trim(recording: Recording, ends: float, margin: float = 0.0) -> Recording:
    """Remove the first and last seconds of each trial. Time 0 is where the rest begins.

    Parameters
    ----------
    ends
        Seconds to remove at both ends of each trial.
    margin
        Seconds of the ends that are kept for context. The recording then begins ``margin`` seconds
        before time 0.
    """
    not_negative.check("trim", "ends", ends)
    between(0, ends).check("trim", "margin", margin)
    rate, shortest = recording.sampling_rate, shortest_trial(recording)
    outside, kept_outside = round(ends * rate), round(margin * rate)
    if shortest <= 2 * outside:
        raise InputError(
            f"trim: ends of {ends:g} s leave nothing of a trial of {shortest / rate:g} s"
        )
    cut = outside - kept_outside
    return map_trials(
        recording,
        lambda values: values[cut : len(values) - cut],
        start=-kept_outside / rate,
        origin=recording.origin + recording.start + outside / rate,
    )


def segment(
    recording: Recording, period: float | None, context: float = 0.5, gaps: Iterable[Gap] = ()
) -> Ensemble:
    """Cut each trial into realizations, which begin at multiples of the period from time 0.

    Parameters
    ----------
    period
        Duration of a realization in s: a whole number of samples. None, for behaviour that is not
        repeated, makes one realization of each trial. All are as long as the shortest trial without
        its context.
    context
        Seconds of the record that each realization keeps on either side. Realizations too near the
        ends for it are left out, and counted in ``left_out``. With 0 all are kept.
    gaps
        Gaps that :func:`tvsysid.preprocess.find_gaps` found before the recording was decimated.
        Realizations with a gap, also in their context, are left out. Ignored without a period.
    """
    rate = recording.sampling_rate
    not_negative.check("segment", "context", context)
    margin = round(context * rate)
    lengths = np.array([trial.stop - trial.start for trial in recording.trials])
    if period is None:
        samples = int(lengths.min()) - 2 * margin
        begins = [(number, margin) for number in range(len(lengths))]
    else:
        samples = _samples_of(period, rate)
        # First multiple of the period at or after the first sample of a trial.
        earliest = -round(recording.start * rate) % samples
        begins = [
            (number, first)
            for number, length in enumerate(lengths)
            for first in range(earliest, length - samples + 1, samples)
        ]
    trials, first = np.array(begins, dtype=np.int64).reshape(-1, 2).T
    has_context = (first >= margin) & (first + samples + margin <= lengths[trials])
    kept = has_context.copy()
    reach, start = margin + math.ceil(SMEARED_S * rate), recording.origin + recording.start
    for gap in gaps if period else ():
        before = first + samples <= (gap.start - start) * rate - reach
        after = first >= (gap.stop - start) * rate + reach
        kept &= (trials != gap.trial) | before | after
    if samples < 1 or not kept.any():
        duration = f" of {period:g} s" if period else ""
        raise InputError(
            f"segment: no realization{duration} with {context:g} s of context on both sides and "
            f"without a gap fits into a trial of {lengths.max() / rate:g} s; give a shorter period "
            "(--period) or less context (--context 0 keeps every realization), or read trials that "
            "follow each other as one (--columns contiguous)"
        )
    trials, first = trials[kept], first[kept]
    within = np.arange(-margin, samples + margin)
    index = (first + np.array(recording.trial_starts)[trials])[:, None] + within
    return Ensemble(
        **map_signals(recording, lambda values: values[index]),
        sampling_rate=rate,
        context=margin,
        onsets=recording.start + first / rate,
        trials=trials,
        left_out=int(np.sum(~has_context)),
        origin=recording.origin,
        delay_removed=recording.delay_removed,
    )


def _samples_of(period: float, rate: float) -> int:
    """Return the samples of a period, which must be a whole number."""
    positive.check("segment", "period", period)
    samples = period * rate
    if round(samples) < 1 or abs(samples - round(samples)) > 1e-6 * max(1.0, samples):
        raise InputError(
            f"segment: period {period:g} s is not a whole number of samples at {rate:g} Hz "
            f"({samples:g}); give a rate at which it is one (--decimate, or decimate)"
        )
    return round(samples)
