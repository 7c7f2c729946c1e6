"""NetCDF files of versions 3 and 4: each variable is a channel, by its path."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from tvsysid.recordings.channel import Channel, numeric, stated
from tvsysid.recordings.hdf5 import check_whole


def read_netcdf(file: Path) -> Iterator[tuple[str, Channel]]:
    """Read variables by name, those in groups by path.

    A dimension called time comes first. Units and sampling rates are those of the attributes.
    """
    groups = _groups(file)
    for path, group in groups.items():
        for name in map(str, group.variables):
            variable = _time_first(group.variables[name])
            unit, rate = stated(variable.attrs, group.attrs, groups["/"].attrs)
            values = partial(_values, file, path, name)
            channel = numeric(variable.shape, variable.dtype, values, unit, rate)
            yield f"{path}/{name}".lstrip("/"), channel


def _groups(file: Path) -> Mapping[str, xr.Dataset]:
    options: dict[str, Any] = {"decode_times": False, "decode_coords": False}
    if not h5py.is_hdf5(file):
        return {"/": xr.open_dataset(file, engine="scipy", **options)}
    with h5py.File(file, "r") as root:
        check_whole(root)  # xarray follows every link
    return xr.open_groups(file, engine="h5netcdf", phony_dims="sort", **options)


def _values(file: Path, path: str, name: str) -> NDArray[Any]:
    return np.asarray(_time_first(_groups(file)[path].variables[name]).values)


def _time_first(variable: xr.Variable) -> xr.Variable:
    return variable.transpose("time", ...) if "time" in variable.dims else variable


def read_contents(file: Path) -> dict[str, Any]:
    """Return variables and attributes of a file that this package wrote."""
    content = _groups(file)["/"].load()
    return {str(name): each.values for name, each in content.variables.items()} | content.attrs
