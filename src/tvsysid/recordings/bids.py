"""Motion-BIDS: a table without names, whose names, units and rate are in two files beside it."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tvsysid.errors import InputError
from tvsysid.recordings.channel import (
    UNEVEN,
    Channel,
    even_rate,
    in_memory,
    stated_rate,
    stated_unit,
)
from tvsysid.recordings.tables import are_numbers, columns_of, first_row

LARGEST = 5_000_000  # bytes of a file that describes a recording
FOLDERS = (
    4  # data set, participant, session, kind of data: where files that describe a recording may be
)


def read_motion(file: Path) -> Iterator[tuple[str, Channel]]:
    """Channels of ``sub-1_task-ankle_tracksys-robot_motion.tsv`` by their names in ``…_channels.tsv``.

    Units are those of that file, the rate is the ``SamplingFrequency`` of ``…_motion.json``, or
    that of the times in a channel of type LATENCY. Both files may also be in folders above, with
    fewer words in their names.
    """
    rows = _rows(file)
    first = first_row(file, "\t")
    if not are_numbers(first):
        raise InputError(
            f"{file}: expected numbers in the first line, as Motion-BIDS has no names there; got "
            f"{first[:3]}"
        )
    if len(first) != len(rows):
        raise InputError(
            f"{file}: it has {len(first)} columns, and its _channels.tsv describes {len(rows)}"
        )
    table = [values for _, values in columns_of(file, "\t", len(first))]
    rate: float | None = _sampling_frequency(file)
    latencies = [
        values for row, values in zip(rows, table, strict=True) if row["type"].upper() == "LATENCY"
    ]
    if latencies:
        rate = even_rate(latencies[0])
    for row, values in zip(rows, table, strict=True):
        unit = stated_unit(row.get("units") or "").removeprefix("n/a")
        if latencies and rate is None:
            yield row["name"], Channel(values.shape, UNEVEN, unit)
        else:
            yield row["name"], in_memory(values, unit, rate)


def _rows(file: Path) -> list[dict[str, Any]]:
    """What ``_channels.tsv`` says of each column."""
    for description in _beside(file, "_channels.tsv"):
        rows = list(csv.DictReader(_text(file, description).splitlines(), delimiter="\t"))
        if not rows or not all(row.get("name") and row.get("type") for row in rows):
            raise InputError(
                f"{file}: {description.name} lacks rows with name and type; they name the columns"
            )
        return rows
    raise InputError(
        f"{file}: no {file.name.removesuffix('_motion.tsv')}_channels.tsv beside it, which names "
        "its columns; put it "
        "there, or give the file another name if its first line has names"
    )


def _sampling_frequency(file: Path) -> float | None:
    """Rate that the nearest description states."""
    for description in _beside(file, "_motion.json"):
        told = json.loads(_text(file, description))
        if isinstance(told, dict) and "SamplingFrequency" in told:
            return stated_rate(told["SamplingFrequency"])
    return None


def _beside(file: Path, ending: str) -> Iterator[Path]:
    """Files with this ending that describe a recording, the nearest first: all words of their names are in its own."""
    words = set(file.name.split("_")[:-1])
    for folder in file.absolute().parents[:FOLDERS]:
        found = {
            item: item.name.removesuffix(ending).split("_") for item in folder.glob(f"*{ending}")
        }
        yield from sorted(
            (item for item, own in found.items() if {*own} <= words),
            key=lambda item: -len(found[item]),
        )


def _text(file: Path, description: Path) -> str:
    if description.stat().st_size > LARGEST:
        raise InputError(
            f"{file}: {description.name} has more than {LARGEST / 1e6:g} MB; is it a description?"
        )
    return description.read_text(encoding="utf-8-sig")
