"""Which channels a file holds, whatever its format: one table of endings, first bytes and readers."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tvsysid.errors import InputError
from tvsysid.recordings.bids import read_motion
from tvsysid.recordings.channel import MOST_CHANNELS, Channel, with_rates
from tvsysid.recordings.hdf5 import contents_of_netcdf, read_hdf5, read_netcdf, read_netcdf_3
from tvsysid.recordings.limits import SMALLER
from tvsysid.recordings.mat import contents_of_mat_5, read_mat_5, read_mat_73
from tvsysid.recordings.nwb import read_nwb
from tvsysid.recordings.optional import read_c3d, read_edf, read_parquet
from tvsysid.recordings.tables import read_npz, read_text

MAT_5, MAT_73 = "MAT file of version 5 or 7", "MAT file of version 7.3"
HDF5, NETCDF, PARQUET, ZIP, C3D, TEXT = (
    "HDF5 file",
    "NetCDF file",
    "Parquet file",
    "ZIP archive",
    "C3D file",
    "text",
)
EDF, BDF, TABLE = "EDF file", "BDF file", "text table with a header line"
PICKLE = "Python pickle, which is never read"
HDF5_BYTES = b"\x89HDF\r\n\x1a\n"
# Contents by the bytes that such files begin with; a MAT file of version 4 begins with nothing of
# its own.
SIGNATURES = {
    b"MATLAB 5.0 MAT-file": MAT_5,
    b"MATLAB 7.3 MAT-file": MAT_73,
    HDF5_BYTES: HDF5,
    **dict.fromkeys((b"CDF\x01", b"CDF\x02", b"CDF\x05"), NETCDF),
    b"PAR1": PARQUET,
    b"0       ": EDF,
    b"\xffBIOSEMI": BDF,
    b"PK\x03\x04": ZIP,
    b"\x93NUMPY": "single NumPy array",
    b"\xd0\xcf\x11\xe0": "old Excel or Word file",
    b"\x1f\x8b": "gzip archive",
    b"%PDF": "PDF",
    **dict.fromkeys((b"\x80\x03", b"\x80\x04", b"\x80\x05"), PICKLE),
}
HEAD = 2048
NO_MEMORY = (
    "bad_alloc",
    "malloc of size",
    "memory allocation failed",
    "Unable to allocate",
)  # in libraries' words
Reader = Callable[
    ..., Iterator[tuple[str, Channel]]
]  # of a path; those of text tables also of whether names are first


class Format(NamedTuple):
    """A format of files."""

    name: str
    readers: Mapping[str, Reader]  # by what the first bytes may say
    shared: tuple[
        str, ...
    ] = ()  # of these, those of formats as well that are not read by this ending


FORMATS = {
    # Of version 4 the first bytes say nothing, and text in an old encoding is not told from noise
    # by them.
    ".mat": Format("MAT file", {MAT_5: read_mat_5, MAT_73: read_mat_73, "": read_mat_5}),
    ".csv": Format(TABLE, dict.fromkeys((TEXT, ""), partial(read_text, separator=","))),
    ".tsv": Format(TABLE, dict.fromkeys((TEXT, ""), partial(read_text, separator="\t"))),
    "_motion.tsv": Format("Motion-BIDS table", {TEXT: read_motion}, (TEXT,)),
    ".npz": Format("NPZ file", {ZIP: read_npz}, (ZIP,)),
    ".h5": Format(HDF5, {HDF5: read_hdf5}),
    ".hdf5": Format(HDF5, {HDF5: read_hdf5}),
    ".nc": Format(NETCDF, {NETCDF: read_netcdf_3, HDF5: read_netcdf}, (HDF5,)),
    ".nwb": Format("NWB file", {HDF5: read_nwb}, (HDF5,)),
    ".parquet": Format(PARQUET, {PARQUET: read_parquet}),
    ".c3d": Format(C3D, {C3D: read_c3d}),
    ".edf": Format(EDF, {EDF: read_edf}),
    ".bdf": Format(BDF, {BDF: read_edf}),
}


def format_of(file: Path) -> Format | None:
    """Format that a file's name says it has, by the longest ending that is known."""
    endings = [ending for ending in FORMATS if file.name.lower().endswith(ending)]
    return FORMATS[max(endings, key=len)] if endings else None


