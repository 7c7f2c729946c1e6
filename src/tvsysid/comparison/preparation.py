"""Read and correct a recording, and cut it into realizations, as ``tvsysid identify`` does."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import attrs
import numpy as np

from tvsysid import preprocess
from tvsysid.comparison.identify import compare
from tvsysid.comparison.prepared import Correction, PreparedRecording
from tvsysid.errors import InputError, without_quality_warnings
from tvsysid.methods.cascade.reflex_test import prediction_p_value
from tvsysid.metrics import vaf
from tvsysid.quality import diagnose, diagnose_recording
from tvsysid.quality.checks import judge
from tvsysid.recordings import read_recording
from tvsysid.recordings.reading import split_settings
from tvsysid.recordings.saved import saved_settings
from tvsysid.signals import Ensemble, Recording

SIGNIFICANCE = 0.05  # p-value below which one candidate predicts better than another
MIN_REALIZATIONS = 2  # to predict one by the others
PIECE_S = 2.0  # duration of the pieces in which a record without a period is diagnosed


def prepare(
    source: str | Path | Recording,
    *,
    align_channels: bool = True,
    **settings: Any,
) -> PreparedRecording:
    """Read, correct and cut a recording as ``tvsysid identify`` does.

    Leaves out realizations with gaps, subtracts mains hum, corrects a delay between the channels,
    decimates, cuts into realizations, and subtracts their mean. ``tv.compare`` of the result gives
    the answer of ``tvsysid identify``.

    Parameters
    ----------
    source
        File, or a recording that is not decimated.
    align_channels
        Whether to correct a delay between angle and torque, unless held-out realizations are
        predicted better without.
    **settings
        ``period`` in s, ``decimate`` in Hz and ``context`` in s, and for a file those of
        :func:`tvsysid.read_recording`. Without a period, the record is one realization. Settings
        that ``tvsysid inspect --save`` wrote beside the file hold where none are given.

    Examples
    --------
    >>> import tvsysid as tv
    >>> joint = tv.simulate.Joint(stiffness=tv.simulate.SineWave())
    >>> simulation = joint.simulate(40, perturbation=tv.simulate.PRBS(), snr_db=10, seed=1)
    >>> tv.prepare(simulation.recording, period=2.0, decimate=100)
    Ensemble(20 realizations of 2 s at 100 Hz, context 0.5 s; ...)
    """
    file = None if isinstance(source, Recording) else Path(source)
    reading, cutting = split_settings((saved_settings(file) if file else {}) | settings)
    recording = source if isinstance(source, Recording) else read_recording(source, reading)
    period, context, rate = cutting.period, cutting.context, cutting.decimate
    checks = diagnose_recording(recording)
    gaps = preprocess.find_gaps(recording) if period else ()

    def decimated(recording: Recording) -> Recording:
        return preprocess.decimate(recording, rate, sharp=period is None) if rate else recording

    def cut(recording: Recording) -> Ensemble:
        ensemble = preprocess.segment(decimated(recording), period, context, gaps)
        return preprocess.subtract_mean(ensemble) if len(ensemble) > 1 or period else ensemble

    def cut_to_diagnose(recording: Recording) -> Ensemble:
        ensemble = cut(recording)
        if not ensemble.mean_subtracted:
            with suppress(InputError):  # the record is too short for two pieces
                pieces = preprocess.segment(decimated(recording), PIECE_S, context)
                return preprocess.subtract_mean(pieces)
        return ensemble

    corrected, corrections = correct(recording, cut, cut_to_diagnose, align_channels)
    ensemble = cut(corrected)
    if gaps:
        every = preprocess.segment(decimated(corrected), period, context)
        action = f"realizations with gaps were left out ({len(every) - len(ensemble)})"
        corrections.append(Correction(checks["gaps"], action))
    for fault, _ in corrections:
        checks.pop(fault.name, None)
    return PreparedRecording(
        recording,
        ensemble,
        cut_to_diagnose(corrected),
        tuple(checks.values()),
        tuple(corrections),
        file,
        reading,
    )


def correct(
    recording: Recording,
    cut: Callable[[Recording], Ensemble],
    cut_to_diagnose: Callable[[Recording], Ensemble] | None = None,
    align_channels: bool = True,
) -> tuple[Recording, list[Correction]]:
    """Subtract mains hum, and correct a delay between angle and torque, where they are found.

    ``cut`` returns the realizations to identify, ``cut_to_diagnose`` those to diagnose if they
    are others.
    """
    corrections = []
    hum = judge("mains", recording)
    if hum.found:
        recording = preprocess.remove_mains(recording, preprocess.find_mains(recording)[0])
        corrections.append(Correction(hum, "mains hum was subtracted from all channels"))
    with suppress(InputError):  # realizations are too few, or too short
        found = diagnose((cut_to_diagnose or cut)(recording)).findings if align_channels else ()
        delays = [each for each in found if each.name == "delay"]
        if delays and not {each.fault.severity for each in found} & {"invalid", "closed loop"}:
            delay, action = delay_to_correct(recording, cut, delays[0].value / 1000)
            recording = preprocess.align_channels(recording, delay)
            corrections.append(Correction(delays[0], action))
    return recording, corrections


def delay_to_correct(
    recording: Recording, cut: Callable[[Recording], Ensemble], delay: float
) -> tuple[float, str]:
    """Choose how much of a torque delay in s to correct: all of it, half of it or none.

    A joint that is not of second order, or a compliant fixture, looks like a delay of another
    size. So all of the delay is corrected unless half or none of it predicts held-out
    realizations better (p < 0.05). ``adaptive`` predicts them. In a single realization, all of
    the delay is corrected.

    Returns the delay to correct in s, and says what is done.
    """
    delays = delay * np.array([0.0, 0.5, 1.0])
    ensembles = [cut(preprocess.align_channels(recording, each)) for each in delays]
    count = min(map(len, ensembles))
    if count < MIN_REALIZATIONS:
        return delay, "all of it is corrected"
    with without_quality_warnings():
        found = compare(ensembles[0], ["adaptive"])  # its model is the start for all of them
        predicted = [attrs.evolve(found, ensemble=each).predict_held_out(2) for each in ensembles]
    errors = 100 - np.array([vaf(*each["adaptive"])[:count] for each in predicted])
    best = int(np.argmin(errors.mean(axis=1)))
    if not prediction_p_value(errors[best], errors[-1]) < SIGNIFICANCE:
        return delay, "all of it is corrected"
    amount = f"half of it ({1000 * abs(delays[best]):.3g} ms)" if best else "none of it"
    reason = "adaptive then predicts held-out realizations better than with all of it corrected"
    return float(delays[best]), f"{amount} is corrected: {reason}"
