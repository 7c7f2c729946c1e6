"""Correct a recording and cut it into realizations, as ``tvsysid identify`` does."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import cache

import attrs
import numpy as np

from tvsysid import preprocess
from tvsysid.comparison.identify import compare
from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.methods.cascade.reflex_test import prediction_p_value
from tvsysid.metrics import vaf
from tvsysid.quality import Diagnosis, Finding, diagnose, diagnose_recording
from tvsysid.recordings.reading import Segmentation
from tvsysid.signals import Array, Ensemble, Recording

SIGNIFICANCE = 0.05  # p-value below which one candidate predicts better than another
PIECE_S = 2.0  # duration of the pieces in which a record without a period is diagnosed


@attrs.frozen(eq=False)
class PreparedRecording:
    """A recording that was corrected and cut into realizations.

    Parameters
    ----------
    recording
        Recording as it was read.
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
    centered
        Channels that lost their mean.
    """

    recording: Recording
    ensemble: Ensemble
    diagnosed: Ensemble
    findings: tuple[Finding, ...]
    corrections: tuple[str, ...]
    notes: tuple[str, ...]
    centered: tuple[str, ...]

    def diagnose(self, reference: str | None = None) -> Diagnosis | str:
        """Diagnose the data as they are identified; return why not if they are too short."""
        repeats = self.diagnosed is self.ensemble
        try:
            found = diagnose(self.diagnosed, reference, repeats=repeats)
        except InputError as error:
            return str(error).removeprefix("diagnose: ")
        return attrs.evolve(found, checks=(*found.checks, *self.findings))


def prepare_recording(
    recording: Recording,
    segmentation: Segmentation,
    centered: Iterable[str] = (),
    *,
    align_channels: bool = True,
    remove_mains: bool = True,
) -> PreparedRecording:
    """Leave out gaps, subtract mains hum, correct a delay, decimate, and cut into realizations.

    Parameters
    ----------
    recording
        Recording as it was read, not decimated.
    segmentation
        Period, rate and context. Without a period, the record is one realization.
    centered
        Channels that lose their mean over realizations, as angle and torque do: see
        :func:`tvsysid.methods.centered_channels`. Names that the recording lacks are ignored.
    align_channels
        Whether to correct a delay between angle and torque, unless held-out realizations are
        predicted better without.
    remove_mains
        Whether to subtract mains hum that shows in the angle.
    """
    period, context = segmentation.period, segmentation.context
    names = tuple(name for name in centered if name in recording.channels)
    findings, corrections, notes = diagnose_recording(recording), [], []
    as_read = recording

    def note(fault: str, correction: str) -> None:
        corrections.append(correction)
        notes.append(f"{findings.pop(fault).what}; {correction}")

    gaps = preprocess.find_gaps(recording) if period else ()
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
        lost = len(every) - len(ensemble(0.0))
        note("gaps", f"realizations with gaps were left out ({lost})")
    delay = 0.0
    if align_channels:
        with suppress(InputError):  # realizations are too few, or too short
            delay, decision = delay_to_correct(ensemble, diagnose(diagnosed(0.0)))
            notes += filter(None, [decision])
    return PreparedRecording(
        as_read,
        ensemble(delay),
        diagnosed(delay),
        tuple(findings.values()),
        tuple(corrections),
        tuple(notes),
        names,
    )


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
