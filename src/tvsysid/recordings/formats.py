"""Which format a file has, and which channels it holds."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import attrs

from tvsysid.errors import InputError
from tvsysid.recordings.channel import RATE_NAMES, Channel, explained
from tvsysid.recordings.worker import Result, run_isolated

READERS = {
    ".mat": "mat:read_mat_5",
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


def describe_file(path: str | Path, header: bool = True) -> dict[str, Channel]:
    """Return the channels of a file by name, in the file's order.

    Parameters
    ----------
    path
        File of any format that :func:`tvsysid.read_recording` reads.
    header
        Whether the first line of a text table has names; if not, columns are called 1, 2, ...

    Raises
    ------
    InputError
        If the file cannot be read, or is not what its ending says.
    """
    file = Path(path).absolute()
    with explained(str(path)):
        reader = _reader_of(file)
        if header:
            return _call(file, reader, 0, read_channels)
        if reader == READERS[".csv"]:
            return dict(resolve_name(f"{__package__}.{reader}")(file, header=False))
        raise InputError(
            f"--no-header (header=False) is for text tables; leave it out for a {file.suffix} file"
        )


def read_channels(file: Path, reader: str) -> dict[str, Channel]:
    """Return the channels of a file by name, with the rates that variables beside them state."""
    channels: dict[str, Channel] = {}
    rates: dict[str, object] = {}
    for name, channel in resolve_name(f"{__package__}.{reader}")(file):
        if name in channels:
            raise InputError(f"two channels are called {name!r}; give each a name of its own")
        place = _place(name)
        if (
            name.removeprefix(place).lower() in RATE_NAMES
            and channel.values is not None
            and channel.size == 8
        ):
            rates[place] = channel.read(name)  # while the file is open
        later = partial(_call, file, reader, channel.size, read_values, name)
        is_in_memory = not callable(channel.values)
        channels[name] = channel if is_in_memory else attrs.evolve(channel, values=later)
    for name, channel in channels.items():
        rate = rates.get(_place(name), rates.get(""))
        if channel.sampling_rate is None and channel.size > 8:
            channels[name] = attrs.evolve(channel, sampling_rate=rate)
    return channels


def read_values(file: Path, reader: str, wanted: str) -> Any:
    """Return the values of a channel that is read when it is needed."""
    for name, channel in resolve_name(f"{__package__}.{reader}")(file):
        if name == wanted:
            return channel.read(name)
    raise InputError("the file has changed; read it again")


def _call(
    file: Path, reader: str, size: int, function: Callable[..., Result], *arguments: object
) -> Result:
    """Call a function that reads a file, in another process if the reader's library may crash."""
    if not reader.startswith(ISOLATED):
        return function(file, reader, *arguments)
    return run_isolated(file.stat().st_size + size, function, file, reader, *arguments)


def _place(name: str) -> str:
    """Return the group or structure that a channel is in, with the sign that ends it."""
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
    with file.open("rb") as stream:
        head = stream.read(1024)
    if not head:
        raise InputError("the file is empty")
    # MATLAB writes HDF5 below a header of its own.
    is_mat_73 = endings == [".mat"] and b"\x89HDF\r\n" in head
    return "hdf5:read_mat_73" if is_mat_73 else READERS[max(endings, key=len)]
