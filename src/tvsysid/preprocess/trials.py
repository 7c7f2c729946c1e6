"""Align, decimate and trim the trials of a recording, and cut them into realizations."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import attrs
import numpy as np

from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.numerics.decimation import SHARP, TAPS, keep_every
from tvsysid.numerics.interpolation import SINC, advanced
from tvsysid.signals import Array, Ensemble, Recording
from tvsysid.validators import between, finite, not_negative, positive

MIN_RATE_HZ = 40.0  # below, stiffness and inertia can hardly be separated
SMEARED_S = 0.015  # time on either side of a gap over which the decimation filter smears it


class Gap(NamedTuple):
    """Gap in a trial, from ``start`` to ``stop`` in s of the trial as it was recorded."""

    trial: int
    start: float
    stop: float


def map_trials(
    recording: Recording, change: Callable[[Array], Array], **attributes: Any
) -> Recording:
    """Apply a function to every signal of each trial. Return the new recording.

    Parameters
    ----------
    change
        Function of the samples of one trial. It may change their number.
    attributes
        Other attributes of the new recording.

    Raises
    ------
    InputError
        If no sample of a trial is left.
    """
    lengths: list[int] = []

    def change_all(values: Array) -> Array:
        changed = [change(values[trial]) for trial in recording.trials]
        lengths[:] = map(len, changed)
        return np.concatenate(changed)

    signals = recording.mapped(change_all)
    if min(lengths) < 1:
        shortest = recording.trial_lengths.min() / recording.sampling_rate
        raise InputError(f"no sample is left of a trial of {shortest:g} s; remove less of it")
    starts = (0, *np.cumsum(lengths[:-1]).tolist())
    return attrs.evolve(recording, **signals | {"trial_starts": starts} | attributes)


def nearest_rate(recorded: float, rate: float, period: float = 1.0) -> float:
    """Return the rate in Hz nearest to ``rate`` among those that decimation can give.

    Rates at which a period in s is a whole number of samples are preferred.
    """

    def order(possible: float) -> tuple[bool, float]:
        samples = possible * period
        return abs(samples - round(samples)) > 1e-9 * samples, abs(possible - rate)

    return min((recorded / factor for factor in range(1, int(recorded) + 2)), key=order)


def decimate(recording: Recording, rate: float, *, sharp: bool = False) -> Recording:
    r"""Low-pass filter all signals and keep every r-th sample, r being the ratio of the rates.

    The filter is a 31-tap Hamming-window FIR with -6 dB at the new Nyquist frequency. Its delay is
    removed, so that the first sample stays the first. The ends of each trial are continued by odd
    reflection. A sudden change is smeared over :math:`\pm 15` samples of the old rate.

    All signals pass the same filter, which therefore cancels in the identification of a joint that
    does not vary. If you need the envelope of an EMG, compute it before. The original angle is kept
    as ``recorded_angle``, for methods that rectify its velocity.

    Parameters
    ----------
    recording
        Trials that are no shorter than the filter.
    rate
        New sampling rate in Hz. It must divide the old one.
    sharp
        Use a filter of 20 r + 1 taps, for angle and torque with power above the new Nyquist
        frequency. The 31-tap filter lets this power pass as aliases, which no method can explain.
        The sharp filter smears a sudden change over :math:`\pm 10` samples of the new rate.

    Warns
    -----
    DataQualityWarning
        If the new rate is below 40 Hz, which leaves too little of a joint's response.

    References
    ----------
    van de Ruit et al. 2021, sections 3.1.3 and 4.1.4 (50-Hz, respectively 64-Hz, 30th-order
    low-pass).
    """
    positive.check("decimate", "rate", rate)
    ratio = recording.sampling_rate / rate
    factor = round(ratio)
    if factor < 1 or abs(ratio - factor) > 1e-9 * ratio:
        nearest = nearest_rate(recording.sampling_rate, rate)
        raise InputError(
            f"decimate: {recording.sampling_rate:g} Hz is not a whole multiple of {rate:g} Hz; the "
            f"nearest rate that fits is {nearest:g} Hz"
        )
    if factor == 1:
        return recording
    taps = SHARP * factor + 1 if sharp else TAPS
    shortest = recording.trial_lengths.min()
    if shortest < taps:
        raise InputError(
            f"decimate: a trial of {shortest} samples is shorter than the filter's {taps} samples"
        )
    if rate < MIN_RATE_HZ:
        warnings.warn(
            f"decimated to {rate:g} Hz, the record holds nothing above {rate / 2:g} Hz. Stiffness, "
            "viscosity and inertia can hardly be separated. Give the new rate in Hz (100 is "
            "usual), not a factor.",
            DataQualityWarning,
            stacklevel=2,
        )

    def group(angle: Array) -> Array:
        """Group the recorded samples by kept sample. Repeat the last sample to fill its group."""
        size = factor * angle.shape[1]
        return np.pad(angle.ravel(), (0, -angle.size % size), "edge").reshape(-1, size)

    recorded = [group(recording.angle_as_recorded[trial]) for trial in recording.trials]
    if recording.recorded_angle is not None:  # from an earlier decimation
        recording = attrs.evolve(recording, recorded_angle=None)
    return map_trials(
        recording,
        lambda values: keep_every(values, factor, taps),
        recorded_angle=np.concatenate(recorded),
        sampling_rate=rate,
    )


def align_channels(recording: Recording, delay: float) -> Recording:
    """Shift the torque to an earlier time, to correct a delay of its filter or clock.

    Between samples, the torque is interpolated (windowed sinc). Samples without a torque are cut
    off one end of each trial. Other channels stay aligned with the angle. ``delay_removed`` states
    the correction in the recording, in ensembles cut from it, and in the diagnostics of models.

    Parameters
    ----------
    delay
        Seconds by which the torque was recorded later than the angle; negative if earlier. The
        finding ``delay`` of :func:`tvsysid.diagnose` estimates it, in ms. Correct it before
        decimation.

    Raises
    ------
    InputError
        For a delay that is not a number, or as long as a trial.

    Examples
    --------
    >>> import numpy as np
    >>> angle = np.sin(np.arange(1000) / 50)
    >>> late = Recording(angle[3:], 80 * angle[:-3], sampling_rate=1000)
    >>> aligned = align_channels(late, 0.003)
    >>> bool(np.allclose(aligned.torque, 80 * aligned.angle)), len(aligned), aligned.delay_removed
    (True, 994, 0.003)
    """
    finite.check("align_channels", "delay", delay)
    samples = float(delay * recording.sampling_rate)
    lost = math.ceil(abs(samples) - 1e-9)
    head, tail = (lost, 0) if samples < 0 else (0, lost)

    def shift(torque: Array) -> Array:
        padded = np.pad(torque, SINC, "reflect", reflect_type="odd")
        return advanced(padded, samples)[SINC:-SINC]

    def cut(values: Array) -> Array:
        return values[head:][: -tail or None]

    torque = np.concatenate([cut(shift(recording.torque[trial])) for trial in recording.trials])
    aligned = map_trials(
        recording,
        cut,
        start=recording.start + head / recording.sampling_rate,
        delay_removed=recording.delay_removed + delay,
    )
    return attrs.evolve(aligned, torque=torque)


def trim(recording: Recording, ends: float, margin: float = 0.0) -> Recording:
    """Remove both ends of each trial. Time 0 moves to where the first end stops.

    Parameters
    ----------
    ends
        Seconds to remove at both ends of each trial.
    margin
        Seconds of each end that are kept for context. The recording then begins ``margin`` seconds
        before time 0.
    """
    not_negative.check("trim", "ends", ends)
    between(0, ends).check("trim", "margin", margin)
    rate = recording.sampling_rate
    outside = round(ends * rate)
    kept_outside = round(margin * rate)
    cut = outside - kept_outside
    return map_trials(
        recording,
        lambda values: values[cut : -cut or None],
        start=-kept_outside / rate,
        origin=recording.origin + recording.start + outside / rate,
    )


def excerpt(recording: Recording, duration: float = 10.0) -> Recording:
    """Return some seconds from the middle of the first trial, or all of it if it is shorter."""
    trial = recording.trials[0]
    samples = min(round(duration * recording.sampling_rate), trial.stop)
    first = (trial.stop - samples) // 2
    part = recording.mapped(lambda values: values[first : first + samples])
    return attrs.evolve(recording, **part, start=recording.time[first], trial_starts=(0,))


def segment(
    recording: Recording, period: float | None, context: float = 0.5, gaps: Iterable[Gap] = ()
) -> Ensemble:
    """Cut each trial into realizations, which begin at time 0 and at multiples of the period.

    Parameters
    ----------
    period
        Duration of a realization in s: a whole number of samples. None, for movements that are not
        repeated, makes one realization of each trial. All are as long as the shortest trial without
        its context.
    context
        Seconds of the record that each realization keeps on either side. Realizations without this
        much context are left out, and counted in ``left_out``. With 0 all are kept.
    gaps
        Gaps that :func:`tvsysid.preprocess.find_gaps` found before the recording was decimated.
        Realizations with a gap, also in their context, are left out. Ignored without a period.
    """
    rate = recording.sampling_rate
    not_negative.check("segment", "context", context)
    margin = round(context * rate)
    lengths = recording.trial_lengths
    if period is None:
        samples = lengths.min() - 2 * margin
        earliest = margin
        step = lengths.max()
    else:
        positive.check("segment", "period", period)
        samples = step = round(period * rate)
        if not math.isclose(samples, period * rate, rel_tol=1e-6):
            raise InputError(
                f"segment: period {period:g} s is not a whole number of samples at {rate:g} Hz; "
                "give a rate at which it is one (--decimate, or decimate)"
            )
        # First multiple of the period at or after the first sample of a trial.
        earliest = -round(recording.start * rate) % samples
    begins = [
        (number, first)
        for number, length in enumerate(lengths)
        for first in range(earliest, length - samples + 1, step)
    ]
    trials, first = np.array(begins, dtype=np.int64).reshape(-1, 2).T
    has_context = (first >= margin) & (first + samples + margin <= lengths[trials])
    kept = has_context.copy()
    reach = margin + math.ceil(SMEARED_S * rate)
    start = recording.origin + recording.start
    for gap in gaps if period else ():
        begin = (gap.start - start) * rate - reach
        end = (gap.stop - start) * rate + reach
        kept &= (trials != gap.trial) | (first + samples <= begin) | (first >= end)
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
        **recording.mapped(lambda values: values[index]),
        sampling_rate=rate,
        context=margin,
        onsets=recording.start + first / rate,
        trials=trials,
        left_out=int(np.sum(~has_context)),
        origin=recording.origin,
        delay_removed=recording.delay_removed,
    )
