"""Read NetCDF files of versions 3 and 4. Each variable is a channel, by its path."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import xarray as xr

from tvsysid.recordings.channel import Channel, channel_of, stated
from tvsysid.recordings.hdf5 import check_whole


def read_netcdf(file: Path) -> Iterator[tuple[str, Channel]]:
    """Read variables by name, those in groups by path.

    A dimension called time comes first. Units and sampling rates are those of the attributes.
    """
    options: dict[str, Any] = {"decode_times": False, "decode_coords": False}
    groups: Mapping[str, xr.Dataset]
    if h5py.is_hdf5(file):
        check_whole(file)  # xarray follows every link
        groups = xr.open_groups(file, engine="h5netcdf", phony_dims="sort", **options)
    else:
        groups = {"/": xr.open_dataset(file, engine="scipy", **options)}
    for path, group in groups.items():
        for name in map(str, group.variables):
            variable = group.variables[name].transpose("time", ..., missing_dims="ignore")
            about = stated(variable.attrs, group.attrs, groups["/"].attrs)
            yield f"{path}/{name}".lstrip("/"), channel_of(variable, *about)