def channels_of(file: Path, header: bool = True) -> dict[str, Channel]:
    """Channels that a file holds, in this process.

    Elsewhere, files are read by :func:`.process.describe_file`.
    """
    if not file.exists():
        raise InputError(f"{file}: no such file")
    if not file.is_file():
        raise InputError(
            f"{file}: expected a file, this is {'a folder' if file.is_dir() else 'none'}"
        )
    kind = format_of(file)
    if kind is None:
        raise InputError(
            f"{file}: unknown ending {file.suffix!r}; files that can be read end in "
            f"{', '.join(FORMATS)}"
        )
    if not header and kind.name != TABLE:
        raise InputError(
            f"{file}: --no-header (header=False) is for text tables; leave it out for a {kind.name}"
        )
    if file.stat().st_size == 0:
        raise InputError(f"{file}: the file is empty")
    with explained(file):
        content = content_of(file)
        if content not in kind.readers:
            raise InputError(f"{file}: not a {kind.name} that can be read: {_advice(content)}")
        reader = kind.readers[content] if header else partial(kind.readers[content], header=False)
        return with_rates(_unique(file, reader(file)))


def _unique(file: Path, channels: Iterator[tuple[str, Channel]]) -> dict[str, Channel]:
    """Channels by name; an InputError if two have the same one, or there are too many."""
    found: dict[str, Channel] = {}
    for name, channel in channels:
        if name in found:
            raise InputError(
                f"{file}: two channels are called {name!r}; give each a name of its own"
            )
        found[name] = channel
        if len(found) > MOST_CHANNELS:
            raise InputError(f"{file}: it holds more than {MOST_CHANNELS} channels; {SMALLER}")
    return found


def contents_of(file: Path) -> dict[str, object]:
    """Variables and attributes of a file that this package wrote, single values as such."""
    channels_of(file)  # whether it can be read at all, and is what its ending says
    if file.suffix.lower() == ".mat":
        found = contents_of_mat_5(file) if content_of(file) == MAT_5 else {}
    else:
        found = contents_of_netcdf(file)
    return {
        name: str(item) if np.asarray(item).dtype.kind in "UO" else item
        for name, item in found.items()
    }


def content_of(file: Path) -> str:
    """What a file's first bytes say that it is, whatever it is called.

    Empty if they say nothing.
    """
    with file.open("rb") as stream:
        head = stream.read(HEAD)
    # MATLAB writes objects of version 7.3 below a header of its own, which some programs leave
    # empty.
    if head[512:].startswith(HDF5_BYTES):
        return MAT_73
    for signature, content in SIGNATURES.items():
        if head.startswith(signature):
            return (
                "Excel or Word file"
                if content == ZIP and b"[Content_Types].xml" in head
                else content
            )
    if len(head) >= 512 and head[1] == 0x50 and 2 <= head[0] < 32:
        return C3D
    return TEXT if _is_text(head) else ""


def _is_text(head: bytes) -> bool:
    try:
        words = head.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if error.start < len(head) - 4:  # a letter cut in two at the end is none the less text
            return False
        words = head[: error.start].decode("utf-8-sig")
    return all(letter.isprintable() or letter in "\r\n\t" for letter in words)


def _advice(content: str) -> str:
    """What a file seems to be instead, and what to do about it."""
    if not content:
        return "its first bytes are those of no format known here"
    what = content if content == TEXT else f"{'an' if content[0] in 'EH' else 'a'} {content}"
    endings = [
        ending
        for ending, kind in FORMATS.items()
        if content in kind.readers and content not in kind.shared
    ]
    todo = f"give it the ending {' or '.join(endings)}" if endings else "save it in another format"
    return f"by its content it is {what}; {todo}"


def _too_much(file: Path) -> str:
    return (
        f"{file}: reading this file of {file.stat().st_size / 1e6:.3g} MB takes more memory than "
        "there is, or than "
        f"what it holds accounts for; if it is whole, {SMALLER}, else copy it again"
    )


@contextmanager
def explained(file: Path) -> Iterator[None]:
    """Whatever the libraries that read formats raise becomes an InputError that names the file."""
    kind = format_of(file)
    name = kind.name if kind else "file"
    try:
        yield
    except InputError:
        raise
    except (PermissionError, BlockingIOError) as error:
        reason = (
            f"cannot be opened ({error.strerror or error}); close it in other programs, or "
            "change its permissions"
        )
        raise InputError(f"{file}: {reason}") from error
    except MemoryError as error:
        raise InputError(_too_much(file)) from error
    except zlib.error as error:
        raise InputError(f"{file}: the {name} is damaged ({error}); copy it again") from error
    except (
        Exception
    ) as error:  # each library has errors of its own, and damaged files bring forth all others
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0]
        if any(words in reason for words in NO_MEMORY):
            raise InputError(_too_much(file)) from error
        raise InputError(
            f"{file}: not a {name} that can be read ({reason}); is it whole? Copy it again"
        ) from error
