"""Which format a file has, and which channels it holds."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import attrs

from tvsysid.errors import InputError
from tvsysid.recordings.channel import (
    RATE_NAMES,
    SAVE_PART,
    Channel,
    explained,
    stated_rate,
)
from tvsysid.recordings.worker import run_isolated

MAX_CHANNELS = 10_000  # of a file
HEAD_BYTES = 2048
HDF5_BYTES = b"\x89HDF\r\n\x1a\n"
MAT_73 = "MAT file of version 7.3"
PICKLE = "Python pickle, which is never read"
# Contents by the bytes that files begin with. A MAT file of version 4 begins with none of its own.
SIGNATURES = {
    b"MATLAB 5.0 MAT-file": "MAT file of version 5 or 7",
    b"MATLAB 7.3 MAT-file": MAT_73,
    HDF5_BYTES: "HDF5 file",
    b"CDF\x01": "NetCDF file",
    b"CDF\x02": "NetCDF file",
    b"CDF\x05": "NetCDF file",
    b"PAR1": "Parquet file",
    b"0       ": "EDF file",
    b"\xffBIOSEMI": "BDF file",
    b"PK\x03\x04": "ZIP archive",
    b"\x80\x03": PICKLE,
    b"\x80\x04": PICKLE,
    b"\x80\x05": PICKLE,
}
# Readers by the ending of the name and the content, "" where the first bytes say nothing.
MAT_READERS = {
    "MAT file of version 5 or 7": "mat:read_mat_5",
    MAT_73: "mat:read_mat_73",
    "": "mat:read_mat_5",
}
TEXT_READERS = {"text": "tables:read_text", "": "tables:read_text"}  # "" for old encodings
READERS = {
    ".mat": MAT_READERS,
    ".csv": TEXT_READERS,
    ".tsv": TEXT_READERS,
    "_motion.tsv": {"text": "tables:read_motion"},
    ".npz": {"ZIP archive": "tables:read_npz"},
    ".h5": {"HDF5 file": "hdf5:read_hdf5"},
    ".hdf5": {"HDF5 file": "hdf5:read_hdf5"},
    ".nc": {"NetCDF file": "netcdf:read_netcdf", "HDF5 file": "netcdf:read_netcdf"},
    ".nwb": {"HDF5 file": "nwb:read_nwb"},
    ".parquet": {"Parquet file": "tables:read_parquet"},
    ".c3d": {"C3D file": "c3d:read_c3d"},
    ".edf": {"EDF file": "edf:read_edf"},
    ".bdf": {"BDF file": "edf:read_edf"},
}
ISOLATED = (
    "mat",
    "hdf5",
    "netcdf",
    "nwb",
    "c3d",
)  # modules whose libraries crash or hang on damaged files


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
    file = Path(path)
    with explained(str(file)):
        reader = _reader_of(file)
        if not header and not reader.endswith("read_text"):
            raise InputError(
                "--no-header (header=False) is for text tables; leave it out for a "
                f"{file.suffix} file"
            )
        settings = {} if header else {"header": False}
        if not reader.startswith(ISOLATED):
            return read_channels(file, reader, **settings)
        channels = run_isolated(file, 0, read_channels, file, reader)
    return {
        name: attrs.evolve(
            channel, values=partial(run_isolated, file, channel.size, channel.values)
        )
        if callable(channel.values)
        else channel
        for name, channel in channels.items()
    }


def read_channels(file: Path, reader: str, **settings: Any) -> dict[str, Channel]:
    """Return the channels of a file by name, with the rates that variables beside them state."""
    read = resolve_name(f"tvsysid.recordings.{reader}")
    return _with_rates(_unique(read(file, **settings)))


def read_contents(file: Path) -> dict[str, Any]:
    """Return variables and attributes of a file that this package wrote."""
    with explained(str(file)):
        module = _reader_of(file).partition(":")[0]
        contents = resolve_name(f"tvsysid.recordings.{module}:read_contents")
        found: dict[str, Any] = run_isolated(file, 0, contents, file)
    return found


def content_of(file: Path) -> str:
    """Return what a file's first bytes say that it is; empty if they say nothing."""
    with file.open("rb") as stream:
        head = stream.read(HEAD_BYTES)
    if head[512:].startswith(HDF5_BYTES):  # below a header of MATLAB, which may be empty
        return MAT_73
    for signature, content in SIGNATURES.items():
        if head.startswith(signature):
            return content
    if len(head) >= 512 and head[1] == 0x50 and 2 <= head[0] < 32:
        return "C3D file"
    # A letter that is cut in two at the end is no reason against text.
    text = head[: len(head) - 3].decode("utf-8-sig", "replace")
    is_text = all(each.isprintable() or each in "\r\n\t" for each in text) and "\ufffd" not in text
    return "text" if is_text else ""


def _reader_of(file: Path) -> str:
    """Return the reader for a file as ``module:function``."""
    if not file.exists():
        raise InputError("no such file")
    if not file.is_file():
        raise InputError(f"expected a file, this is {'a folder' if file.is_dir() else 'none'}")
    endings = [ending for ending in READERS if file.name.lower().endswith(ending)]
    if not endings:
        raise InputError(
            f"unknown ending {file.suffix!r}; files that can be read end in {', '.join(READERS)}"
        )
    if file.stat().st_size == 0:
        raise InputError("the file is empty")
    ending, content = max(endings, key=len), content_of(file)
    if content in READERS[ending]:
        return READERS[ending][content]
    others = [other for other, readers in READERS.items() if content in readers]
    if not content:
        advice = "its first bytes are those of no format known here"
    else:
        todo = f"give it the ending {' or '.join(others)}" if others else "save it otherwise"
        article = "" if content == "text" else "an " if content[0] in "EH" else "a "
        advice = f"by its content it is {article}{content}; {todo}"
    raise InputError(f"not a {ending} file that can be read: {advice}")


def _unique(channels: Iterable[tuple[str, Channel]]) -> dict[str, Channel]:
    found: dict[str, Channel] = {}
    for name, channel in channels:
        if name in found:
            raise InputError(f"two channels are called {name!r}; give each a name of its own")
        found[name] = channel
        if len(found) > MAX_CHANNELS:
            raise InputError(f"it holds more than {MAX_CHANNELS} channels; {SAVE_PART}")
    return found


def _with_rates(channels: Mapping[str, Channel]) -> dict[str, Channel]:
    """Add the rate that a variable such as ``sampling_rate`` beside channels, or above, states."""
    rates = {}
    for name, channel in channels.items():
        place, own = _split(name)
        if own.lower() in RATE_NAMES and channel.values is not None and channel.size == 8:
            rates[place] = stated_rate(channel.read(name))
    return {
        name: channel
        if channel.sampling_rate is not None or math.prod(channel.shape) <= 1
        else attrs.evolve(channel, sampling_rate=rates.get(_split(name)[0], rates.get("")))
        for name, channel in channels.items()
    }


def _split(name: str) -> tuple[str, str]:
    """Return the group or structure that a channel is in, and its own name."""
    cut = max(name.rfind("/"), name.rfind(".")) + 1
    return name[:cut], name[cut:]
