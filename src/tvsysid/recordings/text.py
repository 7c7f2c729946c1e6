"""Text files with a header line and a column for each channel."""

from __future__ import annotations

import warnings
from pathlib import Path

import pandas as pd

from tvsysid.errors import InputError
from tvsysid.recordings.channel import Channel, in_memory
from tvsysid.recordings.memory import check_fits


def read_csv(file: Path) -> dict[str, Channel]:
    """Columns of a comma-separated file by the names in its first line."""
    return _read(file, ",")


def read_tsv(file: Path) -> dict[str, Channel]:
    """Columns of a tab-separated file by the names in its first line."""
    return _read(file, "\t")


def _read(file: Path, separator: str) -> dict[str, Channel]:
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
            )
    except (
        pd.errors.ParserWarning,
        pd.errors.ParserError,
        pd.errors.EmptyDataError,
        UnicodeDecodeError,
        ValueError,
    ) as error:
        reason = str(error).strip().splitlines()[0]
        raise InputError(f"{file}: not a text table with a header line ({reason})") from error
    return {str(name).strip(): in_memory(table[name].to_numpy()) for name in table.columns}
