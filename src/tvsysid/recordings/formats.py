"""Find the format of a file, and list its channels.

A reader is a generator: it takes a file and yields names and channels while the file is open. To
add a format, write one in a module of its own, and name it in ``READERS``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import attrs
import numpy as np

from tvsysid.errors import InputError
from tvsysid.recordings.channel import RATE_NAMES, Channel, explained
from tvsysid.recordings.worker import Result, run_isolated

READERS = {
    ".mat": "mat:read_mat",
    ".csv": "tables:read_text",
    ".tsv": "tables:read_text",
    "_motion.tsv": "tables:read_motion",
    ".npz": "tables:read_npz",
    ".h5": "hdf5:read_hdf5",
    ".hdf5": "hdf5:read_hdf5",
    ".nc": "netcdf:read_netcdf",
    ".nwb": "hdf5:read_nwb",
    ".parquet": "tables:read_parquet",
    ".c3d": "c3d:read_c3d",
    ".edf": "edf:read_edf",
    ".bdf": "edf:read_edf",
}
"""Readers, as ``module:function``, by the ending of the file's name."""
ISOLATED = ("mat", "hdf5", "netcdf", "c3d")
"""Modules whose libraries crash or never end on damaged files."""


def describe_file(path: str | Path) -> dict[str, Channel]:
    """Return the channels of a file by name, in the file's order.

    Parameters
    ----------
    path
        File of any format that :func:`tvsysid.read_recording` reads.

    Raises
    ------
    InputError
        If the file cannot be read, or is not what its ending says.
    """
    file = Path(path).absolute()
    with explained(str(path)):
        return _call(read_channels, file, _reader_of(file))


def recordings_in(paths: Iterable[Path]) -> list[Path]:
    """Return files, and in place of a folder the files in it that can be read."""
    return [
        file
        for path in paths
        for file in (sorted(path.iterdir()) if path.is_dir() else [path])
        if file == path or file.name.lower().endswith(tuple(READERS))
    ]


def read_channels(file: Path, reader: str) -> dict[str, Channel]:
    """Return the channels of a file by name. A variable such as ``fs`` gives its group's rate."""
    channels: dict[str, Channel] = {}
    rates: dict[str, object] = {}
    for name, channel in _read(file, reader):
        if name in channels:
            raise InputError(f"two channels are called {name!r}; give each a name of its own")
        values, group = channel.values, _group(name)
        if name[len(group) :].lower() in RATE_NAMES and math.prod(channel.shape) == 1:
            rates[group] = None if values is None else channel.read(name)
        if not (values is None or isinstance(values, np.ndarray)):  # open the file again for them
            values = partial(_call, read_values, file, reader, name)
        channels[name] = attrs.evolve(channel, values=values)
    return {
        name: channel
        if channel.sampling_rate or math.prod(channel.shape) == 1
        else attrs.evolve(channel, sampling_rate=rates.get(_group(name), rates.get("")))
        for name, channel in channels.items()
    }


def read_values(file: Path, reader: str, wanted: str) -> Any:
    """Return the values of a channel that is read when it is needed."""
    return next(channel.read(name) for name, channel in _read(file, reader) if name == wanted)


def _read(file: Path, reader: str) -> Iterator[tuple[str, Channel]]:
    with explained(str(file)):  # here, because errors of libraries may not be pickled
        yield from resolve_name(f"{__package__}.{reader}")(file)


def _call(function: Callable[..., Result], file: Path, reader: str, *arguments: object) -> Result:
    """Call a function that reads a file, in another process if the reader's library may crash."""
    if reader.startswith(ISOLATED):
        return run_isolated(function, file, reader, *arguments)
    return function(file, reader, *arguments)


def _group(name: str) -> str:
    """Return the group or structure of a channel, with its last separator: ``run/`` or ``run.``."""
    return name[: max(name.rfind("/"), name.rfind(".")) + 1]


def _reader_of(file: Path) -> str:
    """Return the reader for a file as ``module:function``."""
    if not file.is_file():
        raise InputError("expected a file, got a folder" if file.is_dir() else "no such file")
    endings = [ending for ending in READERS if file.name.lower().endswith(ending)]
    if not endings:
        raise InputError(
            f"unknown ending {file.suffix!r}; files that can be read end in {', '.join(READERS)}"
        )
    if not file.stat().st_size:
        raise InputError("the file is empty")
    return READERS[max(endings, key=len)]
