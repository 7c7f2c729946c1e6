"""Read a recording from a file, or from several that hold a trial each."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.recordings.channel import COPIES, Channel, check_memory
from tvsysid.recordings.formats import describe_file
from tvsysid.recordings.plausible import contradictions, implausible, unlike_trials
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
    try:
        recording = _recording(reading, signals, trial_starts)
    except InputError as error:
        raise InputError(f"{file.name}: {error}") from error
    _warn(file.name, reading, channels, recording)
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
        except (InputError, MemoryError) as error:
            reason = str(error).removeprefix(f"{file}: ").removeprefix(f"{file.name}: ")
            refused[label] = reason or "no memory left"
            continue
        for number, trial in enumerate(map(slice, starts, (*starts[1:], None)), start=1):
            name = label if len(starts) == 1 else f"{label}, trial {number}"
            try:
                recording = _recording(reading, {key: each[trial] for key, each in signals.items()})
            except InputError as error:
                refused[name] = str(error)
                continue
            if recording.duration < shortest:
                refused[name] = (
                    f"it lasts {recording.duration:g} s, and a realization with the ends that are "
                    f"cut off takes {shortest:g} s"
                )
                continue
            usable[name] = recording
            _warn(name, reading, channels, recording)
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
    """Join recordings as the trials of one: nothing is filtered or cut across where they meet.

    An InputError is raised if they differ in sampling rate, start or channels, or there are none.
    """
    if not recordings:
        raise InputError("join_trials: expected recordings, got none")
    first = recordings[0]
    for number, item in enumerate(recordings):
        for what, one, other in (
            ("sampling rate", first.sampling_rate, item.sampling_rate),
            ("start", first.start, item.start),
            ("channels", sorted(first.channels), sorted(item.channels)),
        ):
            if one != other:
                raise InputError(
                    f"join_trials: recording {number} and the first differ in {what}: {other} "
                    f"instead of {one}; read them alike, or decimate to one rate before"
                )
    recorded = [item.recorded_angle for item in recordings if item.recorded_angle is not None]
    begins = np.cumsum([0, *map(len, recordings[:-1])]).tolist()
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
            begin + start
            for begin, item in zip(begins, recordings, strict=True)
            for start in item.trial_starts
        ),
        origin=first.origin,
        recorded_angle=np.concatenate(recorded) if len(recorded) == len(recordings) else None,
    )


def _read_signals(
    file: Path, reading: Reading
) -> tuple[dict[str, Channel], dict[str, Array], tuple[int, ...]]:
    """Return the channels that a recording is made of, their values, and where trials start."""
    found = describe_file(file, reading.header)
    for name in reading.names:
        if name not in found:
            there = [f"{own} ({channel.described})" for own, channel in found.items()]
            raise InputError(
                f"{file.name}: no channel {name!r}; it holds {', '.join(there) or 'nothing'}"
            )
    channels = {name: found[name] for name in reading.names}
    # Channels without numbers are refused when they are read.
    shapes = {
        name: _time_first(channel.shape)
        for name, channel in channels.items()
        if channel.values is not None
    }
    if len(set(shapes.values())) > 1:
        lengths = [f"{name} {' x '.join(map(str, shape))}" for name, shape in shapes.items()]
        rates = {name: channels[name].sampling_rate for name in shapes}
        stated = ", ".join(f"{name} {rate:g} Hz" for name, rate in rates.items() if rate)
        sampled = f" (sampled at {stated})" if len({*rates.values()} - {None}) > 1 else ""
        raise InputError(
            f"{file.name}: the channels have different lengths: {', '.join(lengths)}{sampled}; "
            "name channels that were sampled together, or cut or resample them to one rate before"
        )
    check_memory(file.name, sum(COPIES * channels[name].size for name in shapes))
    signals = {}
    for name, channel in channels.items():
        values = channel.read(f"{file.name}: {name}")
        length, *columns = _time_first(values.shape)
        if len(columns) != 1:
            raise InputError(
                f"{file.name}: {name}: expected a vector or a matrix, got an array of shape "
                f"{values.shape}; name another channel"
            )
        signals[name] = values.ravel(order="F")
    return channels, signals, _trial_starts(file, reading, channels, length, columns[0])


def _trial_starts(
    file: Path, reading: Reading, channels: Mapping[str, Channel], length: int, columns: int
) -> tuple[int, ...]:
    """Return the first sample of each trial: of each column, or as the file states."""
    stated = {channel.trial_starts for channel in channels.values()}
    if len(stated) > 1:
        raise InputError(
            f"{file.name}: the channels are cut into trials at different samples; cut them alike"
        )
    segments = stated.pop()
    if reading.columns == "trials":
        return segments or tuple(range(0, length * columns, length))
    if len(segments) > 1:
        raise InputError(
            f"{file.name}: the channels are {len(segments)} segments with gaps between them; "
            "read each as a trial (--columns trials)"
        )
    return (0,)


def _recording(
    reading: Reading, signals: Mapping[str, Array], trial_starts: tuple[int, ...] = (0,)
) -> Recording:
    """Return the recording of signals of shape (time,), by their names in the file."""
    angle, torque = reading.names[:2]
    torque_factor = reading.torque_sign * NM_PER_UNIT[reading.torque_unit]
    return Recording(
        angle=_scaled(signals[angle], RAD_PER_UNIT[reading.angle_unit]),
        torque=_scaled(signals[torque], torque_factor),
        sampling_rate=reading.sampling_rate or math.nan,
        start=reading.start,
        channels={name: signals[in_file] for name, in_file in reading.channels.items()},
        trial_starts=trial_starts,
    )


def _scaled(values: Array, factor: float) -> Array:
    return values if factor == 1 else values * factor


def _warn(
    name: str, reading: Reading, channels: Mapping[str, Channel], recording: Recording
) -> None:
    """Warn of all that the file states otherwise, or that looks wrong."""
    angle, torque = reading.names[:2]
    units = {angle: reading.angle_unit, torque: reading.torque_unit}
    texts: Iterator[str] = contradictions(channels, recording.sampling_rate, units)
    for text in (*texts, *implausible(recording, angle, torque, reading.angle_unit)):
        warnings.warn(f"{name}: {text}", DataQualityWarning, stacklevel=5)


def _time_first(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the shape of a vector of any orientation as (time, 1), and that of a matrix as is."""
    is_vector = len(shape) < 2 or (len(shape) == 2 and shape[0] == 1)
    return (math.prod(shape), 1) if is_vector else shape
