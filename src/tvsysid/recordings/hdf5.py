"""Read HDF5 and NWB files."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

import h5py
import numpy as np

from tvsysid.errors import InputError
from tvsysid.recordings.channel import Channel, channel_of, stated, timed

NWB_PARTS = ("starting_time", "timestamps", "channel_conversion")  # of a series, beside its data


def items_of(root: h5py.File) -> dict[str, Any]:
    """Return groups and datasets of a file by path, or why a link to one is not followed.

    Only links within the file are followed: others could make any file of the computer a part of a
    recording.
    """
    links: dict[str, Any] = {}
    root.visititems_links(links.__setitem__)
    items: dict[str, Any] = {}
    for path, link in links.items():
        item = None if isinstance(link, h5py.ExternalLink) else root.get(path)
        # A link within the file may end at one that leads out.
        if item is None or item.file.filename != root.filename:
            items[path] = "a link, which is not followed"
        elif isinstance(item, h5py.Dataset) and (item.is_virtual or item.external):
            items[path] = "values in another file, which are not followed"
        elif isinstance(link, h5py.HardLink) or isinstance(item, h5py.Dataset):
            items[path] = item
    return items


def check_whole(file: Path) -> None:
    """Raise an InputError if anything leads out of a file, before a library follows it."""
    with h5py.File(file, "r") as root:
        for path, item in items_of(root).items():
            if isinstance(item, str):
                raise InputError(f"{path} is {item}; save the file with its values in itself")


def read_hdf5(file: Path) -> Iterator[tuple[str, Channel]]:
    """Read datasets by path, such as ``run1/angle``.

    Units and sampling rates are those of the attributes of a dataset, of the groups around it and
    of the file.
    """
    with h5py.File(file, "r") as root:
        for path, item in items_of(root).items():
            if isinstance(item, str):
                yield path, Channel((), item)
            elif isinstance(item, h5py.Dataset):
                around = (root[str(group)].attrs for group in PurePosixPath(path).parents)
                yield path, channel_of(item, *stated(item.attrs, *around))


def read_nwb(file: Path) -> Iterator[tuple[str, Channel]]:
    """Read time series by path, ``acquisition/angle``; of several columns ``acquisition/emg.1``.

    Values are ``data * conversion + offset``. The rate is the one that a series states, or that of
    its timestamps.
    """
    with h5py.File(file, "r") as root:
        items = items_of(root)
        for path, data in items.items():
            series = path.removesuffix("/data")
            start, times, gains = (items.get(f"{series}/{name}") for name in NWB_PARTS)
            is_signal = isinstance(data, h5py.Dataset) and data.ndim in (1, 2)
            if series == path or not is_signal or not (start or times):
                continue
            shape, about = data.shape[:1], getattr(start, "attrs", {})
            count = data.shape[1] if data.ndim == 2 else 1
            factors = np.full(count, data.attrs.get("conversion", 1.0), dtype=float)
            factors *= gains[()] if isinstance(gains, h5py.Dataset) else 1.0
            # Without a time for each sample, the channel cannot be a signal.
            seconds: Any = times if getattr(times, "shape", None) == shape else ()
            for column, factor in enumerate(factors.tolist()):
                part = np.s_[:, column] if data.ndim == 2 else ()
                values = partial(_scaled, data, part, factor, data.attrs.get("offset", 0.0))
                unit = data.attrs.get("unit")
                channel = channel_of(values, unit, about.get("rate"), shape, data.dtype)
                name = series if count == 1 else f"{series}.{column + 1}"
                yield name, channel if start else timed(channel, seconds)


def _scaled(data: h5py.Dataset, part: object, factor: float, offset: float) -> Any:
    return data[part] * factor + offset
