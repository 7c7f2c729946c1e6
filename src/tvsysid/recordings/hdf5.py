"""HDF5 and NetCDF files: each dataset or variable is a channel, by its path, and is read when it is asked for."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import h5py
import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.recordings.channel import Channel, stated, stored
from tvsysid.recordings.limits import claim

if TYPE_CHECKING:
    import xarray as xr

DEEPEST = 100  # groups within groups
PLAIN: dict[str, Any] = {
    "decode_times": False,
    "decode_coords": False,
}  # times stay the numbers that they are
ELSEWHERE = "values in another file, which are not followed"


class Item(NamedTuple):
    """What a path in an HDF5 file leads to."""

    thing: h5py.Group | h5py.Dataset | h5py.Datatype | str
    """In words where it leads out of the file, nowhere or in a circle: that is not opened."""
    above: tuple[Mapping[str, object], ...]
    """Attributes of the groups around it, the innermost first."""


def items_of(file: Path, root: h5py.File) -> dict[str, Item]:
    """Everything in an HDF5 file by path, each group once.

    This is the one place that decides what is followed: links within the file to what is there.
    Links to other files, and datasets that have their values in others, could make any file of
    the computer part of a recording.
    """
    found: dict[str, Item] = {}
    targets: dict[str, str] = {}
    for path, item, link in _visited(file, root):
        found[path] = item
        if isinstance(link, h5py.SoftLink):
            around = "" if link.path.startswith("/") else path.rpartition("/")[0]
            targets[path] = f"{around}/{link.path}".strip("/")
    for path, target in targets.items():
        if (
            target in found
            and target not in targets
            and not isinstance(found[target].thing, h5py.Group)
        ):
            found[path] = found[target]
    return found


def _visited(file: Path, root: h5py.File) -> Iterator[tuple[str, Item, object]]:
    """Path, what it leads to, and the link itself.

    A group comes before what it holds, and only once.
    """
    seen = {h5py.h5o.get_info(root.id).addr}
    waiting: list[tuple[str, Item, object]] = [("", Item(root, ()), None)]
    while waiting:
        path, (thing, above), link = waiting.pop()
        if path:
            yield path, Item(thing, above), link
        if not isinstance(thing, h5py.Group):
            continue
        if len(above) > DEEPEST:
            raise InputError(
                f"{file}: groups are nested more than {DEEPEST} deep; save the signals further "
                "outside"
            )
        around = (dict(thing.attrs), *above)
        for name in reversed(list(thing)):
            link = thing.get(name, getlink=True)
            inner = _followed(thing, name, link)
            if isinstance(inner, h5py.Group):
                address = h5py.h5o.get_info(inner.id).addr
                inner = (
                    "a group with another path, which is not followed" if address in seen else inner
                )
                seen.add(address)
            waiting.append((f"{path}/{name}" if path else name, Item(inner, around), link))


def _followed(group: h5py.Group, name: str, link: object) -> Any:
    """What a link leads to, or in words why it is not followed."""
    if isinstance(link, h5py.ExternalLink):
        return f"a link to another file, {link.filename}, which is not followed"
    if isinstance(link, h5py.SoftLink):
        return f"a link to {link.path}, which is not followed"
    thing = group[name]
    if isinstance(thing, h5py.Dataset) and (thing.is_virtual or thing.external):
        return ELSEWHERE
    return thing


def read_hdf5(file: Path) -> Iterator[tuple[str, Channel]]:
    """Datasets of an HDF5 file by path, such as ``run1/angle``.

    Links to other files are not followed.

    Units and sampling rates are those of the attributes of a dataset, of the groups around it
    and of the file.
    """
    with h5py.File(file, "r") as root:
        for path, item in items_of(file, root).items():
            if isinstance(item.thing, str):
                yield path, Channel((), item.thing)
            elif isinstance(item.thing, h5py.Dataset):
                yield path, _dataset(file, item.thing, item.above)


def _dataset(file: Path, dataset: h5py.Dataset, above: tuple[Mapping[str, object], ...]) -> Channel:
    unit, rate = stated(dict(dataset.attrs), *above)
    if dataset.shape is None:
        return Channel((), "no values", unit, rate)
    return stored(dataset.shape, dataset.dtype, partial(values_of, file, dataset.name), unit, rate)


def values_of(file: Path, name: str, part: object = ()) -> NDArray[Any]:
    """All values of one dataset, or a part of them."""
    with h5py.File(file, "r") as root:
        dataset = root[name]
        if not isinstance(dataset, h5py.Dataset):
            raise InputError(f"{file}: {name} has changed while it was read; read it again")
        return np.asarray(dataset[part])


def read_netcdf(file: Path) -> Iterator[tuple[str, Channel]]:
    """Variables of a NetCDF file of version 4 by name, those in groups by path.

    Where a variable has a dimension called time, it comes first. Units and sampling rates are
    those of the attributes.
    """
    source, elsewhere = _without_links(file)

    def values(path: str, name: str) -> NDArray[Any]:
        with _groups(source()) as groups:
            return np.asarray(_time_first(groups[path].variables[name]).values)

    with _groups(source()) as groups:
        for path, group in groups.items():
            yield from _variables(path, group, groups["/"], partial(values, path))
    yield from elsewhere.items()


def read_netcdf_3(file: Path) -> Iterator[tuple[str, Channel]]:
    """Variables of a NetCDF file of version 3, which has no groups, likewise."""
    import xarray as xr  # noqa: PLC0415  # heavy

    def values(name: str) -> NDArray[Any]:
        with xr.open_dataset(file, engine="scipy", **PLAIN) as opened:
            return np.asarray(_time_first(opened.variables[name]).values)

    with xr.open_dataset(file, engine="scipy", **PLAIN) as opened:
        yield from _variables("/", opened, opened, values)


def _without_links(file: Path) -> tuple[Callable[[], Path | io.BytesIO], dict[str, Channel]]:
    """File for xarray, which follows every link: the file itself, or a copy in memory without those that lead away."""
    with h5py.File(file, "r") as root:
        things = {path: item.thing for path, item in items_of(file, root).items()}
    elsewhere = {
        path: Channel((), thing) for path, thing in things.items() if isinstance(thing, str)
    }
    if not elsewhere:
        return lambda: file, {}
    size = file.stat().st_size
    claim(str(file), 2 * size, 4 * size)
    copy = io.BytesIO(file.read_bytes())
    with h5py.File(copy, "r+") as root:
        for path in elsewhere:
            del root[path]
    return lambda: copy, elsewhere


def _variables(
    path: str, group: xr.Dataset, root: xr.Dataset, values: Callable[[str], NDArray[Any]]
) -> Iterator[tuple[str, Channel]]:
    for name in map(str, group.variables):
        variable = _time_first(group.variables[name])
        unit, rate = stated(dict(variable.attrs), group.attrs, root.attrs)
        channel = stored(variable.shape, variable.dtype, partial(values, name), unit, rate)
        yield f"{path}/{name}".lstrip("/"), channel


def _time_first(variable: xr.Variable) -> xr.Variable:
    return variable.transpose("time", ...) if "time" in variable.dims else variable


@contextmanager
def _groups(source: Path | io.BytesIO) -> Iterator[Mapping[str, xr.Dataset]]:
    """Groups of a NetCDF file by path."""
    import xarray as xr  # noqa: PLC0415  # heavy

    opened = xr.open_groups(source, phony_dims="sort", engine="h5netcdf", **PLAIN)
    try:
        yield opened
    finally:
        for group in opened.values():
            group.close()


def contents_of_netcdf(file: Path) -> dict[str, object]:
    """Variables and attributes of a NetCDF file that has none of its values elsewhere."""
    import xarray as xr  # noqa: PLC0415  # heavy

    if h5py.is_hdf5(file):
        check_whole(file)
    claim(str(file), file.stat().st_size, 4 * file.stat().st_size)
    dataset = xr.load_dataset(file, decode_times=False)
    return {
        **{str(name): variable.values for name, variable in dataset.variables.items()},
        **dataset.attrs,
    }


def check_whole(file: Path) -> None:
    """Raise an InputError if anything in an HDF5 file leads out of it: before a library opens it that would follow."""
    with h5py.File(file, "r") as root:
        for path, item in items_of(file, root).items():
            if isinstance(item.thing, str):
                raise InputError(
                    f"{file}: {path} is {item.thing}; save the file with its values in itself"
                )
