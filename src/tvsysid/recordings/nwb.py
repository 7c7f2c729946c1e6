"""Neurodata Without Borders (NWB): HDF5 in which each signal is a group, with its values, unit and times."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.recordings.channel import UNEVEN, Channel, even_rate, stated_rate, stated_unit, stored
from tvsysid.recordings.hdf5 import items_of, values_of
from tvsysid.recordings.limits import claim


def read_nwb(file: Path) -> Iterator[tuple[str, Channel]]:
    """Time series of an NWB file by path, ``acquisition/ankle_angle``.

    Of several columns, ``acquisition/emg.1``.

    Values are as the file means them: ``data * conversion + offset``. The rate is the one that a
    series states, or that of its timestamps.
    """
    with h5py.File(file, "r") as root:
        things = {path: item.thing for path, item in items_of(file, root).items()}
        for path in things:
            inside = {
                name: things.get(f"{path}/{name}")
                for name in ("data", "starting_time", "timestamps")
            }
            if inside["data"] is not None and (inside["starting_time"] or inside["timestamps"]):
                yield from _series(file, path, inside, things.get(f"{path}/channel_conversion"))


def _series(
    file: Path, path: str, inside: Mapping[str, object], gains: object
) -> Iterator[tuple[str, Channel]]:
    """Channels of one time series: its columns."""
    data = inside["data"]
    if not isinstance(data, h5py.Dataset) or data.shape is None or data.ndim not in (1, 2):
        yield (
            path,
            Channel(
                getattr(data, "shape", None) or (), data if isinstance(data, str) else "no signals"
            ),
        )
        return
    unit, rate = stated_unit(data.attrs.get("unit", "")), _rate(file, inside, len(data))
    count = 1 if data.ndim == 1 else data.shape[1]
    factors, offset = _factors(file, path, data, gains, count), float(data.attrs.get("offset", 0.0))
    for column in range(count):
        name = path if count == 1 else f"{path}.{column + 1}"
        if isinstance(rate, str):
            yield name, Channel(data.shape[:1], rate, unit)
            continue
        part = () if data.ndim == 1 else np.s_[:, column]
        values = partial(_scaled, file, data.name, part, float(factors[column]), offset)
        yield name, stored(data.shape[:1], data.dtype, values, unit, rate)


def _scaled(file: Path, name: str, part: object, factor: float, offset: float) -> NDArray[Any]:
    values = values_of(file, name, part)
    return values if (factor, offset) == (1.0, 0.0) else values * factor + offset


def _factors(file: Path, path: str, data: h5py.Dataset, gains: object, count: int) -> NDArray[Any]:
    """What each of so many columns has to be multiplied with."""
    factors = np.full(count, float(data.attrs.get("conversion", 1.0)))
    if isinstance(gains, h5py.Dataset):
        if gains.shape != (count,):
            raise InputError(
                f"{file}: {path} has {count} channels, and a channel_conversion of shape "
                f"{gains.shape}"
            )
        factors *= gains[()]
    return factors


def _rate(file: Path, inside: Mapping[str, object], length: int) -> float | str | None:
    """Rate in Hz that a series states, or that of its timestamps; in words why it has none."""
    start, times = inside["starting_time"], inside["timestamps"]
    if isinstance(start, h5py.Dataset):
        return stated_rate(start.attrs.get("rate"))
    if not isinstance(times, h5py.Dataset) or times.shape != (length,):
        return "values whose timestamps are missing, elsewhere, or not one for each sample"
    claim(f"{file}: {times.name}", 8 * length, 24 * length)
    rate = even_rate(times[()])
    return UNEVEN if rate is None else rate
