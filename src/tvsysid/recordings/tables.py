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
from numpy.lib import format as npy
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.recordings.channel import UNEVEN, Channel, channel_of, even_rate, stated

MAX_COLUMNS = 10_000
HEAD_LENGTH = 1_000_000  # characters that hold the first line
MISSING = ("", "n/a", "N/A", "NA")  # cells of a line of numbers
BIDS_FOLDERS = 4  # data set, participant, session, kind of data: all may hold descriptions


def read_text(file: Path, header: bool = True) -> Iterator[tuple[str, Channel]]:
    """Read columns by the names in the first line, or by number: 1, 2, ...

    Semicolons may separate the columns of a CSV file; its numbers may have decimal commas then.
    """
    first, dialect = _first_row(file)
    if header == _are_numbers(first):
        raise InputError(
            "the first line is all numbers, and would be lost as names; if the file has no names, "
            "say --no-header (header=False in Python) and call its columns 1, 2, ...; if these are "
            "names, make them words"
            if header
            else f"the first line has names, such as {first[:1]}; read it without --no-header"
        )
    for number, values in enumerate(_columns(file, len(first), header, **dialect), start=1):
        name = first[number - 1] or f"Unnamed: {number}"
        yield name if header else str(number), channel_of(values)


def _first_row(file: Path) -> tuple[list[str], dict[str, str]]:
    """Return the cells of the first line that is not empty, and the separator and decimal mark."""
    with file.open(encoding="utf-8-sig", errors="replace") as stream:
        head = stream.read(HEAD_LENGTH).strip(" \r\n")
    line = head.partition("\n")[0]
    dialect = {"sep": "\t" if file.suffix.lower() == ".tsv" else ",", "decimal": "."}
    is_split = ";" in line and ("," not in line or _are_numbers(line.split(";")))
    if is_split and dialect["sep"] == ",":
        dialect = {"sep": ";", "decimal": "," if "," in head else "."}
    rows = csv.reader([line], delimiter=dialect["sep"], skipinitialspace=True)
    cells = [cell.strip() for row in rows for cell in row]
    if len(cells) > MAX_COLUMNS:
        raise InputError(
            f"the first line has {len(cells)} columns or more; expected {MAX_COLUMNS} at most: "
            "give each signal a column, and each sample a line"
        )
    return cells, dialect


def _are_numbers(cells: list[str]) -> bool:
    """Whether all cells that are not empty are numbers."""
    try:
        return bool([float(cell.replace(",", ".")) for cell in cells if cell not in MISSING])
    except ValueError:
        return False


def _columns(
    file: Path, count: int, header: bool, sep: str, decimal: str
) -> Iterator[NDArray[Any]]:
    """Yield the values of so many columns."""
    import pandas as pd  # noqa: PLC0415  # heavy

    is_exact = tuple(map(int, pd.__version__.split(".")[:2])) >= (3, 1)
    precision: dict[str, Any] = {} if is_exact else {"float_precision": "round_trip"}
    with warnings.catch_warnings():
        warnings.simplefilter("error", pd.errors.ParserWarning)  # rows longer than the first
        table = pd.read_csv(
            file,
            sep=sep,
            decimal=decimal,
            header=0 if header else None,
            names=range(count),
            index_col=False,
            skipinitialspace=True,
            encoding="utf-8-sig",
            low_memory=False,
            **precision,
        )
    if table[count - 1].isna().any():  # pandas fills up short rows
        with file.open(encoding="utf-8-sig", newline="") as stream:
            for row in (rows := csv.reader(stream, delimiter=sep, skipinitialspace=True)):
                if any(row) and len(row) < count:
                    raise InputError(
                        f"line {rows.line_num} has {len(row)} of {count} columns; complete it, or "
                        "copy the file again"
                    )
    for number in range(count):
        yield table[number].to_numpy()


def read_motion(file: Path) -> Iterator[tuple[str, Channel]]:
    """Read channels of ``sub-1_task-a_motion.tsv`` by their names in ``sub-1_task-a_channels.tsv``.

    Units are those of that file. The rate is the ``SamplingFrequency`` of ``…_motion.json``, or
    that of the times in a channel of type LATENCY. Both files may also be in folders above, with
    fewer words in their names.
    """
    first, dialect = _first_row(file)
    if not _are_numbers(first):
        raise InputError(
            "expected numbers in the first line, as Motion-BIDS has no names there; got "
            f"{first[:3]}"
        )
    described, settings = (_nearest(file, ending) for ending in ("_channels.tsv", "_motion.json"))
    if described is None:
        raise InputError(
            f"no {file.name.removesuffix('_motion.tsv')}_channels.tsv beside it, which names its "
            "columns; put it there, or give the file another name if its first line has names"
        )
    lines = described.read_text(encoding="utf-8-sig").splitlines()
    rows = list(csv.DictReader(lines, delimiter="\t"))
    if len(first) != len(rows) or not all(row.get("name") and row.get("type") for row in rows):
        raise InputError(
            f"expected a row with name and type in {described.name} for each of the {len(first)} "
            f"columns, got {len(rows)} rows"
        )
    columns = list(_columns(file, len(first), header=False, **dialect))
    rate, kinds = None, [row["type"].upper() for row in rows]
    if "LATENCY" in kinds:
        rate = even_rate(columns[kinds.index("LATENCY")])
    elif settings is not None:
        rate = json.loads(settings.read_text(encoding="utf-8-sig")).get("SamplingFrequency")
    for row, values in zip(rows, columns, strict=True):
        channel = channel_of(values, row.get("units"), rate)
        if rate is None and "LATENCY" in kinds:
            channel = Channel(values.shape, UNEVEN, row.get("units"))
        yield row["name"], channel


def _nearest(file: Path, ending: str) -> Path | None:
    """Return the nearest file that describes a recording: its words are all in its name."""
    words = set(file.name.split("_"))
    for folder in file.absolute().parents[:BIDS_FOLDERS]:
        found = [
            item
            for item in folder.glob(f"*{ending}")
            if words.issuperset(item.name.removesuffix(ending).split("_"))
        ]
        if found:
            return max(found, key=lambda item: item.name.count("_"))
    return None


def read_npz(file: Path) -> Iterator[tuple[str, Channel]]:
    """Read arrays by name. Nothing is unpickled."""
    with zipfile.ZipFile(file) as archive, np.load(file, allow_pickle=False) as arrays:
        for member in archive.namelist():
            name = member.removesuffix(".npy")
            if name == member:
                continue
            with archive.open(member) as stream:
                is_first = npy.read_magic(stream) == (1, 0)
                read = npy.read_array_header_1_0 if is_first else npy.read_array_header_2_0
                shape, _, dtype = read(stream)
            if dtype.hasobject:
                yield name, Channel(shape, "pickled objects, which are never read")
            else:
                values = partial(arrays.__getitem__, name)
                yield name, channel_of(values, shape=shape, dtype=dtype)


def read_parquet(file: Path) -> Iterator[tuple[str, Channel]]:
    """Read columns by name, with the units and rates that their metadata state."""
    from pyarrow import parquet  # noqa: PLC0415  # optional

    schema, shape = parquet.read_schema(file), (parquet.read_metadata(file).num_rows,)
    dtypes = schema.empty_table().to_pandas(ignore_metadata=True).dtypes
    for item, dtype in zip(schema, dtypes, strict=True):
        values = partial(parquet.read_table, file, columns=[item.name], use_threads=False)
        about = stated(item.metadata or {}, schema.metadata or {})
        yield item.name, channel_of(values, *about, shape, dtype)
