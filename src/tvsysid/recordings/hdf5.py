"""HDF5 files: each dataset is a channel, by its path."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.recordings.channel import NUMBERS, Channel, kind_of, stated


def read_hdf5(file: Path) -> dict[str, Channel]:
    """Datasets of an HDF5 file by path, such as ``run1/angle``; each is read when it is asked for.

    Units and sampling rates are those of the attributes of a dataset, of the groups around it and of the file.
    """
    with h5py.File(file, "r") as root:
        return {name: _channel(file, dataset) for name, dataset in datasets(root)}


def datasets(group: h5py.Group) -> Iterator[tuple[str, h5py.Dataset]]:
    """Datasets in a group and the groups below, with their paths; links to other files are not followed."""
    found: list[tuple[str, h5py.Dataset]] = []

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset):
            found.append((name, item))

    group.visititems(visit)
    return iter(found)


def _channel(file: Path, dataset: h5py.Dataset) -> Channel:
    shape = dataset.shape or ()
    above = [dataset.parent]
    while above[-1].name != "/":
        above.append(above[-1].parent)
    unit, rate = stated(dict(dataset.attrs), *(dict(group.attrs) for group in above))
    if dataset.is_virtual or dataset.external:
        return Channel(shape, "values in another file, which are not followed", unit, rate)
    if dataset.dtype.kind not in NUMBERS or dataset.shape is None:
        return Channel(shape, kind_of(dataset.dtype), unit, rate)
    return Channel(shape, str(dataset.dtype), unit, rate, partial(values_of, file, dataset.name))


def values_of(file: Path, name: str) -> NDArray[Any]:
    """All values of one dataset."""
    with h5py.File(file, "r") as root:
        dataset = root[name]
        if not isinstance(dataset, h5py.Dataset):
            raise InputError(f"{file}: {name} has changed while it was read; read it again")
        return np.asarray(dataset[()])
