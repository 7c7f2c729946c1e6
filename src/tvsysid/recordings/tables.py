"""Files of columns: text, Motion-BIDS, NumPy's NPZ and Parquet."""

from __future__ import annotations

import csv
import json
import warnings
import zipfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.recordings.channel import (
    UNEVEN,
    Channel,
    even_rate,
    in_memory,
    numeric,
    optional_library,
    stated,
    stated_rate,
    stated_unit,
)

MAX_COLUMNS = 10_000
MAX_LINE_LENGTH = 1_000_000  # characters of the first line
MISSING = ("", "n/a", "N/A", "NA")  # cells of a line of numbers
BIDS_FOLDERS = 4  # data set, participant, session, kind of data: all may hold descriptions


def read_text(file: Path, header: bool = True) -> Iterator[tuple[str, Channel]]:
    """Read columns by the names in the first line, or by number: 1, 2, ..."""
    separator = "," if file.suffix.lower() == ".csv" else "\t"
    first = _first_row(file, separator)
    if header and _are_numbers(first):
        raise InputError(
            "the first line is all numbers, and would be lost as names; if the file has no names, "
            "say --no-header (header=False in Python) and call its columns 1, 2, ...; if these are "
            "names, make them words"
        )
    if not header and not _are_numbers(first):
        raise InputError(
            f"the first line has names, such as {first[:1]}; read it without --no-header"
        )
    for number, values in enumerate(_columns(file, separator, len(first), header), start=1):
        name = first[number - 1] or f"Unnamed: {number}" if header else str(number)
        yield name, in_memory(values)


def _columns(file: Path, separator: str, count: int, header: bool) -> list[NDArray[Any]]:
    """Return the values of so many columns."""
    import pandas as pd  # noqa: PLC0415  # heavy

    is_exact = tuple(map(int, pd.__version__.split(".")[:2])) >= (3, 1)
    precision: dict[str, Any] = {} if is_exact else {"float_precision": "round_trip"}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # rows longer than the first
            table = pd.read_csv(
                file,
                sep=separator,
                header=0 if header else None,
                names=range(count),
                index_col=False,
                skipinitialspace=True,
                encoding="utf-8-sig",
                low_memory=False,
                **precision,
            )
    except (pd.errors.ParserWarning, ValueError) as error:
        what = "with a header line" if header else f"of {count} columns of numbers"
        raise InputError(
            f"not a text table {what} ({str(error).strip().splitlines()[0]})"
        ) from error
    return [table[number].to_numpy() for number in table.columns]


def _first_row(file: Path, separator: str) -> list[str]:
    """Return the cells of the first line that is not empty."""
    with file.open(encoding="utf-8-sig", errors="replace") as stream:
        lines = (stream.readline(MAX_LINE_LENGTH) for _ in range(100))
        line = next((line for line in lines if line.strip()), "")
    rows = csv.reader([line], delimiter=separator, skipinitialspace=True)
    cells = [cell.strip() for row in rows for cell in row]
    if len(line) == MAX_LINE_LENGTH or len(cells) > MAX_COLUMNS:
        raise InputError(
            f"the first line has {len(cells)} columns or more; expected {MAX_COLUMNS} at most: "
            "give each signal a column, and each sample a line"
        )
    return cells


def _are_numbers(cells: list[str]) -> bool:
    """Whether all cells that are not empty are numbers."""
    try:
        return bool([float(cell) for cell in cells if cell not in MISSING])
    except ValueError:
        return False


def read_motion(file: Path) -> Iterator[tuple[str, Channel]]:
    """Read channels of ``sub-1_task-a_motion.tsv`` by their names in ``sub-1_task-a_channels.tsv``.

    Units are those of that file. The rate is the ``SamplingFrequency`` of ``…_motion.json``, or
    that of the times in a channel of type LATENCY. Both files may also be in folders above, with
    fewer words in their names.
    """
    first, rows = _first_row(file, "\t"), _motion_channels(file)
    if not _are_numbers(first):
        raise InputError(
            "expected numbers in the first line, as Motion-BIDS has no names there; got "
            f"{first[:3]}"
        )
    if len(first) != len(rows):
        raise InputError(
            f"it has {len(first)} columns, and its _channels.tsv describes {len(rows)}"
        )
    columns = _columns(file, "\t", len(first), header=False)
    kinds = [row["type"].upper() for row in rows]
    times = columns[kinds.index("LATENCY")] if "LATENCY" in kinds else None
    rate = _sampling_frequency(file) if times is None else even_rate(times)
    for row, values in zip(rows, columns, strict=True):
        unit = stated_unit(row.get("units") or "").removeprefix("n/a")
        is_uneven = times is not None and rate is None
        channel = (
            Channel(values.shape, UNEVEN, unit) if is_uneven else in_memory(values, unit, rate)
        )
        yield row["name"], channel


