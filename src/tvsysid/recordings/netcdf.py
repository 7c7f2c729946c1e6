"""NetCDF files: each variable is a channel, time first."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tvsysid.recordings.channel import NUMBERS, Channel, kind_of, stated
from tvsysid.recordings.signatures import seems

if TYPE_CHECKING:
    import xarray as xr


def read_netcdf(file: Path) -> dict[str, Channel]:
    """Variables of a NetCDF file by name, those in groups by path; each is read when it is asked for.

    Where a variable has a dimension called time, it comes first. Units and sampling rates are those of the attributes.
    """
    with _groups(file) as groups:
        return {
            f"{path}/{name}".lstrip("/"): _channel(file, groups, path, str(name))
            for path, group in groups.items()
            for name in group.variables
        }


def _channel(file: Path, groups: dict[str, xr.Dataset], path: str, name: str) -> Channel:
    variable = _time_first(groups[path].variables[name])
    unit, rate = stated(dict(variable.attrs), groups[path].attrs, groups["/"].attrs)
    if variable.dtype.kind not in NUMBERS:
        return Channel(variable.shape, kind_of(variable.dtype), unit, rate)
    return Channel(variable.shape, str(variable.dtype), unit, rate, partial(_values, file, path, name))


def _values(file: Path, path: str, name: str) -> NDArray[Any]:
    with _groups(file) as groups:
        return np.asarray(_time_first(groups[path].variables[name]).values)


def _time_first(variable: xr.Variable) -> xr.Variable:
    return variable.transpose("time", ...) if "time" in variable.dims else variable


@contextmanager
def _groups(file: Path) -> Iterator[dict[str, xr.Dataset]]:
    """Groups by path; times stay the numbers that they are."""
    import xarray as xr  # noqa: PLC0415  # heavy

    plain: dict[str, Any] = {"decode_times": False, "decode_coords": False}
    if seems(file) == "NetCDF file":
        opened = {"/": xr.open_dataset(file, engine="scipy", **plain)}
    else:
        opened = dict(xr.open_groups(file, engine="h5netcdf", phony_dims="sort", **plain))
    try:
        yield opened
    finally:
        for group in opened.values():
            group.close()
