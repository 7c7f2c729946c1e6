"""Read MAT files of all versions, with structures and objects of the Kearney lab's toolbox."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import attrs
import numpy as np
from scipy.io.matlab import matfile_version

from tvsysid.errors import InputError
from tvsysid.recordings.channel import Channel, channel_of, numbered, padded, stated_rate
from tvsysid.recordings.hdf5 import check_whole, read_hdf5

HDF5 = b"\x89HDF\r\n\x1a\n"  # how an HDF5 file begins
SEGMENTS = ("onsetPointer", "segLength")  # first samples, counted from 1, and lengths, of a segdat
NO_SEGMENTS = (
    "a segdat whose segments cannot be read; in MATLAB: s = struct('dataSet', z.dataSet, "
    "'chanNames', {z.chanNames}, 'onsetPointer', get(z, 'onsetPointer'), 'segLength', get(z, "
    "'segLength')), and save s"
)


def read_mat(file: Path) -> Iterator[tuple[str, Channel]]:
    """Read variables of a MAT file by name, matrices as time x trial. It may be any HDF5 file.

    The fields of a structure are channels ``name.field``. The channels of an ``nldat`` object are
    ``name.channel``, with the units and the increment of time that it states.
    """
    with file.open("rb") as stream:
        if stream.read(len(HDF5)) == HDF5:  # without the header that MATLAB writes before it
            yield from read_hdf5(file)
            return
    if matfile_version(file)[0] == 2:  # version 7.3 is HDF5
        check_whole(file)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        import matio  # noqa: PLC0415  # heavy

        variables = matio.load_from_mat(str(file))
    for warning in map(str, (each.message for each in caught)):
        if warning.startswith(("Duplicate variable", "Unreadable variable")):
            raise InputError(f"cannot be read ({warning}); copy it again")
    for name, values in variables.items():
        if not name.startswith("__"):
            yield from _channels_of(name, values)


def _channels_of(name: str, values: Any) -> Iterator[tuple[str, Channel]]:
    """Yield one channel for a matrix, several for a structure or an object."""
    kind, fields = getattr(values, "classname", None), getattr(values, "properties", None)
    array = np.asarray(values)
    if array.dtype.names and array.size == 1:
        fields = dict(zip(array.dtype.names, array.item(), strict=True))
    fields = fields if isinstance(fields, Mapping) else {}
    if "dataSet" in fields and (kind in ("nldat", "segdat") or fields.keys() >= {*SEGMENTS}):
        yield from _signals(name, fields, is_segdat=kind != "nldat")
    elif kind is not None:
        yield name, Channel(np.shape(values), f"an object of class {kind}")
    elif fields:
        for field, each in fields.items():
            yield from _channels_of(f"{name}.{field}", each)
    else:
        yield name, channel_of(array)


def _signals(
    name: str, fields: Mapping[str, Any], is_segdat: bool
) -> Iterator[tuple[str, Channel]]:
    """Yield channels of the toolbox's ``nldat``: samples x channels x realizations."""
    values = np.atleast_2d(fields["dataSet"])
    labels, units = (
        padded(_texts(fields.get(each)), values.shape[1]) for each in ("chanNames", "chanUnits")
    )
    # An increment is one of time in seconds only where the object says so.
    domain = "".join(_texts(fields.get("domainName"))).lower().replace(" ", "")
    increment = stated_rate(fields.get("domainIncr")) if domain == "time(s)" else None
    for number, label in enumerate(numbered(labels)):
        channel = channel_of(values[:, number], units[number], increment and 1 / increment)
        if is_segdat:
            channel = _cut(channel, fields, number, len(labels))
        yield f"{name}.{label}", channel


def _cut(channel: Channel, fields: Mapping[str, Any], number: int, count: int) -> Channel:
    """Return the segments of a channel of a ``segdat``, which may have gaps between them."""
    try:
        table = np.stack([np.atleast_2d(_property(fields, name)) for name in SEGMENTS])
        # Some versions of the toolbox keep a column for each channel.
        if table.shape[1] > 1 and table.shape[2] == count:
            table = table[:, :, number]
        onsets, lengths = table.reshape(2, -1)
        if onsets.min() < 1:
            raise IndexError
        parts = [
            channel.values[np.arange(first - 1, first - 1 + length).astype(int)]
            for first, length in zip(onsets, lengths, strict=True)
        ]
    except Exception:  # whatever the object holds, the other variables can be read
        return attrs.evolve(channel, values=None, dtype=NO_SEGMENTS)
    values = np.concatenate(parts)
    starts = tuple(np.cumsum([0, *map(len, parts[:-1])]).tolist()) if len(parts) > 1 else ()
    return attrs.evolve(channel, shape=values.shape, values=values, trial_starts=starts)


def _property(fields: Mapping[str, Any], name: str) -> Any:
    """Return a property, or else the value or the default of the ``param`` of this name."""
    if name in fields:
        return fields[name]
    for item in np.ravel(fields["parameterSet"]):
        if _texts(item.properties["paramName"]) == [name]:
            value = np.ravel(item.properties["paramValue"])[0]
            is_unset = np.isnan(np.asarray(value, dtype=float)).all()
            return item.properties["paramDefault"] if is_unset else value
    raise KeyError(name)


def _texts(values: object) -> list[str]:
    """Return the texts of a cell array, or of one text."""
    if isinstance(values, str):
        return [values.strip()]
    items = values.ravel() if isinstance(values, np.ndarray) else ()
    return [text for item in items for text in _texts(item)]