def _motion_channels(file: Path) -> list[dict[str, str]]:
    """Return a row for each column of a Motion-BIDS table."""
    for description in _described_by(file, "_channels.tsv"):
        lines = description.read_text(encoding="utf-8-sig").splitlines()
        rows = list(csv.DictReader(lines, delimiter="\t"))
        if not rows or not all(row.get("name") and row.get("type") for row in rows):
            raise InputError(
                f"{description.name} lacks rows with name and type; they name the columns"
            )
        return rows
    raise InputError(
        f"no {file.name.removesuffix('_motion.tsv')}_channels.tsv beside it, which names its "
        "columns; put it there, or give the file another name if its first line has names"
    )


def _sampling_frequency(file: Path) -> float | None:
    for description in _described_by(file, "_motion.json"):
        content = json.loads(description.read_text(encoding="utf-8-sig"))
        if isinstance(content, dict) and "SamplingFrequency" in content:
            return stated_rate(content["SamplingFrequency"])
    return None


def _described_by(file: Path, ending: str) -> Iterator[Path]:
    """Yield files that describe a recording, the nearest first: their words are all in its name."""
    words = set(file.name.split("_")[:-1])
    for folder in file.absolute().parents[:BIDS_FOLDERS]:
        found = {
            item: item.name.removesuffix(ending).split("_") for item in folder.glob(f"*{ending}")
        }
        fitting = [item for item, own in found.items() if words.issuperset(own)]
        yield from sorted(fitting, key=lambda item: -len(found[item]))


def read_npz(file: Path) -> Iterator[tuple[str, Channel]]:
    """Read arrays by name. Nothing is unpickled."""

    def values(member: str) -> NDArray[Any]:
        with zipfile.ZipFile(file) as archive, archive.open(member) as stream:
            return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))

    with zipfile.ZipFile(file) as archive:
        for member in archive.namelist():
            if not member.endswith(".npy"):
                continue
            with archive.open(member) as stream:
                is_first = np.lib.format.read_magic(stream) == (1, 0)
                shape, _, dtype = (
                    np.lib.format.read_array_header_1_0(stream)
                    if is_first
                    else np.lib.format.read_array_header_2_0(stream)
                )
            channel = numeric(shape, dtype, partial(values, member))
            if dtype.hasobject:
                channel = Channel(shape, "pickled objects, which are never read")
            yield member.removesuffix(".npy"), channel


def read_parquet(file: Path) -> Iterator[tuple[str, Channel]]:
    """Read columns by name, with the units and rates that their metadata state."""
    parquet = optional_library("pyarrow.parquet", "parquet")
    types = optional_library("pyarrow.types", "parquet")

    def values(name: str) -> NDArray[Any]:
        with parquet.ParquetFile(file) as table:
            return np.asarray(table.read(columns=[name], use_threads=False).column(0).to_numpy())

    def texts(metadata: dict[bytes, bytes] | None) -> dict[str, object]:
        return {
            key.decode(errors="replace"): value.decode(errors="replace")
            for key, value in (metadata or {}).items()
        }

    with parquet.ParquetFile(file) as table:
        schema, shape = table.schema_arrow, (table.metadata.num_rows,)
    for item in schema:
        unit, rate = stated(texts(item.metadata), texts(schema.metadata))
        kind = item.type
        if types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind):
            dtype = np.dtype(kind.to_pandas_dtype())
            yield item.name, numeric(shape, dtype, partial(values, item.name), unit, rate)
        else:
            yield item.name, Channel(shape, f"values of type {kind}", unit, rate)
