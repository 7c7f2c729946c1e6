"""Cut a recording into realizations, and take out what they have in common."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tvsysid.errors import InputError
from tvsysid.preprocess.steps import check_seconds, every_signal
from tvsysid.signals import Array, Ensemble, Recording


def segment(recording: Recording, period: float, context: float = 0.5) -> Ensemble:
    """Cut each trial into realizations that begin at multiples of the period from time 0.

    Parameters
    ----------
    recording
        What to cut.
    period
        Duration of a realization in s: a whole number of samples.
    context
        Seconds of the record that each realization keeps on either side. Realizations at the ends that lack it are left
        out, and ``left_out`` of the ensemble counts them; 0 keeps them all.

    Returns
    -------
    Ensemble
        Every realization that the record holds whole, in order.

    Raises
    ------
    InputError
        If the period is not a whole number of samples, or longer than the record.
    """
    rate = recording.sampling_rate
    check_seconds("segment", period=period, context=context)
    if round(period * rate) < 1:
        raise InputError(f"segment: a period of {period!r} s is shorter than a sample at {rate:g} Hz")
    samples, margin = _whole_samples(period, rate), round(context * rate)
    firsts: list[int] = []
    trials: list[int] = []
    left_out = 0
    for number, trial in enumerate(recording.trials):
        length = trial.stop - trial.start
        # First multiple of the period at or after the trial's first sample, as a sample of the trial.
        first = math.ceil(round(recording.start * rate) / samples) * samples - round(recording.start * rate)
        whole = range(first, length - samples + 1, samples)
        with_context = [i for i in whole if i >= margin and i + samples + margin <= length]
        left_out += len(whole) - len(with_context)
        firsts += [trial.start + i for i in with_context]
        trials += [number] * len(with_context)
    if not firsts:
        longest = max(trial.stop - trial.start for trial in recording.trials) / rate
        advice = (
            "give less context (--context 0 keeps every realization)"
            if left_out
            else "give a shorter period (--period)"
        )
        raise InputError(
            f"segment: no realization of {period:g} s with {context:g} s of context on both sides fits into "
            f"{longest:g} s of record from {recording.start:g} s on; {advice}"
        )
    index = np.array(firsts)
    trial_of = np.array(trials)
    within = index - np.array(recording.trial_starts)[trial_of]

    def cut(x: Array) -> Array:
        return np.asarray(sliding_window_view(x, samples + 2 * margin)[index - margin])

    return Ensemble(
        **every_signal(recording, cut),
        sampling_rate=rate,
        context=margin,
        onsets=recording.start + within / rate,
        trials=trial_of,
        left_out=left_out,
    )


def _whole_samples(period: float, rate: float) -> int:
    samples = period * rate
    if abs(samples - round(samples)) > 1e-6 * max(1.0, samples):
        raise InputError(
            f"segment: period {period:g} s is not a whole number of samples at {rate:g} Hz ({samples:g}); "
            "give a rate at which it is one, for with a period that is a little off realizations would drift"
        )
    return round(samples)


def subtract_mean(ensemble: Ensemble, channels: Iterable[str] = ()) -> Ensemble:
    """Subtract from angle and torque, at each time, their mean over realizations.

    What all realizations share (the voluntary torque, an imposed movement) is no answer to the perturbation.

    Parameters
    ----------
    ensemble
        At least two realizations.
    channels
        Channels that lose their mean too: those that act on angle or torque, such as a reference signal or the EMG that
        drives a reflex. A channel that only schedules the joint's properties keeps it.

    Returns
    -------
    Ensemble
        Deviations from the mean, with ``mean_subtracted`` set.

    Raises
    ------
    InputError
        For a single realization, which would leave nothing, or a channel that is not there.
    """
    if len(ensemble) < 2:
        raise InputError(
            "subtract_mean: expected at least two realizations, got one; its mean is the signal itself; cut the "
            "recording with a shorter period (--period)"
        )
    deviations = {}
    for name in dict.fromkeys(("angle", "torque", *channels)):
        values = ensemble.signal(name)
        deviations[name] = values - values.mean(axis=0)
        if np.abs(deviations[name]).max() <= 1e-12 * np.abs(values).max():
            raise InputError(
                f"subtract_mean: the {name} is the same in all {len(ensemble)} realizations, so that nothing is left; "
                "the perturbation must differ from realization to realization"
            )
    pair = {name: deviations.pop(name) for name in ("angle", "torque")}
    return replace(ensemble, **pair, channels={**ensemble.channels, **deviations}, mean_subtracted=True)
