"""Check a comparison against the recording and the file that its ensemble comes from."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import attrs

from tvsysid.comparison.comparison import Comparison
from tvsysid.comparison.preparation import PreparedRecording
from tvsysid.errors import InputError
from tvsysid.preprocess import segment, subtract_mean
from tvsysid.progress import Progress, no_progress
from tvsysid.recommendation import find_unnamed_references
from tvsysid.recordings import Reading, describe_file
from tvsysid.signals import Recording

MAX_TESTED_CHANNELS = 8
NAMED = {"reference", "scheduling"}  # inputs whose role was stated


def with_checks(
    comparison: Comparison,
    prepared: PreparedRecording,
    source: str | Path | Recording,
    reading: Reading,
    progress: Progress = no_progress,
) -> Comparison:
    """Return a comparison with the diagnosis of the data, and held-out predictions.

    If the source is a file, channels that drive the angle but were not read are named, too. The
    answer is then that of ``tvsysid identify``.

    Parameters
    ----------
    comparison
        Models of the ensemble of ``prepared``.
    prepared
        Recording that was corrected and cut.
    source, reading
        File, and how it was read; or the recording.
    progress
        As for :func:`compare`, for the held-out predictions.
    """
    unnamed: tuple[str, ...] = ()
    # A reference or a scheduling variable has been named
    if not isinstance(source, Recording) and not comparison.inputs.keys() & NAMED:
        unnamed = tuple(_unnamed_references(prepared, source, reading))
    return attrs.evolve(
        comparison,
        held_out=comparison.predict_held_out(progress=progress),
        diagnosis=prepared.diagnose(comparison.inputs.get("reference")),
        unnamed_references=unnamed,
    )


def _unnamed_references(
    prepared: PreparedRecording, file: str | Path, reading: Reading
) -> Iterator[str]:
    """Yield a sentence for each channel that drives the angle but was not read from the file."""
    channels, ensemble = describe_file(file), prepared.ensemble
    shape, named = channels[reading.names["angle"]].shape, {*reading.names.values()}
    untested = [name for name in channels if name not in named and channels[name].shape == shape]
    for name in untested[:MAX_TESTED_CHANNELS]:
        with suppress(InputError):  # the channel holds no numbers
            values = channels[name].read(name).ravel(order="F")
            with_channel = attrs.evolve(prepared.recording, channels={name: values})
            context = ensemble.context / ensemble.sampling_rate
            segmented = subtract_mean(segment(with_channel, ensemble.duration, context), [name])
            for sentence in find_unnamed_references(segmented, [name]):
                yield sentence.replace("--method", f"--channel {name}={name} --method")
