"""HDF5 files: each dataset is a channel, by its path."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.recordings.channel import Channel, numeric, stated

MAX_DEPTH = 100  # groups within groups


class Item(NamedTuple):
    """An object in an HDF5 file.

    Parameters
    ----------
    thing
        The object. Where a link leads out of the file, nowhere or in a circle, it is not followed,
        and this is the reason in words.
    above
        Attributes of the groups around it, the innermost first.
    """

    thing: h5py.Group | h5py.Dataset | h5py.Datatype | str
    above: tuple[Mapping[str, object], ...]


def items_of(root: h5py.File) -> dict[str, Item]:
    """Return everything in an HDF5 file by path, each group once.

    Only links to what is in the file are followed: others could make any file of the computer a
    part of a recording.
    """
    found: dict[str, Item] = {}
    targets: dict[str, str] = {}
    for path, item, link in _walk(root, "", (), {h5py.h5o.get_info(root.id).addr}):
        found[path] = item
        if isinstance(link, h5py.SoftLink):
            around = "" if link.path.startswith("/") else path.rpartition("/")[0]
            targets[path] = f"{around}/{link.path}".strip("/")
    for path, target in targets.items():
        linked = found.get(target)
        if linked is not None and target not in targets and not isinstance(linked[0], h5py.Group):
            found[path] = linked
    return found


def _walk(
    group: h5py.Group, around: str, above: tuple[Mapping[str, object], ...], visited: set[int]
) -> Iterator[tuple[str, Item, object]]:
    """Yield the path of each object in a group, the object, and the link to it."""
    if len(above) > MAX_DEPTH:
        raise InputError(
            f"groups are nested more than {MAX_DEPTH} deep; save the signals further outside"
        )
    above = (dict(group.attrs), *above)
    for name in group:
        path, link = f"{around}{name}", group.get(name, getlink=True)
        if isinstance(link, h5py.ExternalLink):
            thing: Any = f"a link to another file, {link.filename}, which is not followed"
        elif isinstance(link, h5py.SoftLink):
            thing = f"a link to {link.path}, which is not followed"
        else:
            thing = group[name]
        is_group = isinstance(thing, h5py.Group)
        if isinstance(thing, h5py.Dataset) and (thing.is_virtual or thing.external):
            thing = "values in another file, which are not followed"
        elif is_group and (address := h5py.h5o.get_info(thing.id).addr) in visited:
            thing, is_group = "a group with another path, which is not followed", False
        yield path, Item(thing, above), link
        if is_group:
            visited.add(address)
            yield from _walk(thing, f"{path}/", above, visited)


def read_hdf5(file: Path) -> Iterator[tuple[str, Channel]]:
    """Read datasets by path, such as ``run1/angle``.

    Units and sampling rates are those of the attributes of a dataset, of the groups around it and
    of the file.
    """
    with h5py.File(file, "r") as root:
        for path, (thing, above) in items_of(root).items():
            if isinstance(thing, str):
                yield path, Channel((), thing)
            elif isinstance(thing, h5py.Dataset):
                unit, rate = stated(dict(thing.attrs), *above)
                values = partial(read_values, file, thing.name)
                yield (
                    path,
                    Channel((), "no values", unit, rate)
                    if thing.shape is None
                    else numeric(thing.shape, thing.dtype, values, unit, rate),
                )


def read_values(file: Path, name: str, part: object = ()) -> NDArray[Any]:
    """Return the values of a dataset, or of a part of it."""
    with h5py.File(file, "r") as root:
        return np.asarray(root[name][part])


def check_whole(root: h5py.File) -> None:
    """Raise an InputError if anything leads out of a file, before a library follows it."""
    for path, item in items_of(root).items():
        if isinstance(item.thing, str):
            raise InputError(f"{path} is {item.thing}; save the file with its values in itself")
