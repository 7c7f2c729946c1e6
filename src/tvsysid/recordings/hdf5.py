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


def read_hdf5(file: Path) -> dict[str, Channel]:
    """Datasets of an HDF5 file by path, such as ``run1/angle``; links to other files are not followed.

    Units and sampling rates are those of the attributes of a dataset, of the groups around it and of the file.
    """
    found: dict[str, Channel] = {}

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset):
            found[name] = _dataset(file, item)

    with h5py.File(file, "r") as root:
        root.visititems(visit)
    return found


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


def read_netcdf(file: Path, engine: str = "h5netcdf") -> dict[str, Channel]:
    """Variables of a NetCDF file by name, those in groups by path.

    Where a variable has a dimension called time, it comes first. Units and sampling rates are those of the attributes.
    """
    with _groups(file, engine) as groups:
        return {
            f"{path}/{name}".lstrip("/"): _variable(file, engine, groups, path, str(name))
            for path, group in groups.items()
            for name in group.variables
        }


def _variable(file: Path, engine: str, groups: dict[str, xr.Dataset], path: str, name: str) -> Channel:
    variable = _time_first(groups[path].variables[name])
    unit, rate = stated(dict(variable.attrs), groups[path].attrs, groups["/"].attrs)
    return stored(variable.shape, variable.dtype, partial(_variable_values, file, engine, path, name), unit, rate)


def _variable_values(file: Path, engine: str, path: str, name: str) -> NDArray[Any]:
    with _groups(file, engine) as groups:
        return np.asarray(_time_first(groups[path].variables[name]).values)


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
