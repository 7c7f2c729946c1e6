"""Files of columns: text, with or without a header line, and NumPy's NPZ."""

from __future__ import annotations

import csv
import warnings
import zipfile
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.recordings.channel import MOST_CHANNELS, Channel, in_memory, stored
from tvsysid.recordings.limits import claim

LONGEST_LINE = 1_000_000  # letters of the first line of a text table
MISSING = ("", "n/a", "N/A", "NA")  # cells of a first line of numbers that need not be one


def read_text(file: Path, separator: str, header: bool = True) -> Iterator[tuple[str, Channel]]:
    """Columns of a text file by the names in its first line, or without such a line by number: 1, 2, and so on."""
    first = first_row(file, separator)
    if header and are_numbers(first):
        raise InputError(
            f"{file}: the first line is all numbers, and would be lost as names; if the file has "
            "no names, say "
            "--no-header (header=False in Python) and call its columns 1, 2, ...; if these are "
            "names, make them words"
        )
    if not header and not are_numbers(first):
        raise InputError(
            f"{file}: the first line has names, such as {first[:1]}; read it without --no-header"
        )
    if repeated := [
        name for name, count in Counter(first).items() if header and count > 1 and name
    ]:
        raise InputError(
            f"{file}: several columns are called {repeated[0]!r}; give each a name of its own"
        )
    for name, values in columns_of(file, separator, 0 if header else len(first)):
        yield name, in_memory(values)


def columns_of(
    file: Path, separator: str, headerless: int = 0
) -> Iterator[tuple[str, NDArray[Any]]]:
    """Name and values of each column.

    ``headerless`` is the number of columns if no line has their names.
    """
    import pandas as pd  # noqa: PLC0415  # heavy

    size = file.stat().st_size
    claim(str(file), 2 * size, 24 * size)  # a value may take two letters, and eight bytes thrice
    settings: dict[str, Any] = {"sep": separator, "skipinitialspace": True, "encoding": "utf-8-sig"}
    if headerless:
        settings |= {"header": None, "names": [str(number + 1) for number in range(headerless)]}
    if tuple(map(int, pd.__version__.split(".")[:2])) < (3, 1):
        # Off in the last digits otherwise; deprecated later on.
        settings["float_precision"] = "round_trip"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # rows longer than the header
            table = pd.read_csv(file, **settings, index_col=False, low_memory=False)
    except (
        pd.errors.ParserWarning,
        ValueError,
    ) as error:  # which the parser's errors and those of decoding are
        reason = str(error).strip().splitlines()[0]
        what = f"of {headerless} columns of numbers" if headerless else "with a header line"
        raise InputError(f"{file}: not a text table {what} ({reason})") from error
    for name in table.columns:
        yield str(name).strip(), table[name].to_numpy()


def first_row(file: Path, separator: str) -> list[str]:
    """Cells of the first line that is not empty; an InputError if there are too many."""
    with file.open(encoding="utf-8-sig", errors="replace") as stream:
        line = next(
            (line for _ in range(100) if (line := stream.readline(LONGEST_LINE)).strip()), ""
        )
    cells = [
        cell.strip()
        for row in csv.reader([line], delimiter=separator, skipinitialspace=True)
        for cell in row
    ]
    if len(line) == LONGEST_LINE or len(cells) > MOST_CHANNELS:
        raise InputError(
            f"{file}: the first line has {len(cells)} columns or more; expected {MOST_CHANNELS} "
            "at most: give "
            "each signal a column, and each sample a line"
        )
    return cells


def are_numbers(cells: Sequence[str]) -> bool:
    """Whether all cells that are not empty are numbers."""
    try:
        return bool([float(cell) for cell in cells if cell not in MISSING])
    except ValueError:
        return False


def read_npz(file: Path) -> Iterator[tuple[str, Channel]]:
    """Arrays of an NPZ file by name.

    Each is read when it is asked for, and nothing is unpickled.
    """

    def values(member: str) -> NDArray[Any]:
        with zipfile.ZipFile(file) as archive, archive.open(member) as stream:
            return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))

    with zipfile.ZipFile(file) as archive:
        for member in archive.namelist():
            if member.endswith(".npy"):
                with archive.open(member) as stream:
                    shape, dtype = _npy_header(stream)
                pickled = Channel(shape, "pickled objects, which are never read")
                channel = (
                    pickled if dtype.hasobject else stored(shape, dtype, partial(values, member))
                )
                yield member.removesuffix(".npy"), channel


def _npy_header(stream: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    version = np.lib.format.read_magic(stream)
    read_header = (
        np.lib.format.read_array_header_1_0
        if version == (1, 0)
        else np.lib.format.read_array_header_2_0
    )
    shape, _, dtype = read_header(stream)
    return shape, dtype
