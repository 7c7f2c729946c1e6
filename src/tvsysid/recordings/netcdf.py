"""NetCDF files of versions 3 and 4: each variable is a channel, by its path."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from tvsysid.recordings.channel import Channel, numeric, stated
from tvsysid.recordings.hdf5 import check_whole, datasets_of, read_values

NOT_A_VARIABLE = b"This is a netCDF dimension but not a netCDF variable"
PACKING = ("scale_factor", "add_offset", "_FillValue", "missing_value")  # attributes


def read_netcdf(file: Path) -> Iterator[tuple[str, Channel]]:
    """Read variables of a NetCDF file of version 4 by name, those in groups by path.

    A dimension called time comes first. Units and sampling rates are those of the attributes.
    """
    with h5py.File(file, "r") as root:
        for path, dataset, item in datasets_of(root):
            if isinstance(dataset, str):
                yield path, Channel((), dataset)
                continue
            attributes = dict(dataset.attrs)
            name = attributes.get("NAME", b"")
            if isinstance(name, bytes) and name.startswith(NOT_A_VARIABLE):
                continue
            dims = [dim[0].name.rpartition("/")[2] if len(dim) else "" for dim in dataset.dims]
            axis = dims.index("time") if "time" in dims else 0
            packing = {key: np.ravel(attributes[key])[0] for key in PACKING if key in attributes}
            dtype = _unpacked(np.empty(0, dataset.dtype), packing).dtype
            shape = (*dataset.shape[axis : axis + 1], *dataset.shape[:axis])
            shape += dataset.shape[axis + 1 :]
            values = partial(_values, file, dataset.name, axis, packing)
            yield path, numeric(shape, dtype, values, *stated(attributes, *item.above))


def _values(file: Path, name: str, axis: int, packing: dict[str, Any]) -> NDArray[Any]:
    values = _unpacked(read_values(file, name), packing)
    return np.moveaxis(values, axis, 0) if axis else values


def _unpacked(values: NDArray[Any], packing: dict[str, Any]) -> NDArray[Any]:
    """Return values times their factor plus their offset; NaN where the file has none."""
    if not packing:
        return values
    dims = [f"axis{number}" for number in range(values.ndim)]
    variable = xr.Variable(dims, values, packing)
    return np.asarray(xr.conventions.decode_cf_variable("", variable, decode_times=False).values)


def read_netcdf_3(file: Path) -> Iterator[tuple[str, Channel]]:
    """Read variables of a NetCDF file of version 3, likewise."""
    with xr.open_dataset(file, engine="scipy", decode_times=False, decode_coords=False) as content:
        for name, variable in content.variables.items():
            order = sorted(variable.dims, key=lambda dim: dim != "time")
            values = variable.transpose(*order).values
            unit, rate = stated(variable.attrs, content.attrs)
            yield str(name), numeric(values.shape, values.dtype, values, unit, rate)


def read_contents(file: Path) -> dict[str, Any]:
    """Return variables and attributes of a file that this package wrote."""
    with h5py.File(file, "r") as root:
        check_whole(root)
        attributes = {
            name: value if isinstance(value, str) else np.ravel(value)[0]
            for name, value in root.attrs.items()
        }
        return {name: root[name][()] for name in root} | attributes
