"""EDF, EDF+ and BDF files."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from tvsysid.errors import InputError
from tvsysid.recordings.channel import (
    Channel,
    numbered,
    numeric,
    optional_library,
    stated_rate,
    stated_unit,
)


def read_edf(file: Path) -> Iterator[tuple[str, Channel]]:
    """Read signals by label, in physical units."""
    edfio = optional_library("edfio", "edf")
    read = edfio.read_bdf if file.suffix.lower() == ".bdf" else edfio.read_edf
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # of records that are missing at the end
        content = read(file, header_encoding="latin-1")
    if content.reserved[3:5] == "+D" and not content.is_continuous:
        raise InputError(
            "the recording was interrupted (EDF+D); save each part as a file of its own"
        )
    signals = content.signals
    names = numbered([signal.label for signal in signals], len(signals))
    for name, signal in zip(names, signals, strict=True):
        shape = (signal.samples_per_data_record * content.num_data_records,)
        unit, rate = stated_unit(signal.physical_dimension), stated_rate(signal.sampling_frequency)
        values = partial(getattr, signal, "data")
        yield name, numeric(shape, np.dtype(np.float64), values, unit, rate)
