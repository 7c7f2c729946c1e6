"""Hold a recording that was corrected and cut into realizations."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import attrs

from tvsysid.errors import InputError
from tvsysid.preprocess import segment, subtract_mean
from tvsysid.quality import Diagnosis, Finding, diagnose
from tvsysid.recommendation import find_unnamed_references
from tvsysid.recordings import Reading, describe_file
from tvsysid.signals import Ensemble, Recording

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
    diagnosed
        Ensemble to diagnose: ``ensemble``, or pieces of 2 s of a single realization.
    findings
        Results of the checks for gaps and mains hum, except for faults that were corrected.
    corrections
        Faults that were found and corrected; of a delay, all of it, half or none.
    file, reading
        File, and how it was read. ``file`` is None for a recording that was not read here.
    """

    recording: Recording
    ensemble: Ensemble
    diagnosed: Ensemble
    findings: tuple[Finding, ...]
    corrections: tuple[Correction, ...]
    file: Path | None
    reading: Reading

    @property
    def notes(self) -> list[str]:
        """The corrections as sentences, with numbers."""
        return [*map(str, self.corrections)]

    def __repr__(self) -> str:
        return "\n".join([repr(self.ensemble), *self.notes])

    def center(self, channels: Iterable[str]) -> PreparedRecording:
        """Subtract the mean of these channels, if that of angle and torque is subtracted."""
        names = self.recording.channels.keys() & set(channels)
        ensemble, diagnosed = (
            attrs.evolve(each, channels=subtract_mean(each, names).channels)
            if each.mean_subtracted
            else each
            for each in (self.ensemble, self.diagnosed)
        )
        return attrs.evolve(self, ensemble=ensemble, diagnosed=diagnosed)

    def diagnose(self, reference: str | None = None) -> Diagnosis:
        """Diagnose the data as they are identified: see :func:`tvsysid.diagnose`."""
        found = diagnose(self.diagnosed, reference, repeats=self.ensemble.mean_subtracted)
        return attrs.evolve(found, checks=(*found.checks, *self.findings))

    def unnamed_references(self) -> Iterator[str]:
        """Yield a sentence for each channel of the file that drives the angle but was not read."""
        if self.file is None:
            return
        channels, read = describe_file(self.file), self.reading.names
        shape, ensemble = channels[read["angle"]].shape, self.ensemble
        others = (name for name in channels if channels[name].shape == shape)
        untested = (name for name in others if name not in read.values())
        context = ensemble.context / ensemble.sampling_rate
        for name in islice(untested, MAX_TESTED_CHANNELS):
            with suppress(InputError):  # the channel holds no numbers
                values = channels[name].read(name).ravel(order="F")
                recording = attrs.evolve(self.recording, channels={name: values})
                cut = segment(recording, ensemble.duration, context)
                for sentence in find_unnamed_references(subtract_mean(cut, [name]), [name]):
                    yield sentence.replace("--method", f"--channel {name}={name} --method")
