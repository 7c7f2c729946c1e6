"""Correct a recording and cut it into realizations, as ``tvsysid identify`` does."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from functools import cache

import attrs

from tvsysid import preprocess
from tvsysid.comparison.delay import delay_to_correct
from tvsysid.errors import InputError
from tvsysid.quality import Finding, diagnose_recording
from tvsysid.recordings.reading import Segmentation
from tvsysid.signals import Ensemble, Recording

PIECE_S = 2.0  # duration of the pieces in which a record without a period is diagnosed


@attrs.frozen(eq=False)
class PreparedRecording:
    """A recording that was corrected and cut into realizations.

    Parameters
    ----------
    ensemble
        Realizations without their mean; a single one keeps its mean.
    diagnosed
        Ensemble to diagnose: ``ensemble``, or pieces of 2 s of a single realization.
    findings
        Results of the checks for gaps and mains hum, except for faults that were corrected.
    corrections
        What was corrected, for the methods paragraph.
    notes
        The same, and a delay, with numbers and in sentences.
    mains
        Frequency in Hz of the mains hum that was subtracted; 0 for none.
    deviating
        Channels that lost their mean.
    """

    ensemble: Ensemble
    diagnosed: Ensemble
    findings: tuple[Finding, ...] = ()
    corrections: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    mains: float = 0.0
    deviating: tuple[str, ...] = ()


def prepare_recording(
    recording: Recording,
    segmentation: Segmentation,
    deviating: Iterable[str] = (),
    *,
    method: str = "adaptive",
    align_channels: bool = True,
    remove_mains: bool = True,
    jobs: int = 1,
) -> PreparedRecording:
    """Leave out gaps, subtract mains hum, correct a delay, decimate, and cut into realizations.

    Parameters
    ----------
    recording
        Recording as it was read, not decimated.
    segmentation
        Period, rate and context. Without a period, the record is one realization.
    deviating
        Channels that lose their mean over realizations, as angle and torque do: see
        :func:`tvsysid.methods.centered_channels`. Names that the recording lacks are ignored.
    method
        Method that judges in a single realization how much of a delay to correct.
    align_channels
        Whether to correct a delay between angle and torque, unless held-out realizations are
        predicted better without.
    remove_mains
        Whether to subtract mains hum that shows in the angle.
    jobs
        As of :meth:`tvsysid.Comparison.held_out_vaf`.
    """
    period, context = segmentation.period, segmentation.context
    names = tuple(name for name in deviating if name in recording.channels)
    findings, corrections, notes = diagnose_recording(recording), [], []

    def note(fault: str, correction: str) -> None:
        corrections.append(correction)
        notes.append(f"{findings.pop(fault).what}; {correction}")

    gaps = preprocess.find_gaps(recording) if period else ()
    mains = 0.0
    if remove_mains and findings["mains"].found:
        mains, _ = preprocess.find_mains(recording)
        recording = preprocess.remove_mains(recording, mains)
        note("mains", "mains hum was subtracted from all channels")

    @cache
    def decimated(delay: float) -> Recording:
        aligned = preprocess.align_channels(recording, delay) if delay else recording
        if segmentation.decimate is None:
            return aligned
        return preprocess.decimate(aligned, segmentation.decimate, sharp=period is None)

    @cache
    def ensemble(delay: float) -> Ensemble:
        cut = preprocess.segment(decimated(delay), period, context, gaps)
        return preprocess.subtract_mean(cut, names) if len(cut) > 1 or period else cut

    def diagnosed(delay: float) -> Ensemble:
        if not ensemble(delay).mean_subtracted:
            with suppress(InputError):  # the record is too short for two pieces
                pieces = preprocess.segment(decimated(delay), PIECE_S, context)
                return preprocess.subtract_mean(pieces, names)
        return ensemble(delay)

    if gaps:
        every = preprocess.segment(decimated(0.0), period, context)
        if lost := len(every) - len(ensemble(0.0)):
            note("gaps", f"realizations with gaps were left out ({lost})")
        else:
            del findings["gaps"]
    delay = 0.0
    if align_channels:
        delay, decision = delay_to_correct(ensemble, diagnosed(0.0), method, jobs)
        notes += filter(None, [decision])
    return PreparedRecording(
        ensemble(delay),
        diagnosed(delay),
        tuple(findings.values()),
        tuple(corrections),
        tuple(notes),
        mains,
        names,
    )
