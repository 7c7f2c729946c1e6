"""Neurodata Without Borders (NWB): HDF5 in which each signal is a group with values and times."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.recordings.channel import (
    UNEVEN,
    Channel,
    check_memory,
    even_rate,
    numeric,
    stated_rate,
    stated_unit,
)
from tvsysid.recordings.hdf5 import items_of, read_values


def read_nwb(file: Path) -> Iterator[tuple[str, Channel]]:
    """Read time series by path, ``acquisition/angle``; of several columns ``acquisition/emg.1``.

    Values are ``data * conversion + offset``. The rate is the one that a series states, or that of
    its timestamps.
    """
    with h5py.File(file, "r") as root:
        things = {path: item.thing for path, item in items_of(root).items()}
        for path in things:
            data, start, times, gains = (
                things.get(f"{path}/{name}")
                for name in ("data", "starting_time", "timestamps", "channel_conversion")
            )
            if data is None or (start is None and times is None):
                continue
            if not isinstance(data, h5py.Dataset) or data.shape is None or data.ndim not in (1, 2):
                reason = data if isinstance(data, str) else "no signals"
                yield path, Channel(getattr(data, "shape", None) or (), reason)
                continue
            rate = _rate(start, times, len(data))
            yield from _columns(file, path, data, rate, gains)


def _columns(
    file: Path, path: str, data: h5py.Dataset, rate: float | str | None, gains: object
) -> Iterator[tuple[str, Channel]]:
    """Yield a channel for each column of a time series."""
    attributes: Mapping[str, Any] = data.attrs
    unit, shape = stated_unit(attributes.get("unit", "")), data.shape[:1]
    count = 1 if data.ndim == 1 else data.shape[1]
    factors = np.full(count, float(attributes.get("conversion", 1.0)))
    if isinstance(gains, h5py.Dataset):
        if gains.shape != (count,):
            raise InputError(
                f"{path} has {count} channels, and a channel_conversion of shape {gains.shape}"
            )
        factors *= gains[()]
    offset = float(attributes.get("offset", 0.0))
    for column, factor in enumerate(factors.tolist()):
        name = path if count == 1 else f"{path}.{column + 1}"
        part = () if data.ndim == 1 else np.s_[:, column]
        values = partial(_scaled, file, data.name, part, factor, offset)
        yield (
            name,
            Channel(shape, rate, unit)
            if isinstance(rate, str)
            else numeric(shape, data.dtype, values, unit, rate),
        )


def _scaled(file: Path, name: str, part: object, factor: float, offset: float) -> NDArray[Any]:
    values = read_values(file, name, part)
    return values if (factor, offset) == (1.0, 0.0) else values * factor + offset


def _rate(start: object, times: object, length: int) -> float | str | None:
    """Return the rate in Hz that a series states, or that of its times; else why it has none."""
    if isinstance(start, h5py.Dataset):
        return stated_rate(start.attrs.get("rate"))
    if not isinstance(times, h5py.Dataset) or times.shape != (length,):
        return "values whose timestamps are missing, elsewhere, or not one for each sample"
    check_memory("timestamps", 8 * length)
    return even_rate(times[()]) or UNEVEN
