"""Tables of columns: text with a header line, NumPy's NPZ, and Parquet."""

from __future__ import annotations

import warnings
import zipfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.recordings.channel import Channel, in_memory, stated, stored
from tvsysid.recordings.memory import check_fits

_PANDAS = tuple(int(part) for part in pd.__version__.split(".")[:2])
# Earlier pandas are off in the last digits unless told otherwise; from 3.1 on, the option is deprecated.
EXACTLY: dict[str, Any] = {"float_precision": "round_trip"} if _PANDAS < (3, 1) else {}


def read_text(file: Path, separator: str) -> dict[str, Channel]:
    """Columns of a text file by the names in its first line."""
    check_fits(str(file), 2 * file.stat().st_size)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # rows longer than the header
            table = pd.read_csv(
                file,
                sep=separator,
                skipinitialspace=True,
                encoding="utf-8-sig",
                index_col=False,
                low_memory=False,
                **EXACTLY,
            )
    except (pd.errors.ParserWarning, ValueError) as error:  # which the parser's errors and those of decoding are
        reason = str(error).strip().splitlines()[0]
        raise InputError(f"{file}: not a text table with a header line ({reason})") from error
    return {str(name).strip(): in_memory(table[name].to_numpy()) for name in table.columns}


def read_npz(file: Path) -> dict[str, Channel]:
    """Arrays of an NPZ file by name; each is read when it is asked for, and nothing is unpickled."""
    with zipfile.ZipFile(file) as archive:
        members = [name for name in archive.namelist() if name.endswith(".npy")]
        return {name.removesuffix(".npy"): _array(file, archive, name) for name in members}


def _array(file: Path, archive: zipfile.ZipFile, member: str) -> Channel:
    with archive.open(member) as stream:
        version = np.lib.format.read_magic(stream)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read_header(stream)
    if dtype.hasobject:
        return Channel(shape, "pickled objects, which are never read")
    return stored(shape, dtype, partial(_array_values, file, member))


def _array_values(file: Path, member: str) -> NDArray[Any]:
    with zipfile.ZipFile(file) as archive, archive.open(member) as stream:
        return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))


def read_parquet(file: Path) -> dict[str, Channel]:
    """Columns of a Parquet file by name; each is read when it is asked for.

    Units are those in the metadata of a column, sampling rates those in its or the file's.
    """
    pyarrow = _pyarrow()
    with pyarrow.parquet.ParquetFile(file) as table:
        schema, rows = table.schema_arrow, table.metadata.num_rows
    return {item.name: _column(pyarrow.types, file, item, schema.metadata, rows) for item in schema}


def _column(kind: Any, file: Path, item: Any, metadata: Any, rows: int) -> Channel:
    unit, rate = stated(_decoded(item.metadata), _decoded(metadata))
    if not (kind.is_integer(item.type) or kind.is_floating(item.type) or kind.is_boolean(item.type)):
        return Channel((rows,), f"values of type {item.type}", unit, rate)
    return stored((rows,), np.dtype(item.type.to_pandas_dtype()), partial(_column_values, file, item.name), unit, rate)


def _column_values(file: Path, name: str) -> NDArray[Any]:
    with _pyarrow().parquet.ParquetFile(file) as table:
        # What is missing becomes NaN.
        return np.asarray(table.read(columns=[name]).column(0).to_numpy())


def _decoded(metadata: Any) -> dict[str, str]:
    return {
        name.decode("utf-8", "replace"): value.decode("utf-8", "replace") for name, value in (metadata or {}).items()
    }


def _pyarrow() -> Any:
    try:
        import pyarrow.parquet  # noqa: PLC0415  # heavy
    except ImportError as error:
        raise InputError("Parquet files need pyarrow: pip install 'tvsysid[parquet]'") from error
    return pyarrow
