"""Hold a recording that was corrected and cut into realizations."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path

import attrs

from tvsysid.errors import InputError
from tvsysid.preprocess import segment, subtract_mean
from tvsysid.quality import Diagnosis, Finding, diagnose
from tvsysid.recommendation import find_unnamed_references
from tvsysid.recordings import Reading, describe_file
from tvsysid.signals import Ensemble, Recording

MAX_TESTED_CHANNELS = 8


@attrs.frozen(eq=False, repr=False)
class PreparedRecording:
    """A recording that was corrected and cut into realizations: see :func:`tvsysid.prepare`.

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
    corrected
        Faults that were corrected.
    corrections
        What was corrected, for the methods paragraph.
    notes
        The same, and a delay, with numbers and in sentences.
    file, reading
        File, and how it was read. ``file`` is None for a recording that was not read here.
    """

    recording: Recording
    ensemble: Ensemble
    diagnosed: Ensemble
    findings: tuple[Finding, ...]
    corrected: tuple[Finding, ...]
    corrections: tuple[str, ...]
    notes: tuple[str, ...]
    file: Path | None
    reading: Reading

    def __repr__(self) -> str:
        return "\n".join([repr(self.ensemble), *self.notes])

    def center(self, channels: Iterable[str]) -> PreparedRecording:
        """Subtract the mean of these channels, if that of angle and torque is subtracted."""
        names = [name for name in channels if name in self.recording.channels]
        pieces = self.diagnosed is not self.ensemble

        def centered(ensemble: Ensemble) -> Ensemble:
            if not ensemble.mean_subtracted:
                return ensemble
            return attrs.evolve(ensemble, channels=subtract_mean(ensemble, names).channels)

        if not names:
            return self
        ensemble = centered(self.ensemble)
        diagnosed = centered(self.diagnosed) if pieces else ensemble
        return attrs.evolve(self, ensemble=ensemble, diagnosed=diagnosed)

    def diagnose(self, reference: str | None = None) -> Diagnosis | str:
        """Diagnose the data as they are identified; return why not if they are too short."""
        repeats = self.diagnosed is self.ensemble
        try:
            found = diagnose(self.diagnosed, reference, repeats=repeats)
        except InputError as error:
            return str(error).removeprefix("diagnose: ")
        return attrs.evolve(found, checks=(*found.checks, *self.findings))

    def unnamed_references(self) -> Iterator[str]:
        """Yield a sentence for each channel of the file that drives the angle but was not read."""
        if self.file is None:
            return
        channels, ensemble = describe_file(self.file), self.ensemble
        names = self.reading.names
        shape, named = channels[names["angle"]].shape, {*names.values()}
        untested = [
            name for name in channels if name not in named and channels[name].shape == shape
        ]
        for name in untested[:MAX_TESTED_CHANNELS]:
            with suppress(InputError):  # the channel holds no numbers
                values = channels[name].read(name).ravel(order="F")
                with_channel = attrs.evolve(self.recording, channels={name: values})
                context = ensemble.context / ensemble.sampling_rate
                segmented = subtract_mean(segment(with_channel, ensemble.duration, context), [name])
                for sentence in find_unnamed_references(segmented, [name]):
                    yield sentence.replace("--method", f"--channel {name}={name} --method")
