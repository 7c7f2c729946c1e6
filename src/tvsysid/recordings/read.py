"""Read a recording from a file, or from several that hold a trial each."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import attrs
import numpy as np

from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.recordings.channel import Channel, explained
from tvsysid.recordings.formats import describe_file
from tvsysid.recordings.plausible import doubts, unlike_trials
from tvsysid.recordings.reading import Reading, read_recording
from tvsysid.signals import Array, Recording

RAD_PER_UNIT = {"rad": 1.0, "deg": math.pi / 180}
NM_PER_UNIT = {"Nm": 1.0, "Nmm": 1e-3}


class UsableTrials(NamedTuple):
    """Trials that can be used, of many files.

    Parameters
    ----------
    recording
        The trials; None if there is none.
    names
        Name of each trial: its file, or file and number of the trial.
    refused
        Why the others cannot be used, by the same names.
    """

    recording: Recording | None
    names: tuple[str, ...]
    refused: dict[str, str]


def read(file: Path, reading: Reading) -> Recording:
    """Read a recording, and warn of what looks wrong. See :meth:`Reading.read`."""
    channels, signals, trial_starts = _read_signals(file, reading)
    with explained(file.name):
        recording = _recording(reading, signals, trial_starts)
    _warn(file.name, doubts(channels, recording, reading))
    return recording


def read_usable_trials(
    paths: Mapping[str, Path], reading: Reading, shortest: float = 0.0
) -> UsableTrials:
    """Read trials as :func:`tvsysid.read_trials` does, but leave out those that cannot be used.

    Parameters
    ----------
    paths
        Files by name, in the order of the trials.
    reading
        How all files are read.
    shortest
        Seconds that a trial must last.
    """
    usable: dict[str, Recording] = {}
    refused: dict[str, str] = {}
    for label, file in paths.items():
        try:
            channels, signals, starts = _read_signals(file, reading)
        except InputError as error:
            refused[label] = str(error).removeprefix(f"{file}: ").removeprefix(f"{file.name}: ")
            continue
        for number, trial in enumerate(map(slice, starts, (*starts[1:], None)), start=1):
            name = label if len(starts) == 1 else f"{label}, trial {number}"
            try:
                recording = _recording(reading, {key: each[trial] for key, each in signals.items()})
                if recording.duration < shortest:
                    raise InputError(
                        f"it lasts {recording.duration:g} s, and a realization with the ends that "
                        f"are cut off takes {shortest:g} s"
                    )
            except InputError as error:
                refused[name] = str(error)
                continue
            usable[name] = recording
            _warn(name, doubts(channels, recording, reading))
    for name, text in unlike_trials(usable):
        _warn(name, [text])
    joined = join_trials([*usable.values()]) if usable else None
    return UsableTrials(joined, tuple(usable), refused)


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
    """Join recordings as the trials of one: nothing is filtered or cut across where they meet.

    An InputError is raised if they differ in sampling rate, start or channels, or there are none.
    """
    if not recordings:
        raise InputError("join_trials: expected recordings, got none")
    first, starts, length = recordings[0], [], 0
    for number, item in enumerate(recordings):
        if _axes(item) != _axes(first):
            raise InputError(
                f"join_trials: recording {number} has {_axes(item)}, and the first {_axes(first)}; "
                "read them alike, or decimate to one rate before"
            )
        starts += [length + start for start in item.trial_starts]
        length += len(item)

    def joined(name: str) -> Array:
        return np.concatenate([item.signal(name) for item in recordings])

    recorded = [item.recorded_angle for item in recordings if item.recorded_angle is not None]
    return attrs.evolve(
        first,
        angle=joined("angle"),
        torque=joined("torque"),
        channels={name: joined(name) for name in first.channels},
        trial_starts=tuple(starts),
        recorded_angle=np.concatenate(recorded) if len(recorded) == len(recordings) else None,
    )


def _axes(recording: Recording) -> str:
    """Return in words what joined recordings must share."""
    channels = ", ".join(sorted(recording.channels)) or "none"
    return f"{recording.sampling_rate} Hz from {recording.start} s, channels: {channels}"


def _read_signals(
    file: Path, reading: Reading
) -> tuple[dict[str, Channel], dict[str, Array], tuple[int, ...]]:
    """Return the channels that a recording is made of, their values, and where trials start."""
    found = describe_file(file, reading.header)
    with explained(file.name):
        for name in reading.names:
            if name not in found:
                raise InputError(f"no channel {name!r}; it holds {_listed(found) or 'nothing'}")
        channels = {name: found[name] for name in reading.names}
        matrices = {name: _as_matrix(name, channel) for name, channel in channels.items()}
        if len({matrix.shape for matrix in matrices.values()}) > 1:
            raise InputError(
                f"the channels have different lengths: {_listed(channels)}; name channels that "
                "were sampled together, or cut or resample them to one rate before"
            )
        if len({channel.trial_starts for channel in channels.values()}) > 1:
            raise InputError(
                "the channels are cut into trials at different samples; cut them alike"
            )
        segments, (length, columns) = channels[name].trial_starts, matrices[name].shape
        if reading.columns == "trials":
            starts = segments or tuple(range(0, length * columns, length))
        elif len(segments) > 1:
            raise InputError(
                f"the channels are {len(segments)} segments with gaps between them; read each as a "
                "trial (--columns trials)"
            )
        else:
            starts = (0,)
    return channels, {name: each.ravel(order="F") for name, each in matrices.items()}, starts


def _listed(channels: Mapping[str, Channel]) -> str:
    return ", ".join(f"{name} ({channel.described})" for name, channel in channels.items())


def _as_matrix(name: str, channel: Channel) -> Array:
    """Return the values of a channel with an axis of time and one of columns."""
    values = channel.read(name)
    if values.ndim < 2 or (values.ndim == 2 and len(values) == 1):
        values = values.reshape(-1, 1)
    if values.ndim != 2:
        raise InputError(
            f"{name}: expected a vector or a matrix, got an array of shape {values.shape}; name "
            "another channel"
        )
    return values


def _recording(
    reading: Reading, signals: Mapping[str, Array], trial_starts: tuple[int, ...] = (0,)
) -> Recording:
    """Return the recording of signals of shape (time,), by their names in the file."""
    angle, torque = (signals[name] for name in reading.names[:2])
    return Recording(
        angle=angle * RAD_PER_UNIT[reading.angle_unit],
        torque=torque * (reading.torque_sign * NM_PER_UNIT[reading.torque_unit]),
        sampling_rate=reading.sampling_rate or math.nan,
        start=reading.start,
        channels={name: signals[in_file] for name, in_file in reading.channels.items()},
        trial_starts=trial_starts,
    )


def _warn(name: str, texts: Iterable[str]) -> None:
    for text in texts:
        warnings.warn(f"{name}: {text}", DataQualityWarning, stacklevel=5)
