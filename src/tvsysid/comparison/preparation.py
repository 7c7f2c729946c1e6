"""Read and correct a recording, and cut it into realizations, as ``tvsysid identify`` does."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import attrs
import numpy as np

from tvsysid import preprocess
from tvsysid.comparison.comparison import Comparison
from tvsysid.errors import InputError, without_quality_warnings
from tvsysid.methods import AdaptiveRegression
from tvsysid.methods.cascade.reflex_test import prediction_p_value
from tvsysid.metrics import vaf
from tvsysid.numerics.threads import single_thread
from tvsysid.quality import Diagnosis, Finding, diagnose
from tvsysid.quality.checks import judge
from tvsysid.quality.fit import FittedEnsemble
from tvsysid.quality.realizations import without_drifting_offsets
from tvsysid.recommendation import find_unnamed_references
from tvsysid.recordings import describe_file, read_recording
from tvsysid.recordings.reading import Reading, split_settings
from tvsysid.recordings.saved import saved_settings
from tvsysid.signals import Ensemble, Recording

SIGNIFICANCE = 0.05  # p-value below which one candidate predicts better than another
PIECE_S = 2.0  # duration of the pieces in which a single realization is diagnosed
MAX_TESTED_CHANNELS = 8


class Correction(NamedTuple):
    """A fault of a recording, and what was done about it."""

    fault: Finding
    action: str

    def __str__(self) -> str:
        """Return the correction as a sentence, with numbers."""
        return f"{self.fault.what.partition(';')[0]}; {self.action}"


@attrs.frozen(eq=False, repr=False)
class PreparedRecording:
    """A recording that was corrected and cut into realizations: see :func:`tvsysid.prepare`.

    Parameters
    ----------
    recording
        Recording as it was read.
    ensemble
        Realizations without their mean; a single one keeps its mean.
    corrections
        Faults that were found and corrected; of a delay, all of it, half or none. The text of each
        is a sentence with numbers.
    file, reading
        File, and how it was read. ``file`` is None for a recording that was not read here.
    """

    recording: Recording
    ensemble: Ensemble
    corrections: tuple[Correction, ...]
    file: Path | None
    reading: Reading

    def __repr__(self) -> str:
        return "\n".join(map(str, [self.ensemble, *self.corrections]))

    def center(self, channels: Iterable[str]) -> PreparedRecording:
        """Subtract the mean of these channels, if that of angle and torque is subtracted."""
        if not self.ensemble.mean_subtracted:
            return self
        names = self.recording.channels.keys() & set(channels)
        centered = preprocess.subtract_mean(self.ensemble, names).channels
        return attrs.evolve(self, ensemble=attrs.evolve(self.ensemble, channels=centered))

    def diagnose(self, reference: str | None = None) -> Diagnosis:
        """Diagnose the data as they are identified: see :func:`tvsysid.diagnose`.

        Gaps and mains hum are checked in the record. They are left out if they were corrected.
        """
        data = to_diagnose(self.ensemble, [reference] if reference else [])
        repeats = self.ensemble.mean_subtracted
        found = diagnose(data, reference, repeats=repeats, recording=self.recording)
        mended = {fault.name for fault, _ in self.corrections} - {"delay"}
        checks = tuple(each for each in found.checks if each.name not in mended)
        return attrs.evolve(found, checks=checks)

    def unnamed_references(self) -> Iterator[str]:
        """Yield a sentence for each channel of the file that drives the angle but was not read."""
        if self.file is None:
            return
        channels, read = describe_file(self.file), self.reading.names
        shape, ensemble = channels[read["angle"]].shape, self.ensemble
        others = [
            name
            for name, each in channels.items()
            if each.shape == shape and name not in read.values()
        ]
        context = ensemble.context / ensemble.sampling_rate
        for name in others[:MAX_TESTED_CHANNELS]:
            with suppress(InputError):  # the channel holds no numbers
                values = channels[name].read(name).ravel(order="F")
                recording = attrs.evolve(self.recording, channels={name: values})
                cut = preprocess.segment(recording, ensemble.duration, context)
                for sentence in find_unnamed_references(
                    preprocess.subtract_mean(cut, [name]), [name]
                ):
                    yield sentence.replace("--method", f"--channel {name}={name} --method")


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
    period, rate = cutting.period, cutting.decimate
    gaps = preprocess.find_gaps(recording) if period else ()

    def cut(recording: Recording, gaps: Iterable[preprocess.Gap] = gaps) -> Ensemble:
        if rate:
            recording = preprocess.decimate(recording, rate, sharp=period is None)
        ensemble = preprocess.segment(recording, period, cutting.context, gaps)
        return preprocess.subtract_mean(ensemble) if len(ensemble) > 1 or period else ensemble

    corrected, corrections = correct(recording, cut, align_channels)
    ensemble = cut(corrected)
    if gaps:
        lost = len(cut(corrected, gaps=())) - len(ensemble)
        action = f"realizations with gaps were left out ({lost})"
        corrections.append(Correction(judge("gaps", recording), action))
    return PreparedRecording(recording, ensemble, tuple(corrections), file, reading)


def correct(
    recording: Recording,
    cut: Callable[[Recording], Ensemble],
    align_channels: bool = True,
) -> tuple[Recording, list[Correction]]:
    """Subtract mains hum, and correct a delay between angle and torque, where they are found.

    ``cut`` returns the realizations to identify.
    """
    corrections = []
    hum = judge("mains", recording)
    if hum.found:
        recording = preprocess.remove_mains(recording, preprocess.find_mains(recording)[0])
        corrections.append(Correction(hum, "mains hum was subtracted from all channels"))
    if not align_channels:
        return recording, corrections
    with suppress(InputError):  # realizations are too few, or too short
        data = to_diagnose(cut(recording))
        late = without_drifting_offsets(FittedEnsemble.of(data)).finding("delay")
        # All checks take four times as long, and matter only if there is a delay.
        faults = diagnose(data).findings if late.found else ()
        if faults and not {each.fault.severity for each in faults} & {"invalid", "closed loop"}:
            delay, action = delay_to_correct(recording, cut, late.value / 1000)
            recording = preprocess.align_channels(recording, delay)
            corrections.append(Correction(late, action))
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
    if count == 1:
        return delay, "all of it is corrected"
    with single_thread(), without_quality_warnings():
        methods = {"adaptive": AdaptiveRegression()}
        # The fits to all three start from this model.
        models = {"adaptive": methods["adaptive"].identify(ensembles[0])}
        predicted = [
            Comparison(each, methods, models, {}, {}, {}, {}).predict_held_out(2)
            for each in ensembles
        ]
    errors = 100 - np.array([vaf(*each["adaptive"])[:count] for each in predicted])
    best = int(np.argmin(errors.mean(axis=1)))
    if not prediction_p_value(errors[best], errors[-1]) < SIGNIFICANCE:
        return delay, "all of it is corrected"
    amount = f"half of it ({1000 * abs(delays[best]):.3g} ms)" if best else "none of it"
    reason = "adaptive then predicts held-out realizations better than with all of it corrected"
    return float(delays[best]), f"{amount} is corrected: {reason}"


def to_diagnose(ensemble: Ensemble, channels: Iterable[str] = ()) -> Ensemble:
    """Return an ensemble whose mean is subtracted; a single realization is cut into pieces first.

    The mean of these ``channels`` of the pieces is subtracted, too.
    """
    if ensemble.mean_subtracted:
        return ensemble
    context = ensemble.context / ensemble.sampling_rate
    record = Recording(
        **ensemble.mapped(lambda values: values[0]),
        sampling_rate=ensemble.sampling_rate,
        start=ensemble.onsets[0] - context,
    )
    return preprocess.subtract_mean(preprocess.segment(record, PIECE_S, context), channels)
