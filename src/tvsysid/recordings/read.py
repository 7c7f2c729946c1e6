"""One function for every format: channels by name, units as the caller says."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import DoubtfulWarning, InputError
from tvsysid.recordings.mat import read_mat
from tvsysid.recordings.text import read_csv, read_tsv
from tvsysid.signals import Recording, checked_array

Array = NDArray[np.float64]
Columns = Literal["contiguous", "trials"]

READERS: dict[str, Callable[[Path], dict[str, NDArray[Any]]]] = {
    ".mat": read_mat,
    ".csv": read_csv,
    ".tsv": read_tsv,
}
ANGLE_UNITS = {"rad": 1.0, "deg": math.pi / 180}
LARGEST_ANGLE = 0.5
"""RMS in rad above which an angle about its mean is probably in degrees."""


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
        MAT file (version 5 or 7), CSV with a header line, or TSV; told by its ending.
    angle, torque
        Names of the variables or columns.
    sampling_rate
        In Hz.
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
        Names of further variables to take along, as they are.

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
        If the angle, said to be in rad, is so large that it is probably in degrees.
    """
    if angle_unit not in ANGLE_UNITS:
        raise InputError(f"angle_unit must be one of {', '.join(map(repr, ANGLE_UNITS))}; got {angle_unit!r}")
    if torque_sign not in (1, -1):
        raise InputError(f"torque_sign must be 1 or -1; got {torque_sign!r}")
    if columns not in ("contiguous", "trials"):
        raise InputError(f"columns must be 'contiguous' or 'trials'; got {columns!r}")
    file = Path(path)
    found = read_arrays(file)
    wanted = {name: _channel(file, found, name) for name in dict.fromkeys((angle, torque, *channels))}
    shapes = {name: values.shape for name, values in wanted.items()}
    if len(set(shapes.values())) > 1:
        listed = ", ".join(f"{name} {_size(shape)}" for name, shape in shapes.items())
        raise InputError(f"{file.name}: the channels have different lengths: {listed}")
    rows, trials = next(iter(shapes.values()))
    flat = {name: values.ravel(order="F") for name, values in wanted.items()}
    size = float(np.std(flat[angle])) * ANGLE_UNITS[angle_unit]
    if size > LARGEST_ANGLE:
        warnings.warn(
            f"{file.name}: {angle} has an RMS of {size:.3g} rad about its mean; if it is in degrees, say so with "
            "angle_unit='deg'",
            DoubtfulWarning,
            stacklevel=2,
        )
    return Recording(
        angle=flat[angle] * ANGLE_UNITS[angle_unit],
        torque=flat[torque] * torque_sign,
        sampling_rate=sampling_rate,
        start=start,
        channels={name: flat[name] for name in channels},
        trial_starts=tuple(range(0, rows * trials, rows)) if columns == "trials" else (0,),
    )


def read_arrays(file: Path) -> dict[str, NDArray[Any]]:
    """All variables or columns of a file, by name."""
    reader = READERS.get(file.suffix.lower())
    if reader is None:
        raise InputError(f"{file}: unknown ending {file.suffix!r}; files that can be read end in {', '.join(READERS)}")
    if not file.exists():
        raise InputError(f"{file}: no such file")
    if not file.is_file():
        raise InputError(f"{file}: expected a file, this is a folder")
    if file.stat().st_size == 0:
        raise InputError(f"{file}: the file is empty")
    return reader(file)


def _channel(file: Path, found: dict[str, NDArray[Any]], name: str) -> Array:
    """Channel as finite numbers of axes (time, trial)."""
    if name not in found:
        listed = ", ".join(f"{known} ({_size(values.shape)})" for known, values in found.items()) or "nothing"
        raise InputError(f"{file.name}: no channel {name!r}; it holds {listed}")
    values = found[name]
    if values.ndim == 1:
        values = values[:, None]
    if values.ndim == 2 and values.shape[0] == 1:
        values = values.T
    return checked_array(f"{file.name}: {name}", values, ("time", "trial"))


def _size(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape)) or "one value"
