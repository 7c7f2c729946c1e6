"""Parquet files: each column is a channel."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.recordings.channel import Channel, stated


def read_parquet(file: Path) -> dict[str, Channel]:
    """Columns of a Parquet file by name; each is read when it is asked for.

    Units are those in the metadata of a column, sampling rates those in its or the file's.
    """
    pyarrow = _pyarrow()
    with pyarrow.parquet.ParquetFile(file) as table:
        schema, rows = table.schema_arrow, table.metadata.num_rows
    return {item.name: _channel(pyarrow, file, item, schema.metadata, rows) for item in schema}


def _channel(pyarrow: Any, file: Path, item: Any, metadata: Any, rows: int) -> Channel:
    unit, rate = stated(_decoded(item.metadata), _decoded(metadata))
    kind = pyarrow.types
    if not (kind.is_integer(item.type) or kind.is_floating(item.type) or kind.is_boolean(item.type)):
        return Channel((rows,), f"values of type {item.type}", unit, rate)
    return Channel((rows,), str(np.dtype(item.type.to_pandas_dtype())), unit, rate, partial(_values, file, item.name))


def _values(file: Path, name: str) -> NDArray[Any]:
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
