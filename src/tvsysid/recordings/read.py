"""Read a recording from one file, or from several files with one trial each."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import attrs
import numpy as np

from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.recordings.channel import Channel, explained
from tvsysid.recordings.formats import describe_file
from tvsysid.recordings.reading import Reading
from tvsysid.signals import Array, Recording

MAX_ANGLE_RMS_RAD = 0.2  # about the mean; more is probably in degrees
RATE_TOLERANCE = 1e-3  # relative: files round their rates
UNITS = {  # factor to rad or N·m, and how files spell the unit
    "angle": {"rad": (1.0, r"rad(ians?)?"), "deg": (math.pi / 180, r"deg(rees?)?|°")},
    "torque": {
        "Nm": (1.0, r"nm|newtonmet(er|re)s?"),
        "Nmm": (1e-3, r"nmm|newtonmillimet(er|re)s?"),
    },
}


def read_recording(path: str | Path, reading: Reading | None = None, **settings: Any) -> Recording:
    """Read angle (rad), torque (N·m) and further channels (unscaled) from a file.

    Parameters
    ----------
    path
        MAT file (version 4 to 7.3), CSV or TSV, NPZ, HDF5, NetCDF, NWB, Motion-BIDS
        (``_motion.tsv``), Parquet (``tvsysid[parquet]``), C3D (``tvsysid[c3d]``), EDF or BDF
        (``tvsysid[edf]``). The file's extension tells the format.
    reading
        Settings for reading the file. By default, they are built from ``settings``.
    angle, torque
        Names of the variables or columns, as ``tvsysid inspect`` lists them: ``run.angle`` in a
        MATLAB structure or object, ``run/angle`` in a group of an HDF5 or NetCDF file.
    sampling_rate
        In Hz. If the file states another rate, a warning is given and this rate is used.
    **settings
        ``channels={"emg": "EMG_SIGNAL"}``, ``columns="trials"``, ``torque_sign=-1``,
        ``angle_unit="deg"``, ``torque_unit="Nmm"`` and ``start``.

    Raises
    ------
    InputError
        If the angle, the torque or the sampling rate is not given. If the file cannot be read,
        lacks a channel (the message lists its channels), or holds no usable numbers.

    Warns
    -----
    DataQualityWarning
        If the angle is read in rad, but is probably in degrees. If the file states another unit or
        sampling rate.

    Examples
    --------
    >>> import numpy as np, tempfile
    >>> angle = 0.02 * np.sin(np.arange(2000) / 50)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     np.savez(f"{folder}/ankle.npz", angle=angle, torque=80 * angle)
    ...     read_recording(f"{folder}/ankle.npz", angle="angle", torque="torque", sampling_rate=100)
    Recording(20 s at 100 Hz; angle RMS 0.0142 rad, torque RMS 1.14 N·m)
    """
    file, reading = Path(path), reading or Reading(**settings)
    with explained(file.name):
        channels, signals, trial_starts = _read_signals(file, reading)
        recording = _recording(reading, signals, trial_starts)
    _warn(file.name, channels, recording, reading)
    return recording


def read_usable_trials(
    paths: Mapping[str, Path], reading: Reading, shortest: float = 0.0
) -> Recording:
    """Read trials as :func:`tvsysid.read_trials` does, but leave out unusable trials.

    Parameters
    ----------
    paths
        Files by name, in the order of the trials.
    reading
        How all files are read.
    shortest
        Minimum duration of a trial in s.

    Raises
    ------
    InputError
        If no trial can be used.

    Warns
    -----
    DataQualityWarning
        Of each trial that is left out, with the reason, and as :func:`tvsysid.read_recording`.
    """
    usable: list[Recording] = []

    def leave_out(name: str, reason: str) -> None:
        warnings.warn(f"{name} is left out: {reason}", DataQualityWarning, stacklevel=3)

    for label, file in paths.items():
        try:
            channels, signals, starts = _read_signals(file, reading)
        except InputError as error:
            leave_out(label, str(error).removeprefix(f"{file}: ").removeprefix(f"{file.name}: "))
            continue
        for number, trial in enumerate(map(slice, starts, (*starts[1:], None)), start=1):
            name = label if len(starts) == 1 else f"{label}, trial {number}"
            try:
                recording = _recording(reading, {key: each[trial] for key, each in signals.items()})
                if recording.duration < shortest:
                    raise InputError(
                        f"the trial lasts {recording.duration:g} s, less than the {shortest:g} s "
                        "that a realization and the trimmed ends need"
                    )
            except InputError as error:
                leave_out(name, str(error))
                continue
            usable.append(recording)
            _warn(name, channels, recording, reading)
    if not usable:
        raise InputError("no trial can be used")
    return join_trials(usable)


def read_trials(paths: Sequence[str | Path], **settings: Any) -> Recording:
    """Read several files as the trials of one recording, in the given order.

    If one file holds several trials as columns of its matrices, read it by
    :func:`tvsysid.read_recording` with ``columns="trials"``. If its trials are channels with
    different names, read each and join them by :func:`tvsysid.recordings.join_trials`.

    Parameters
    ----------
    paths
        Files, of any formats.
    **settings
        Settings of :func:`tvsysid.read_recording`, the same for all files.

    Examples
    --------
    >>> import numpy as np, tempfile
    >>> angle = 0.02 * np.sin(np.arange(2000) / 50)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     files = [f"{folder}/{trial}.npz" for trial in ("first", "second")]
    ...     for file in files:
    ...         np.savez(file, angle=angle, torque=80 * angle)
    ...     read_trials(files, angle="angle", torque="torque", sampling_rate=100).trial_starts
    (0, 2000)
    """
    if isinstance(paths, (str, Path)):
        raise InputError(
            f"paths: expected several files, got {str(paths)!r}; give a list, or use read_recording"
        )
    return join_trials([read_recording(path, **settings) for path in paths])


def join_trials(recordings: Sequence[Recording]) -> Recording:
    """Join recordings as the trials of one recording. No filter or cut crosses their boundaries.

    An InputError is raised if they differ in sampling rate, start or channels, or there are none.
    """
    if len({(each.sampling_rate, each.start, *sorted(each.channels)) for each in recordings}) != 1:
        raise InputError(
            "join_trials: expected recordings with the same rate (Hz), start (s) and channels; "
            "read them alike, or decimate to one rate before"
        )
    first, starts, length = recordings[0], [], 0
    for item in recordings:
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
        recorded_angle=np.concatenate(recorded) if recorded else None,
    )


def _read_signals(
    file: Path, reading: Reading
) -> tuple[dict[str, Channel], dict[str, Array], tuple[int, ...]]:
    """Return the channel and the values by signal, and the first sample of each trial."""
    file_channels = describe_file(file)
    rates = {
        file_channels[name].sampling_rate
        for name in (reading.angle, reading.torque)
        if name in file_channels
    }
    if reading.sampling_rate is None and len(rates) == 1 and None not in rates:
        rate = f"{rates.pop():g}, which the file states"
        raise InputError(f"missing: sampling_rate; add --rate {rate}")
    names = reading.names
    if missing := [name for name in names.values() if name not in file_channels]:
        raise InputError(
            f"no channel {missing[0]!r}; the file holds {_listed(file_channels) or 'nothing'}"
        )
    channels = {signal: file_channels[name] for signal, name in names.items()}
    matrices = {signal: _as_matrix(name, file_channels[name]) for signal, name in names.items()}
    layouts = {(matrices[signal].shape, channels[signal].trial_starts) for signal in names}
    if len(layouts) > 1:
        raise InputError(
            "the channels have different lengths or trials: "
            f"{_listed({name: file_channels[name] for name in names.values()})}; name "
            "channels that were sampled together, or cut or resample them to one rate before"
        )
    (length, columns), segments = layouts.pop()
    starts: tuple[int, ...] = (0,)
    if reading.columns == "trials":
        starts = segments or tuple(range(0, length * columns, length))
    elif segments:
        raise InputError(
            f"the channels are {len(segments)} segments with gaps between them; read each as a "
            "trial (--columns trials)"
        )
    return channels, {signal: each.ravel(order="F") for signal, each in matrices.items()}, starts


def _listed(channels: Mapping[str, Channel]) -> str:
    return ", ".join(f"{name} ({channel.described})" for name, channel in channels.items())


def _as_matrix(name: str, channel: Channel) -> Array:
    """Return the values of a channel, shape (time, column)."""
    values = np.atleast_2d(channel.read(name))
    if len(values) == 1:
        values = values.T
    if values.ndim != 2:
        raise InputError(
            f"{name}: expected a vector or a matrix, got an array of shape {values.shape}; name "
            "another channel"
        )
    return values


def _recording(
    reading: Reading, signals: Mapping[str, Array], trial_starts: tuple[int, ...] = (0,)
) -> Recording:
    """Build the recording from its signals, each of shape (time,)."""
    return Recording(
        angle=signals["angle"] * UNITS["angle"][reading.angle_unit][0],
        torque=signals["torque"] * (reading.torque_sign * UNITS["torque"][reading.torque_unit][0]),
        sampling_rate=reading.sampling_rate or math.nan,
        start=reading.start,
        channels={name: signals[name] for name in reading.channels},
        trial_starts=trial_starts,
    )


def _contradictions(
    channels: Mapping[str, Channel], recording: Recording, reading: Reading
) -> Iterator[str]:
    """Yield a warning for each setting that the file contradicts, and for an angle in degrees.

    ``channels`` are the channels that were read, by their names in the recording.
    """
    given, names = recording.sampling_rate, reading.names
    rates = sorted({each.sampling_rate or given for each in channels.values()})
    for rate in rates:
        if abs(rate - given) > RATE_TOLERANCE * given:
            yield f"the file states {rate:g} Hz, you gave {given:g} Hz; check the rate"
    for signal, unit in (("angle", reading.angle_unit), ("torque", reading.torque_unit)):
        stated = channels[signal].unit
        plain = re.sub(r"[\s·⋅.*\-_()\[\]]", "", stated.lower())
        known = [
            each for each, (_, spelling) in UNITS[signal].items() if re.fullmatch(spelling, plain)
        ]
        if stated and unit not in known:
            remedy = f"add --{signal}-unit {known[0]}" if known else "convert it"
            yield (
                f"the file states the unit {stated!r} for {names[signal]}, but it is read in "
                f"{unit}; {remedy}"
            )
    rms = float(np.std(recording.angle))
    if rms > MAX_ANGLE_RMS_RAD:
        yield (
            f"{reading.angle} has an RMS of {rms:.3g} rad about its mean; if it is in degrees, "
            "give angle_unit='deg' (--angle-unit deg)"
        )


def _warn(
    name: str, channels: Mapping[str, Channel], recording: Recording, reading: Reading
) -> None:
    """Warn of each contradiction, with the name of the file or trial."""
    for text in _contradictions(channels, recording, reading):
        warnings.warn(f"{name}: {text}", DataQualityWarning, stacklevel=3)
