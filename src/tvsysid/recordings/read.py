"""One function for every format: channels by name, units as the caller says."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import attrs
import numpy as np

from tvsysid.checked import checked_array
from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.recordings.channel import Channel
from tvsysid.recordings.limits import check_fits
from tvsysid.recordings.plausible import contradictions, implausible, unlike_trials
from tvsysid.recordings.process import describe_file
from tvsysid.signals import Array, Recording

Columns = Literal["contiguous", "trials"]

ANGLE_UNITS = {"rad": 1.0, "deg": math.pi / 180}
TORQUE_UNITS = {"Nm": 1.0, "Nmm": 1e-3}


def read_recording(
    path: str | Path,
    *,
    angle: str,
    torque: str,
    sampling_rate: float,
    angle_unit: Literal["rad", "deg"] = "rad",
    torque_sign: Literal[1, -1] = 1,
    columns: Columns = "contiguous",
    start: float = 0.0,
    channels: Mapping[str, str] | None = None,
    header: bool = True,
    torque_unit: Literal["Nm", "Nmm"] = "Nm",
) -> Recording:
    """Read angle and torque from a file, in rad and N·m.

    Parameters
    ----------
    path
        MAT file (version 4 to 7.3), CSV or TSV, NPZ, HDF5, NetCDF, NWB, Motion-BIDS
        (``_motion.tsv``), Parquet (``tvsysid[parquet]``), C3D (``tvsysid[c3d]``), EDF or BDF
        (``tvsysid[edf]``), by its ending.
    angle, torque
        Names of the variables or columns, as :func:`tvsysid.recordings.describe_file` and ``tvsysid
        inspect`` list them: ``run.angle`` in a MATLAB structure or object, ``run/angle`` in a group
        of an HDF5 or NetCDF file.
    sampling_rate
        In Hz. What the file says of itself is compared with it, and never used in its place.
    angle_unit
        Unit of the angle in the file.
    torque_sign
        -1 where the file counts torque positive that assists a positive angle; a stiff joint would
        else come out with negative stiffness.
    columns
        What the columns of a time x trial matrix are: ``"contiguous"``, each follows the one before
        it in time, or ``"trials"``, each is a trial of its own, as are the segments of the Kearney
        laboratory's ``segdat``.
    start
        Time of the first sample (of each trial) in s.
    channels
        Further signals to take along, as they are (EMG, a reference torque, a scheduling variable):
        the name that each gets in the recording, and its name in the file, ``{"emg":
        "EMG_SIGNAL"}``.
    header
        Whether the first line of a text table has names; if not, columns are called 1, 2, ...
    torque_unit
        Unit of the torque in the file: N·m, or N·mm, as C3D files of gait laboratories have it.

    Raises
    ------
    InputError
        If the file cannot be read, lacks a channel (the message lists those that it holds), or
        holds no usable numbers.

    Warns
    -----
    DataQualityWarning
        If the angle, said to be in rad, is so large that it is probably in degrees; if the file
        states another unit or sampling rate; if angle or torque stand still while the joint moves,
        or a channel does throughout.

    Examples
    --------
    >>> import numpy as np, tempfile
    >>> angle = 0.02 * np.sin(np.arange(2000) / 50)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     np.savez(f"{folder}/ankle.npz", pos=angle, tq=80 * angle)
    ...     read_recording(f"{folder}/ankle.npz", angle="pos", torque="tq", sampling_rate=100)
    Recording(20 s at 100 Hz; angle RMS 0.0142 rad, torque RMS 1.14 N·m)
    """
    request = _Request(
        angle,
        torque,
        sampling_rate,
        angle_unit,
        torque_sign,
        columns,
        start,
        channels or {},
        header,
        torque_unit,
    )
    file = Path(path)
    found, values, starts = _signals(file, request)
    signals = {
        name: checked_array(f"{file.name}: {name}", matrix, ("time", "trial")).ravel(order="F")
        for name, matrix in values.items()
    }
    recording = request.recording(signals, starts)
    for text in request.warnings(found, recording):
        warnings.warn(f"{file.name}: {text}", DataQualityWarning, stacklevel=2)
    return recording


@attrs.frozen
class _Request:
    """What the caller says of a file; nothing of it is guessed."""

    angle: str
    torque: str
    sampling_rate: float
    angle_unit: Literal["rad", "deg"] = "rad"
    torque_sign: Literal[1, -1] = 1
    columns: Columns = "contiguous"
    start: float = 0.0
    channels: Mapping[str, str] = attrs.field(factory=dict)
    header: bool = True
    torque_unit: Literal["Nm", "Nmm"] = "Nm"

    def __attrs_post_init__(self) -> None:
        for what, unit, known in (
            ("angle", self.angle_unit, ANGLE_UNITS),
            ("torque", self.torque_unit, TORQUE_UNITS),
        ):
            if unit not in known:
                raise InputError(
                    f"{what}_unit must be one of {', '.join(map(repr, known))}; got {unit!r}"
                )
        if self.torque_sign not in (1, -1):
            raise InputError(f"torque_sign must be 1 or -1; got {self.torque_sign!r}")
        if self.angle == self.torque:
            raise InputError(
                f"angle and torque are both {self.angle!r}; name the channel of each (--angle, "
                "--torque)"
            )
        if self.columns not in ("contiguous", "trials"):
            raise InputError(f"columns must be 'contiguous' or 'trials'; got {self.columns!r}")
        if not isinstance(self.channels, Mapping):
            raise InputError(
                "channels: expected a name in the recording and one in the file for each, got "
                f"{self.channels!r}; "
                "give them as in {'emg': 'EMG_SIGNAL'}"
            )
        if taken := [name for name in ("angle", "torque") if name in self.channels]:
            raise InputError(
                f"channels: {taken[0]!r} is the name of a signal already; give the channel "
                "another one"
            )

    @property
    def names(self) -> tuple[str, ...]:
        """Names in the file of all that is read."""
        return tuple(dict.fromkeys((self.angle, self.torque, *self.channels.values())))

    def recording(
        self, signals: Mapping[str, Array], trial_starts: tuple[int, ...] = (0,)
    ) -> Recording:
        """Recording of signals of shape (time,), in the units that are said."""
        return Recording(
            angle=_scaled(signals[self.angle], ANGLE_UNITS[self.angle_unit]),
            torque=_scaled(signals[self.torque], self.torque_sign * TORQUE_UNITS[self.torque_unit]),
            sampling_rate=self.sampling_rate,
            start=self.start,
            channels={name: signals[theirs] for name, theirs in self.channels.items()},
            trial_starts=trial_starts,
        )

    def warnings(self, found: Mapping[str, Channel], recording: Recording) -> Iterator[str]:
        """What the file states otherwise, and what looks wrong."""
        read, units = (
            {name: found[name] for name in self.names},
            {self.angle: self.angle_unit, self.torque: self.torque_unit},
        )
        yield from contradictions(read, recording.sampling_rate, units)
        yield from implausible(recording, self.angle, self.torque, self.angle_unit)


def channels_typed(texts: Iterable[str]) -> dict[str, str]:
    """Further channels of a recording, and their names in the file, of texts NAME=CHANNEL."""
    found = {}
    for text in texts:
        name, _, in_file = text.partition("=")
        if not name or not in_file:
            raise InputError(f"--channel {text}: expected NAME=CHANNEL, as in emg=EMG_SIGNAL")
        found[name] = in_file
    return found


def _scaled(values: Array, factor: float) -> Array:
    """Values times a factor, without a copy where there is nothing to do."""
    if factor == 1:
        return values
    scaled = values * factor
    scaled.flags.writeable = False
    return scaled


class UsableTrials(NamedTuple):
    """What could be read of many trials."""

    recording: Recording | None
    """Those that can be used; None if there is none."""
    names: tuple[str, ...]
    """What each of them is called: its file, or file and number of the trial."""
    refused: dict[str, str]
    """Why the others cannot be used, by the same names."""


def read_usable_trials(
    paths: Mapping[str, Path], shortest: float = 0.0, **settings: Any
) -> UsableTrials:
    """Read trials as :func:`tvsysid.read_trials` does, and leave out those that cannot be used instead of giving up.

    Files are in the order of the trials, by what they are called. A trial must last ``shortest``
    seconds. Settings are those of :func:`tvsysid.read_recording`; an InputError is raised if
    they are wrong by themselves.
    """
    request = _Request(**settings)
    usable: dict[str, Recording] = {}
    refused: dict[str, str] = {}
    for called, file in paths.items():
        try:
            found, values, starts = _signals(file, request)
        except (InputError, MemoryError) as error:
            refused[called] = (
                str(error).removeprefix(f"{file}: ").removeprefix(f"{file.name}: ")
                or "no memory left"
            )
            continue
        signals = {channel: matrix.ravel(order="F") for channel, matrix in values.items()}
        for number, trial in enumerate(map(slice, starts, (*starts[1:], None))):
            name = called if len(starts) == 1 else f"{called}, trial {number + 1}"
            try:
                checked = {
                    channel: checked_array(channel, each[trial], ("time",))
                    for channel, each in signals.items()
                }
                recording = request.recording(checked)
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
            for text in request.warnings(found, recording):
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


def _signals(
    file: Path, request: _Request
) -> tuple[dict[str, Channel], dict[str, Array], tuple[int, ...]]:
    """All channels of a file, the values of those asked for, of one shape (time, trial), and where trials start."""
    found = describe_file(file, request.header)
    names = request.names
    for name in names:
        if name not in found:
            there = (
                ", ".join(f"{own} ({channel.described})" for own, channel in found.items())
                or "nothing"
            )
            raise InputError(f"{file.name}: no channel {name!r}; it holds {there}")
    # The rest is refused for its values first, as a text's length says little.
    shapes = {
        name: _time_first(found[name].shape) for name in names if found[name].values is not None
    }
    if len(set(shapes.values())) > 1:
        told = ", ".join(f"{name} {' x '.join(map(str, shape))}" for name, shape in shapes.items())
        rates = {name: found[name].sampling_rate for name in shapes if found[name].sampling_rate}
        at = (
            ", ".join(f"{name} {rate:g} Hz" for name, rate in rates.items())
            if len(set(rates.values())) > 1
            else ""
        )
        raise InputError(
            f"{file.name}: the channels have different lengths: "
            f"{told}{f' (sampled at {at})' if at else ''}; name "
            "channels that were sampled together, or cut or resample them to one rate before"
        )
    check_fits(file.name, sum(found[name].needed for name in shapes))
    signals = {}
    for name in names:
        values = found[name].read(f"{file.name}: {name}")
        signals[name] = values.reshape(_time_first(values.shape))
        if signals[name].ndim != 2 or not signals[name].size:
            checked_array(f"{file.name}: {name}", signals[name], ("time", "trial"))
    return found, signals, _trial_starts(file, request, found, signals[request.angle].shape)


def _trial_starts(
    file: Path, request: _Request, found: Mapping[str, Channel], shape: tuple[int, ...]
) -> tuple[int, ...]:
    """First sample of each trial: of each column, or where the file itself says that one begins."""
    stated = {found[name].trial_starts for name in request.names}
    if len(stated) > 1:
        raise InputError(
            f"{file.name}: the channels are cut into trials at different samples; cut them alike"
        )
    if request.columns == "trials":
        return next(iter(stated)) or tuple(range(0, shape[0] * shape[1], shape[0]))
    if len(segments := next(iter(stated))) > 1:
        raise InputError(
            f"{file.name}: the channels are {len(segments)} segments with gaps between them; read "
            "each as a trial "
            "(--columns trials)"
        )
    return (0,)


def _time_first(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Shape of a vector of any orientation as (time, 1); that of a matrix as it is."""
    if len(shape) < 2 or (len(shape) == 2 and shape[0] == 1):
        return (math.prod(shape), 1)
    return shape
