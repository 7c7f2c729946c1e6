"""Files of columns: text with a header line, NumPy's NPZ, Parquet, and the analog channels of C3D."""

from __future__ import annotations

import csv
import struct
import warnings
import zipfile
from collections import Counter
from collections.abc import Iterator
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.recordings.channel import MOST_CHANNELS, Channel, in_memory, stated, stated_rate, stated_unit, stored
from tvsysid.recordings.limits import claim

LONGEST_HEADER = 1_000_000  # letters of the first line of a text table
BIG_ENDIAN = 86  # processor that wrote a C3D file, as its parameter section tells: MIPS


def read_text(file: Path, separator: str) -> Iterator[tuple[str, Channel]]:
    """Columns of a text file by the names in its first line."""
    import pandas as pd  # noqa: PLC0415  # heavy

    _check_header(file, separator)
    size = file.stat().st_size
    claim(str(file), 2 * size, 24 * size)  # a value may take two letters, and eight bytes thrice
    settings: dict[str, Any] = {"sep": separator, "skipinitialspace": True, "encoding": "utf-8-sig"}
    if tuple(map(int, pd.__version__.split(".")[:2])) < (3, 1):
        # Off in the last digits otherwise; deprecated later on.
        settings["float_precision"] = "round_trip"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # rows longer than the header
            table = pd.read_csv(file, **settings, index_col=False, low_memory=False)
    except (pd.errors.ParserWarning, ValueError) as error:  # which the parser's errors and those of decoding are
        reason = str(error).strip().splitlines()[0]
        raise InputError(f"{file}: not a text table with a header line ({reason})") from error
    for name in table.columns:
        yield str(name).strip(), in_memory(table[name].to_numpy())


def _check_header(file: Path, separator: str) -> None:
    """Raise an InputError if two columns have one name, which pandas would change, or there are too many."""
    with file.open(encoding="utf-8-sig", errors="replace") as stream:
        header = next((line for _ in range(100) if (line := stream.readline(LONGEST_HEADER)).strip()), "")
    names = [name.strip() for row in csv.reader([header], delimiter=separator, skipinitialspace=True) for name in row]
    if len(header) == LONGEST_HEADER or len(names) > MOST_CHANNELS:
        raise InputError(
            f"{file}: the first line has {len(names)} columns or more; expected names of {MOST_CHANNELS} at most: give "
            "each signal a column, and each sample a line"
        )
    if repeated := [name for name, count in Counter(names).items() if count > 1 and name]:
        raise InputError(f"{file}: several columns are called {repeated[0]!r}; give each a name of its own")


def read_npz(file: Path) -> Iterator[tuple[str, Channel]]:
    """Arrays of an NPZ file by name; each is read when it is asked for, and nothing is unpickled."""

    def values(member: str) -> NDArray[Any]:
        with zipfile.ZipFile(file) as archive, archive.open(member) as stream:
            return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))

    with zipfile.ZipFile(file) as archive:
        for member in archive.namelist():
            if member.endswith(".npy"):
                with archive.open(member) as stream:
                    shape, dtype = _npy_header(stream)
                pickled = Channel(shape, "pickled objects, which are never read")
                channel = pickled if dtype.hasobject else stored(shape, dtype, partial(values, member))
                yield member.removesuffix(".npy"), channel


def _npy_header(stream: Any) -> tuple[tuple[int, ...], np.dtype[Any]]:
    version = np.lib.format.read_magic(stream)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read_header(stream)
    return shape, dtype


def read_parquet(file: Path) -> Iterator[tuple[str, Channel]]:
    """Columns of a Parquet file by name; each is read when it is asked for.

    Units are those in the metadata of a column, sampling rates those in its or the file's.
    """
    parquet, kind = (_optional(f"pyarrow.{part}", "Parquet", "parquet") for part in ("parquet", "types"))

    def values(name: str) -> NDArray[Any]:
        with parquet.ParquetFile(file) as table:
            # What is missing becomes NaN.
            return np.asarray(table.read(columns=[name], use_threads=False).column(0).to_numpy())

    with parquet.ParquetFile(file) as table:
        schema, shape = table.schema_arrow, (table.metadata.num_rows,)
    for item in schema:
        unit, rate = stated(_decoded(item.metadata), _decoded(schema.metadata))
        if kind.is_integer(item.type) or kind.is_floating(item.type) or kind.is_boolean(item.type):
            dtype = np.dtype(item.type.to_pandas_dtype())
            yield item.name, stored(shape, dtype, partial(values, item.name), unit, rate)
        else:
            yield item.name, Channel(shape, f"values of type {item.type}", unit, rate)


def _decoded(metadata: dict[bytes, bytes] | None) -> dict[str, str]:
    return {str(key, "utf-8", "replace"): str(value, "utf-8", "replace") for key, value in (metadata or {}).items()}


def _optional(module: str, files: str, extra: str) -> Any:
    """A module of a library that is installed only by those who need it."""
    try:
        return import_module(module)
    except ImportError as error:
        library = module.partition(".")[0]
        raise InputError(f"{files} files need {library}: pip install 'tvsysid[{extra}]'") from error


def read_c3d(file: Path) -> Iterator[tuple[str, Channel]]:
    """Analog channels of a C3D file of a motion laboratory by label, with the units and the rate that it states.

    Labels that several channels share are followed by the channel's number: ``Voltage (3)``.
    """
    ezc3d = _optional("ezc3d", "C3D", "c3d")
    size = file.stat().st_size
    claim(str(file), 4 * size, 40 * size)
    expected = _expected_size(file)
    if size < expected:
        raise InputError(f"{file}: the C3D file ends after {size} of {expected} bytes; copy it again")
    content = ezc3d.c3d(str(file))
    values = np.concatenate(list(content["data"]["analogs"]), axis=-1)
    parameters = content["parameters"].get("ANALOG", {})
    labels, units = _texts(parameters, "LABELS"), _texts(parameters, "UNITS")
    repeated = {label for label, count in Counter(labels).items() if count > 1}
    rate = stated_rate(content["header"]["analogs"]["frame_rate"])
    for number, samples in enumerate(values):
        label = labels[number] if number < len(labels) else ""
        name = f"{label} ({number + 1})".lstrip() if label in repeated or not label else label
        yield name, in_memory(samples, stated_unit(units[number]) if number < len(units) else "", rate)


def _texts(parameters: Any, name: str) -> list[str]:
    """Texts of a parameter and of its continuations, which have a number behind the name."""
    parts = (name, *(f"{name}{number}" for number in range(2, 10)))
    return [str(text).strip() for part in parts if part in parameters for text in parameters[part]["value"]]


def _expected_size(file: Path) -> int:
    """Bytes that the header promises at least: a file that was cut short is otherwise read in part without a word."""
    with file.open("rb") as stream:
        head = stream.read(512)
        stream.seek(512 * (head[0] - 1) + 3)
        order = ">" if stream.read(1) == bytes([BIG_ENDIAN]) else "<"
    _, points, analogs, first, last, _, scale, start = struct.unpack(f"{order}HHHHHHfH", head[:18])
    width = 4 if scale < 0 else 2
    return int(512 * (start - 1) + max(last - first + 1, 0) * (4 * points + analogs) * width)
