"""HDF5 and NetCDF files: each dataset or variable is a channel, by its path, and is read when it is asked for."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.recordings.channel import Channel, stated, stored

if TYPE_CHECKING:
    import xarray as xr


def read_hdf5(file: Path) -> Iterator[tuple[str, Channel]]:
    """Datasets of an HDF5 file by path, such as ``run1/angle``; links to other files are not followed.

    Units and sampling rates are those of the attributes of a dataset, of the groups around it and of the file.
    """
    found: list[tuple[str, Channel]] = []

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset):
            found.append((name, _dataset(file, item)))

    with h5py.File(file, "r") as root:
        root.visititems(visit)
    yield from found


def _dataset(file: Path, dataset: h5py.Dataset) -> Channel:
    above = [dataset.parent]
    while above[-1].name != "/":
        above.append(above[-1].parent)
    unit, rate = stated(dict(dataset.attrs), *(dict(group.attrs) for group in above))
    if dataset.is_virtual or dataset.external:
        return Channel(dataset.shape or (), "values in another file, which are not followed", unit, rate)
    if dataset.shape is None:
        return Channel((), "no values", unit, rate)
    return stored(dataset.shape, dataset.dtype, partial(values_of, file, dataset.name), unit, rate)


def values_of(file: Path, name: str) -> NDArray[Any]:
    """All values of one dataset."""
    with h5py.File(file, "r") as root:
        dataset = root[name]
        if not isinstance(dataset, h5py.Dataset):
            raise InputError(f"{file}: {name} has changed while it was read; read it again")
        return np.asarray(dataset[()])


def read_netcdf(file: Path, engine: str = "h5netcdf") -> Iterator[tuple[str, Channel]]:
    """Variables of a NetCDF file by name, those in groups by path.

    Where a variable has a dimension called time, it comes first. Units and sampling rates are those of the attributes.
    """

    def values(path: str, name: str) -> NDArray[Any]:
        with _groups(file, engine) as groups:
            return np.asarray(_time_first(groups[path].variables[name]).values)

    with _groups(file, engine) as groups:
        for path, group in groups.items():
            for name in map(str, group.variables):
                variable = _time_first(group.variables[name])
                unit, rate = stated(dict(variable.attrs), group.attrs, groups["/"].attrs)
                channel = stored(variable.shape, variable.dtype, partial(values, path, name), unit, rate)
                yield f"{path}/{name}".lstrip("/"), channel


def _time_first(variable: xr.Variable) -> xr.Variable:
    return variable.transpose("time", ...) if "time" in variable.dims else variable


@contextmanager
def _groups(file: Path, engine: str) -> Iterator[dict[str, xr.Dataset]]:
    """Groups by path; times stay the numbers that they are."""
    import xarray as xr  # noqa: PLC0415  # heavy

    plain: dict[str, Any] = {"engine": engine, "decode_times": False, "decode_coords": False}
    if engine == "scipy":  # NetCDF 3, which has no groups
        opened = {"/": xr.open_dataset(file, **plain)}
    else:
        opened = dict(xr.open_groups(file, phony_dims="sort", **plain))
    try:
        yield opened
    finally:
        for group in opened.values():
            group.close()
