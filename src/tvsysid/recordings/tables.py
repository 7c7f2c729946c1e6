"""Read files of columns: text, Motion-BIDS, NPZ and Parquet."""

from __future__ import annotations

import csv
import json
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tvsysid.errors import InputError
from tvsysid.recordings.channel import Channel, channel_of, padded, stated, timed

HEAD_LENGTH = 1_000_000  # characters that hold the first line
MISSING = ("", "n/a", "N/A", "NA")  # cells of a line of numbers


def read_text(file: Path) -> Iterator[tuple[str, Channel]]:
    """Read columns by the names in the first line, or by number, 1, 2, ..., if it holds numbers.

    A second line without numbers holds the units. Semicolons may separate the columns of a CSV
    file; its numbers may have decimal commas then.
    """
    names, units, columns = _read_table(file)
    for number, values in enumerate(columns):
        name = names[number] if names else str(number + 1)
        yield name, channel_of(values, units[number])


def _read_table(file: Path) -> tuple[list[str], list[str], list[Any]]:
    """Return the names in the first line, none if it holds numbers, units and columns."""
    with file.open(encoding="utf-8-sig", errors="replace") as stream:
        head = stream.read(HEAD_LENGTH).strip(" \r\n")
    line, *further = head.split("\n", 2)[:2]
    separator, decimal = "\t" if file.suffix.lower() == ".tsv" else ",", "."
    is_split = ";" in line and ("," not in line or _are_numbers(line.split(";")))
    if is_split and separator == ",":
        separator, decimal = ";", "," if "," in head else "."
    rows = csv.reader([line, *further, ""], delimiter=separator, skipinitialspace=True)
    first, second, *_ = ([cell.strip() for cell in row] for row in rows)
    has_names = not _are_numbers(first)
    has_units = has_names and bool(second) and not any(_are_numbers([cell]) for cell in second)
    import pandas as pd  # noqa: PLC0415  # heavy

    with warnings.catch_warnings():
        warnings.simplefilter("error", pd.errors.ParserWarning)  # rows longer than the first
        table = pd.read_csv(
            file,
            sep=separator,
            decimal=decimal,
            header=int(has_units) if has_names else None,
            names=range(len(first)),
            index_col=False,
            skipinitialspace=True,
            encoding="utf-8-sig",
            low_memory=False,
        )
    names = [cell or f"Unnamed: {number}" for number, cell in enumerate(first) if has_names]
    units = padded(second if has_units else [], len(first))
    return names, units, [values.to_numpy() for _, values in table.items()]


def _are_numbers(cells: list[str]) -> bool:
    """Whether all cells that are not empty are numbers."""
    try:
        return bool([float(cell.replace(",", ".")) for cell in cells if cell not in MISSING])
    except ValueError:
        return False


def read_motion(file: Path) -> Iterator[tuple[str, Channel]]:
    """Read channels of ``sub-1_task-a_motion.tsv`` by their names in ``sub-1_task-a_channels.tsv``.

    Units are those of that file. The rate is the ``SamplingFrequency`` of ``…_motion.json``, or
    that of the times in a channel of type LATENCY.
    """
    names, _, columns = _read_table(file)
    stem = file.name.removesuffix("_motion.tsv")
    described, settings = (file.with_name(stem + end) for end in ("_channels.tsv", "_motion.json"))
    if names:
        raise InputError(
            "expected numbers in the first line, as Motion-BIDS has no names there; got "
            f"{names[:3]}; give a file of another kind another name"
        )
    if not described.is_file():
        raise InputError(f"no {described.name} beside it, which names its columns; put it there")
    lines = described.read_text(encoding="utf-8-sig").splitlines()
    rows = list(csv.DictReader(lines, delimiter="\t"))
    if len(columns) != len(rows) or not all(row.get("name") and row.get("type") for row in rows):
        raise InputError(
            f"expected a row with name and type in {described.name} for each of the {len(columns)} "
            f"columns, got {len(rows)} rows"
        )
    about = json.loads(settings.read_text(encoding="utf-8-sig")) if settings.is_file() else {}
    times = [each for row, each in zip(rows, columns, strict=True) if row["type"] == "LATENCY"]
    for row, values in zip(rows, columns, strict=True):
        channel = channel_of(values, row.get("units"), about.get("SamplingFrequency"))
        yield row["name"], timed(channel, times[0]) if times else channel


def read_npz(file: Path) -> Iterator[tuple[str, Channel]]:
    """Read arrays by name. Nothing is unpickled."""
    with np.load(file, allow_pickle=False) as arrays:
        for name in arrays.files:
            try:
                yield name, channel_of(arrays[name])
            except ValueError as error:  # of an array of Python objects
                yield name, Channel((), f"an array that cannot be read ({error})")


def read_parquet(file: Path) -> Iterator[tuple[str, Channel]]:
    """Read columns by name, with the units and rates that their metadata state."""
    from pyarrow import parquet  # noqa: PLC0415  # optional

    table = parquet.read_table(file, use_threads=False)
    for item, values in zip(table.schema, table.columns, strict=True):
        about = stated(item.metadata or {}, table.schema.metadata or {})
        yield item.name, channel_of(values.to_numpy(), *about)
