"""Read and correct a recording, and cut it into realizations, as ``tvsysid identify`` does."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import attrs
import numpy as np

from tvsysid import preprocess
from tvsysid.comparison.identify import compare
from tvsysid.comparison.prepared import PreparedRecording
from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.methods.cascade.reflex_test import prediction_p_value
from tvsysid.metrics import vaf
from tvsysid.quality import Diagnosis, diagnose, diagnose_recording
from tvsysid.recordings import Reading, Segmentation, read_recording
from tvsysid.recordings.saved import saved_settings, settings_file
from tvsysid.signals import Array, Ensemble, Recording

SIGNIFICANCE = 0.05  # p-value below which one candidate predicts better than another
PIECE_S = 2.0  # duration of the pieces in which a record without a period is diagnosed


def prepare(
    source: str | Path | Recording,
    reading: Reading | None = None,
    segmentation: Segmentation | None = None,
    *,
    align_channels: bool = True,
    remove_mains: bool = True,
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
    reading, segmentation
        Settings for reading the file, and for cutting. By default, they are those that
        ``tvsysid inspect --save`` wrote beside the file, and ``settings``.
    align_channels
        Whether to correct a delay between angle and torque, unless held-out realizations are
        predicted better without.
    remove_mains
        Whether to subtract mains hum that shows in the angle.
    **settings
        ``period`` in s, ``decimate`` in Hz and ``context`` in s, and for a file those of
        :func:`tvsysid.read_recording`. Without a period, the record is one realization.

    Examples
    --------
    >>> import tvsysid as tv
    >>> joint = tv.simulate.Joint(stiffness=tv.simulate.SineWave())
    >>> simulation = joint.simulate(40, perturbation=tv.simulate.PRBS(), snr_db=10, seed=1)
    >>> tv.prepare(simulation.recording, period=2.0, decimate=100)
    Ensemble(20 realizations of 2 s at 100 Hz, context 0.5 s; ...)
    """
    if reading is None or segmentation is None:
        reading, segmentation = _with_saved(source, settings)
    file = None if isinstance(source, Recording) else Path(source)
    as_read = recording = (
        source if isinstance(source, Recording) else read_recording(source, reading)
    )
    period, context, rate = segmentation.period, segmentation.context, segmentation.decimate
    findings, corrected, corrections, notes = diagnose_recording(recording), [], [], []

    def note(fault: str, correction: str) -> None:
        corrections.append(correction)
        corrected.append(findings.pop(fault))
        notes.append(f"{corrected[-1].what}; {correction}")

    gaps = preprocess.find_gaps(recording) if period else ()
    if remove_mains and findings["mains"].found:
        mains, _ = preprocess.find_mains(recording)
        recording = preprocess.remove_mains(recording, mains)
        note("mains", "mains hum was subtracted from all channels")

    @cache
    def decimated(delay: float) -> Recording:
        aligned = preprocess.align_channels(recording, delay) if delay else recording
        return preprocess.decimate(aligned, rate, sharp=period is None) if rate else aligned

    @cache
    def ensemble(delay: float) -> Ensemble:
        cut = preprocess.segment(decimated(delay), period, context, gaps)
        return preprocess.subtract_mean(cut) if len(cut) > 1 or period else cut

    def diagnosed(delay: float) -> Ensemble:
        if not ensemble(delay).mean_subtracted:
            with suppress(InputError):  # the record is too short for two pieces
                pieces = preprocess.segment(decimated(delay), PIECE_S, context)
                return preprocess.subtract_mean(pieces)
        return ensemble(delay)

    if gaps:
        every = preprocess.segment(decimated(0.0), period, context)
        lost = len(every) - len(ensemble(0.0))
        note("gaps", f"realizations with gaps were left out ({lost})")
    delay = 0.0
    if align_channels:
        with suppress(InputError):  # realizations are too few, or too short
            diagnosis = diagnose(diagnosed(0.0))
            delay, decision = delay_to_correct(ensemble, diagnosis)
            notes += filter(None, [decision])
            corrected += [each for each in diagnosis.findings if each.name == "delay" and delay]
    return PreparedRecording(
        as_read,
        ensemble(delay),
        diagnosed(delay),
        tuple(findings.values()),
        tuple(corrected),
        tuple(corrections),
        tuple(notes),
        file,
        reading,
    )


def _with_saved(
    source: str | Path | Recording, settings: Mapping[str, Any]
) -> tuple[Reading, Segmentation]:
    """Return settings for reading and cutting: these, and those saved beside the file."""
    if not isinstance(source, Recording) and (saved := settings_file(Path(source))).is_file():
        settings = {**saved_settings(saved), **settings}
    cutting = attrs.fields_dict(Segmentation).keys() & settings
    reading = Reading(**{name: settings[name] for name in settings if name not in cutting})
    return reading, Segmentation(**{name: settings[name] for name in cutting})


def delay_to_correct(cut: Callable[[float], Ensemble], diagnosis: Diagnosis) -> tuple[float, str]:
    """Choose how much of a torque delay to correct: all of it, half of it or none.

    A joint that is not of second order, or a compliant fixture, looks like a delay of another
    size. So all of the delay is corrected unless half or none of it predicts held-out
    realizations better (p < 0.05). ``adaptive`` predicts them. In a single realization, all of
    the delay is corrected.

    Parameters
    ----------
    cut
        Function that returns the ensemble after correction of a delay in s.
    diagnosis
        Diagnosis of the data as recorded.

    Returns
    -------
    float
        Delay to correct in s. 0 if none is found or can be corrected, or if worse faults are
        found.
    str
        What was found and done. Empty if no delay is found.
    """
    faults = {each.name: each for each in diagnosis.findings}
    severities = {each.fault.severity for each in faults.values()}
    if "delay" not in faults or severities & {"invalid", "closed loop"}:
        return 0.0, ""
    what = faults["delay"].what.partition(";")[0]
    delays = np.array([0.0, 0.5, 1.0]) * faults["delay"].value / 1000
    ensembles = [cut(delay) for delay in delays]
    vafs = _held_out_vafs(ensembles) if len(ensembles[0]) > 1 else np.full((3, 1), np.nan)
    best = int(np.argmax(vafs.mean(axis=1)))
    if not prediction_p_value(100 - vafs[best], 100 - vafs[-1]) < SIGNIFICANCE:
        return float(delays[-1]), f"{what}; all of it is corrected"
    amount = f"half of it ({1000 * abs(delays[best]):.3g} ms)" if best else "none of it"
    reason = "adaptive then predicts held-out realizations better than with all of it corrected"
    return float(delays[best]), f"{what}; {amount} is corrected: {reason}"


def _held_out_vafs(ensembles: Sequence[Ensemble]) -> Array:
    """Return the held-out VAF of each ensemble by ``adaptive``, shape (ensemble, realization).

    It identifies the first ensemble, and starts from this model for the others.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)
        found = compare(ensembles[0], ["adaptive"])
        vafs = [
            vaf(*attrs.evolve(found, ensemble=each).predict_held_out(2)["adaptive"])
            for each in ensembles
        ]
    return np.array([each[: min(map(len, vafs))] for each in vafs])
