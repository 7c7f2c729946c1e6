"""Read EDF, EDF+ and BDF files."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tvsysid.errors import InputError
from tvsysid.recordings.channel import Channel, channel_of, numbered


def read_edf(file: Path) -> Iterator[tuple[str, Channel]]:
    """Read signals by label, in physical units."""
    import edfio  # noqa: PLC0415  # optional

    read = edfio.read_bdf if file.suffix.lower() == ".bdf" else edfio.read_edf
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # of records that are missing at the end
        content = read(file, header_encoding="latin-1")
    if content.reserved[3:5] == "+D" and not content.is_continuous:
        raise InputError(
            "the recording was interrupted (EDF+D); save each part as a file of its own"
        )
    signals: Any = content.signals
    for name, signal in zip(numbered([each.label for each in signals]), signals, strict=True):
        yield name, channel_of(signal.data, signal.physical_dimension, signal.sampling_frequency)
