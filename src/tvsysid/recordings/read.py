"""Read trials from several files, and join them."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tvsysid.checked import checked_array
from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.recordings.plausible import unlike_trials
from tvsysid.recordings.reading import Reading, read_recording
from tvsysid.signals import Recording


class UsableTrials(NamedTuple):
    """What could be read of many trials."""

    recording: Recording | None
    """Those that can be used; None if there is none."""
    names: tuple[str, ...]
    """What each of them is called: its file, or file and number of the trial."""
    refused: dict[str, str]
    """Why the others cannot be used, by the same names."""


def read_usable_trials(
    paths: Mapping[str, Path], reading: Reading, shortest: float = 0.0
) -> UsableTrials:
    """Read trials as :func:`tvsysid.read_trials` does, and leave out those that cannot be used instead of giving up.

    Files are in the order of the trials, by what they are called. A trial must last ``shortest``
    seconds.
    """
    usable: dict[str, Recording] = {}
    refused: dict[str, str] = {}
    for called, file in paths.items():
        try:
            content = reading.signals(file)
        except (InputError, MemoryError) as error:
            refused[called] = (
                str(error).removeprefix(f"{file}: ").removeprefix(f"{file.name}: ")
                or "no memory left"
            )
            continue
        starts = content.trial_starts
        signals = {channel: matrix.ravel(order="F") for channel, matrix in content.matrices.items()}
        for number, trial in enumerate(map(slice, starts, (*starts[1:], None))):
            name = called if len(starts) == 1 else f"{called}, trial {number + 1}"
            try:
                checked = {
                    channel: checked_array(channel, each[trial], ("time",))
                    for channel, each in signals.items()
                }
                recording = reading.recording(checked)
            except InputError as error:
                refused[name] = str(error)
                continue
            if recording.duration < shortest:
                refused[name] = (
                    f"it lasts {recording.duration:g} s, and a realization with the ends that are "
                    "cut off takes "
                    f"{shortest:g} s"
                )
                continue
            usable[name] = recording
            for text in reading.warnings(content.channels, recording):
                warnings.warn(f"{name}: {text}", DataQualityWarning, stacklevel=2)
    names, recordings = tuple(usable), list(usable.values())
    for text in unlike_trials(recordings, names):
        warnings.warn(text, DataQualityWarning, stacklevel=2)
    return UsableTrials(join_trials(recordings) if usable else None, names, refused)


def read_trials(paths: Sequence[str | Path], **settings: Any) -> Recording:
    """Read trials that are in files of their own, in their order, one after the other.

    Several trials in one file are the columns of its matrices (``columns="trials"``), or have names
    of their own: then read each by :func:`tvsysid.read_recording`, and put them together by
    :func:`tvsysid.recordings.join_trials`.

    Parameters
    ----------
    paths
        Files, of any formats.
    **settings
        As of :func:`tvsysid.read_recording`, the same for all files; so are the errors.

    Examples
    --------
    >>> import numpy as np, tempfile
    >>> angle = 0.02 * np.sin(np.arange(2000) / 50)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     files = [f"{folder}/{trial}.npz" for trial in ("first", "second")]
    ...     for file in files:
    ...         np.savez(file, pos=angle, tq=80 * angle)
    ...     read_trials(files, angle="pos", torque="tq", sampling_rate=100).trial_starts
    (0, 2000)
    """
    if isinstance(paths, (str, Path)):
        raise InputError(
            f"paths: expected several files, got {str(paths)!r}; give a list, or use read_recording"
        )
    return join_trials([read_recording(path, **settings) for path in paths])


def join_trials(recordings: Sequence[Recording]) -> Recording:
    """Recordings as the trials of one: nothing is filtered or cut across where they meet.

    An InputError is raised if they differ in sampling rate, start or channels, or there are none.
    """
    if not recordings:
        raise InputError("join_trials: expected recordings, got none")
    first = recordings[0]
    shared = [
        {
            "sampling rate": item.sampling_rate,
            "start": item.start,
            "channels": sorted(item.channels),
        }
        for item in recordings
    ]
    for number, other in enumerate(shared):
        for what, one in shared[0].items():
            if (two := other[what]) != one:
                raise InputError(
                    f"join_trials: recording {number} and the first differ in {what}: {two} "
                    f"instead of {one}; read them alike, or decimate to one rate before"
                )
    recorded = [item.recorded_angle for item in recordings if item.recorded_angle is not None]
    befores = np.cumsum([0, *(len(item) for item in recordings[:-1])])
    return Recording(
        angle=np.concatenate([item.angle for item in recordings]),
        torque=np.concatenate([item.torque for item in recordings]),
        sampling_rate=first.sampling_rate,
        start=first.start,
        channels={
            name: np.concatenate([item.channels[name] for item in recordings])
            for name in first.channels
        },
        trial_starts=tuple(
            int(before) + begin
            for before, item in zip(befores, recordings, strict=True)
            for begin in item.trial_starts
        ),
        origin=first.origin,
        recorded_angle=None
        if any(item.recorded_angle is None for item in recordings)
        else np.concatenate(recorded),
    )
