"""NumPy's NPZ files; nothing in them is unpickled."""

from __future__ import annotations

import zipfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tvsysid.recordings.channel import NUMBERS, Channel, kind_of


def read_npz(file: Path) -> dict[str, Channel]:
    """Arrays of an NPZ file by name; each is read when it is asked for."""
    with zipfile.ZipFile(file) as archive:
        members = [name for name in archive.namelist() if name.endswith(".npy")]
        return {name.removesuffix(".npy"): _channel(file, archive, name) for name in members}


def _channel(file: Path, archive: zipfile.ZipFile, member: str) -> Channel:
    with archive.open(member) as stream:
        version = np.lib.format.read_magic(stream)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read_header(stream)
    if dtype.kind not in NUMBERS:
        return Channel(shape, "pickled objects, which are never read" if dtype.hasobject else kind_of(dtype))
    return Channel(shape, str(dtype), values=partial(_values, file, member))


def _values(file: Path, member: str) -> NDArray[Any]:
    with zipfile.ZipFile(file) as archive, archive.open(member) as stream:
        return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))
