"""Which channels a file holds, whatever its format."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from tvsysid.errors import InputError
from tvsysid.recordings.c3d import read_c3d
from tvsysid.recordings.channel import Channel, with_rates
from tvsysid.recordings.hdf5 import read_hdf5
from tvsysid.recordings.mat import read_mat
from tvsysid.recordings.netcdf import read_netcdf
from tvsysid.recordings.npz import read_npz
from tvsysid.recordings.parquet import read_parquet
from tvsysid.recordings.signatures import seems
from tvsysid.recordings.text import read_csv, read_tsv


@dataclass(frozen=True)
class Format:
    """A format of files: what it is called, what its first bytes may say, and what reads it."""

    name: str
    contents: tuple[str, ...]
    read: Callable[[Path], dict[str, Channel]]


FORMATS = {
    # Of version 4 the first bytes say nothing.
    ".mat": Format("MAT file", ("MAT file of version 5 or 7", "MAT file of version 7.3", ""), read_mat),
    # Text in an old encoding is not told from noise by its first bytes.
    ".csv": Format("text table with a header line", ("text", ""), read_csv),
    ".tsv": Format("text table with a header line", ("text", ""), read_tsv),
    ".npz": Format("NPZ file", ("ZIP archive",), read_npz),
    ".h5": Format("HDF5 file", ("HDF5 file",), read_hdf5),
    ".hdf5": Format("HDF5 file", ("HDF5 file",), read_hdf5),
    ".nc": Format("NetCDF file", ("NetCDF file", "HDF5 file"), read_netcdf),
    ".parquet": Format("Parquet file", ("Parquet file",), read_parquet),
    ".c3d": Format("C3D file", ("C3D file",), read_c3d),
}
"""By ending."""
RENAMED = {".mat": ("MAT file of version 5 or 7", "MAT file of version 7.3"), ".npz": ()}
"""What is told to be renamed to an ending, where that is not the first of its format's contents."""


def describe_file(path: str | Path) -> dict[str, Channel]:
    """Channels that a file holds, each with shape, type, and unit and sampling rate where the file states them.

    Parameters
    ----------
    path
        File of any format that :func:`tvsysid.read_recording` reads.

    Returns
    -------
    dict
        :class:`Channel` by name, in the file's order. Values are read when asked for: ``channel.read(name)``.

    Raises
    ------
    InputError
        If the file cannot be read, or is not what its ending says.
    """
    file = Path(path)
    if not file.exists():
        raise InputError(f"{file}: no such file")
    if not file.is_file():
        raise InputError(f"{file}: expected a file, this is a folder")
    kind = FORMATS.get(file.suffix.lower())
    if kind is None:
        raise InputError(f"{file}: unknown ending {file.suffix!r}; files that can be read end in {', '.join(FORMATS)}")
    if file.stat().st_size == 0:
        raise InputError(f"{file}: the file is empty")
    with _told(file, kind):
        content = seems(file)
        if content not in kind.contents:
            raise InputError(f"{file}: not a {kind.name} that can be read: {_advice(content)}")
        channels = kind.read(file)
        return {name: _told_when_read(channel, file, kind) for name, channel in with_rates(channels).items()}


def _advice(content: str) -> str:
    """What a file seems to be instead, and what to do about it."""
    if not content:
        return "its first bytes are those of no format known here"
    what = content if content == "text" else f"{'an' if content[0] in 'EH' else 'a'} {content}"
    endings = [ending for ending, kind in FORMATS.items() if content in RENAMED.get(ending, kind.contents[:1])]
    todo = f"give it the ending {' or '.join(endings)}" if endings else "save it in another format"
    return f"by its content it is {what}; {todo}"


def _told_when_read(channel: Channel, file: Path, kind: Format) -> Channel:
    if channel.values is None:
        return channel
    read = channel.values

    def values():  # type: ignore[no-untyped-def]
        with _told(file, kind):
            return read()

    return replace(channel, values=values)


@contextmanager
def _told(file: Path, kind: Format) -> Iterator[None]:
    """Whatever the libraries that read formats raise becomes an InputError that names the file."""
    try:
        yield
    except InputError:
        raise
    except (PermissionError, BlockingIOError) as error:
        reason = error.strerror or error
        raise InputError(
            f"{file}: cannot be opened ({reason}); close it in other programs, or mend its rights"
        ) from error
    except MemoryError as error:
        size = file.stat().st_size / 1e9
        raise InputError(
            f"{file}: there is not enough memory for this file of {size:.3g} GB, or it is damaged; save the part that "
            "is needed to a file of its own"
        ) from error
    except zlib.error as error:
        raise InputError(f"{file}: the {kind.name} is damaged ({error}); copy it again") from error
    except Exception as error:  # each library has errors of its own, and damaged files bring forth all others
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise InputError(
            f"{file}: not a {kind.name} that can be read ({reason}); is it whole? Copy it again"
        ) from error
