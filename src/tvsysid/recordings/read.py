"""One function for every format: channels by name, units as the caller says."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import DoubtfulWarning, InputError
from tvsysid.recordings.channel import TIMES_ITS_SIZE, Channel, listed
from tvsysid.recordings.doubts import of_signals, of_statements
from tvsysid.recordings.find import describe_file
from tvsysid.recordings.memory import check_fits
from tvsysid.signals import Recording, checked_array

Array = NDArray[np.float64]
Columns = Literal["contiguous", "trials"]

ANGLE_UNITS = {"rad": 1.0, "deg": math.pi / 180}


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
    channels: Sequence[str] = (),
) -> Recording:
    """Read angle and torque from a file.

    Parameters
    ----------
    path
        MAT file (version 4 to 7.3), CSV or TSV with a header line, NPZ, HDF5, NetCDF, Parquet (``tvsysid[parquet]``) or
        C3D (``tvsysid[c3d]``), told by its ending.
    angle, torque
        Names of the variables or columns, as :func:`describe_file` and ``tvsysid inspect`` list them: ``run.angle`` in
        a MATLAB structure or object, ``run/angle`` in a group of an HDF5 or NetCDF file.
    sampling_rate
        In Hz. What the file says of itself is compared with it, and never used in its place.
    angle_unit
        Unit of the angle in the file. Torque is in N·m.
    torque_sign
        -1 where the file counts torque positive that assists a positive angle; a stiff joint would else come out with
        negative stiffness.
    columns
        What the columns of a time x trial matrix are: ``"contiguous"``, each follows the one before it in time, or
        ``"trials"``, each is a trial of its own.
    start
        Time of the first sample (of each trial) in s.
    channels
        Names of further variables to take along, as they are: a reference torque, an external perturbation, EMG, a
        scheduling variable.

    Returns
    -------
    Recording
        In rad and N·m.

    Raises
    ------
    InputError
        If the file cannot be read, lacks a channel (the message lists those found), or holds no usable numbers.

    Warns
    -----
    DoubtfulWarning
        If the angle, said to be in rad, is so large that it is probably in degrees; if the file states another unit or
        sampling rate; if angle or torque stand still while the joint moves, or a channel does throughout.

    Examples
    --------
    >>> import numpy as np, tempfile
    >>> angle = 0.02 * np.sin(np.arange(2000) / 50)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     np.savez(f"{folder}/ankle.npz", pos=angle, tq=80 * angle)
    ...     read_recording(f"{folder}/ankle.npz", angle="pos", torque="tq", sampling_rate=100)
    Recording(20 s at 100 Hz; angle RMS 0.0142 rad, torque RMS 1.14 N·m)
    """
    if angle_unit not in ANGLE_UNITS:
        raise InputError(f"angle_unit must be one of {', '.join(map(repr, ANGLE_UNITS))}; got {angle_unit!r}")
    if torque_sign not in (1, -1):
        raise InputError(f"torque_sign must be 1 or -1; got {torque_sign!r}")
    if columns not in ("contiguous", "trials"):
        raise InputError(f"columns must be 'contiguous' or 'trials'; got {columns!r}")
    file = Path(path)
    found = describe_file(file)
    names = tuple(dict.fromkeys((angle, torque, *channels)))
    signals = _signals(file, found, names)
    rows, trials = signals[angle].shape
    flat = {name: values.ravel(order="F") for name, values in signals.items()}
    recording = Recording(
        angle=flat[angle] * ANGLE_UNITS[angle_unit],
        torque=flat[torque] * torque_sign,
        sampling_rate=sampling_rate,
        start=start,
        channels={name: flat[name] for name in channels},
        trial_starts=tuple(range(0, rows * trials, rows)) if columns == "trials" else (0,),
    )
    doubts = of_statements({name: found[name] for name in names}, angle, torque, recording.sampling_rate, angle_unit)
    for doubt in (*doubts, *of_signals(recording, angle, torque, angle_unit)):
        warnings.warn(f"{file.name}: {doubt}", DoubtfulWarning, stacklevel=2)
    return recording


def read_trials(paths: Sequence[str | Path], **settings: Any) -> Recording:
    """Read trials that are in files of their own, one after the other.

    Several trials in one file are the columns of its matrices (``columns="trials"``), or have names of their own: then
    read each by :func:`read_recording`, and put them together by :func:`join_trials`.

    Parameters
    ----------
    paths
        Files in the order of the trials, of any formats that :func:`read_recording` reads.
    **settings
        As of :func:`read_recording`, the same for all files.

    Returns
    -------
    Recording
        With a trial for each file, or for each column of each with ``columns="trials"``.

    Raises
    ------
    InputError
        If a file cannot be read, or there is none.

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
        raise InputError(f"paths: expected several files, got {str(paths)!r}; give a list, or use read_recording")
    return join_trials([read_recording(path, **settings) for path in paths])


def join_trials(recordings: Sequence[Recording]) -> Recording:
    """Recordings as the trials of one: nothing is filtered or cut across where they meet.

    Parameters
    ----------
    recordings
        Of one sampling rate, one start and the same channels.

    Raises
    ------
    InputError
        If there are none, or they differ in what they must share.
    """
    if not recordings:
        raise InputError("join_trials: expected recordings, got none")
    first = recordings[0]
    for number, other in enumerate(recordings):
        for what in ("sampling_rate", "start", "channels"):
            one, two = (getattr(item, what) for item in (first, other))
            one, two = (sorted(one), sorted(two)) if what == "channels" else (one, two)
            if one != two:
                raise InputError(
                    f"join_trials: recording {number} and the first differ in {what.replace('_', ' ')}: {two} "
                    f"instead of {one}; read them alike, or decimate to one rate before"
                )
    befores = np.cumsum([0, *(len(item) for item in recordings[:-1])])
    return Recording(
        angle=np.concatenate([item.angle for item in recordings]),
        torque=np.concatenate([item.torque for item in recordings]),
        sampling_rate=first.sampling_rate,
        start=first.start,
        channels={name: np.concatenate([item.channels[name] for item in recordings]) for name in first.channels},
        trial_starts=tuple(
            int(before) + begin for before, item in zip(befores, recordings, strict=True) for begin in item.trial_starts
        ),
    )


def _signals(file: Path, found: Mapping[str, Channel], names: Sequence[str]) -> dict[str, Array]:
    """Channels of one length as finite numbers of axes (time, trial)."""
    for name in names:
        if name not in found:
            raise InputError(f"{file.name}: no channel {name!r}; it holds {listed(found)}")
    # The rest is refused for its values first, as a text's length says little.
    shapes = {name: _time_first(found[name].shape) for name in names if found[name].values is not None}
    if len(set(shapes.values())) > 1:
        told = ", ".join(f"{name} {' x '.join(map(str, shape))}" for name, shape in shapes.items())
        raise InputError(
            f"{file.name}: the channels have different lengths: {told}; name channels that were sampled together, or "
            "cut or resample them before"
        )
    check_fits(file.name, sum(8 * TIMES_ITS_SIZE * math.prod(shape) for shape in shapes.values()))
    signals = {}
    for name in names:
        what = f"{file.name}: {name}"
        values = found[name].read(what)
        signals[name] = checked_array(what, values.reshape(_time_first(values.shape)), ("time", "trial"))
    return signals


def _time_first(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Shape of a vector of any orientation as (time, 1); that of a matrix as it is."""
    if len(shape) < 2 or (len(shape) == 2 and shape[0] == 1):
        return (math.prod(shape), 1)
    return shape
