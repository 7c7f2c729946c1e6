"""MAT files of every version, with structures, and the objects of the Kearney lab's toolbox."""

from __future__ import annotations

import math
import struct
import warnings
import zlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import attrs
import h5py
import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat, whosmat
from scipy.io.matlab import MatlabObject, MatlabOpaque, MatReadWarning

from tvsysid.errors import InputError
from tvsysid.recordings.channel import NUMBERS, Channel, in_memory, stated_rate, stated_unit, stored
from tvsysid.recordings.hdf5 import check_whole, items_of, values_of
from tvsysid.recordings.limits import claim

INTEGER_CLASSES = tuple(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))
COMPRESSED, MOST_COMPRESSED = (
    15,
    1032,
)  # how elements are marked that zlib made smaller, and by how much it can at most
SEGMENTS = (
    "onsetPointer",
    "segLength",
)  # where the segments of a segdat begin, counted from 1, and how long they are
EXPORT = (
    "in MATLAB: s = struct('dataSet', z.dataSet, 'chanNames', {z.chanNames}, 'onsetPointer', "
    "get(z, 'onsetPointer'), "
    "'segLength', get(z, 'segLength')), and save s"
)
PLAIN_CLASSES = (
    "double",
    "single",
    "logical",
    *INTEGER_CLASSES,
    "char",
    "cell",
    "struct",
    "function_handle",
    "",
)


def read_mat_5(file: Path) -> Iterator[tuple[str, Channel]]:
    """Variables of a MAT file of version 4 to 7 by name, matrices as time x trial.

    A structure's fields are channels ``name.field``. An ``nldat`` object's channels are
    ``name.channel``, with the units and the increment of time that it states.
    """
    bytes_stored = values = _inflated(file)
    with suppress(TypeError):  # it knows no objects
        # A value is stored in a byte at least: more of them are a lie, or a sparse matrix.
        values = min(8 * sum(math.prod(shape) for _, shape, _ in whosmat(file)), 8 * bytes_stored)
    claim(str(file), max(values, bytes_stored), max(3 * values, 10 * bytes_stored))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MatReadWarning)  # of objects, which are read below
        warnings.filterwarnings(
            "error", message='Duplicate variable name "(?!None")'
        )  # what it calls objects
        try:
            variables = loadmat(file, mat_dtype=True)
        except MatReadWarning as error:
            what = str(error).partition(" in stream")[0]
            raise InputError(
                f"{file}: two variables have one name ({what}); give each a name of its own"
            ) from error
    opaque = [name for name, values in variables.items() if isinstance(values, MatlabOpaque)]
    for name, values in variables.items():
        if not name.startswith("__") and name not in opaque:
            yield from _channels(name, values)
    if opaque:
        for name, values in _objects(file).items():
            if name not in variables or name in opaque:
                yield from _channels(name, values)


def _inflated(file: Path) -> int:
    """Bytes that the variables of a file take by their tags.

    What is compressed begins with the tag of what was.
    """
    size = file.stat().st_size
    with file.open("rb") as stream:
        header = stream.read(128)
        order = {b"IM": "<", b"MI": ">"}.get(header[126:])
        while order and len(tag := stream.read(8)) == 8:
            kind, length = struct.unpack(f"{order}II", tag)
            after = stream.tell() + length
            if kind == COMPRESSED:
                inner = zlib.decompressobj().decompress(stream.read(min(length, 4096)), 8)
                if len(inner) == 8:
                    size += min(struct.unpack(f"{order}II", inner)[1], MOST_COMPRESSED * length)
            stream.seek(after)
    return size


def contents_of_mat_5(file: Path) -> dict[str, object]:
    """Variables of a MAT file that this package wrote, single values as such."""
    found = loadmat(file, mat_dtype=True, chars_as_strings=True)
    return {
        name: values.ravel()[0] if np.size(values) == 1 else values
        for name, values in found.items()
        if not name.startswith("__")
    }


def _objects(file: Path) -> dict[str, Any]:
    """Variables as the library reads them that knows MATLAB's objects."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of pandas, about options that the library sets
        import matio  # noqa: PLC0415  # heavy

        return {
            name: values
            for name, values in matio.load_from_mat(str(file)).items()
            if not name.startswith("__")
        }


def _channels(name: str, values: Any) -> Iterator[tuple[str, Channel]]:
    """One channel for a matrix, several for a structure or an object."""
    properties = getattr(values, "properties", None)
    kind = getattr(values, "classname", None)
    if isinstance(values, MatlabObject) and values.size == 1 and values.dtype.names:
        properties = {field: values.ravel()[0][field] for field in values.dtype.names}
    if kind is not None:
        if kind in ("nldat", "segdat") and isinstance(properties, Mapping):
            yield from _nldat(name, properties, kind == "segdat")
        else:
            yield name, Channel(np.shape(values), f"an object of class {kind}")
        return
    array = np.asarray(values)
    if array.dtype.names and array.size == 1 and {"dataSet", *SEGMENTS} <= {*array.dtype.names}:
        yield from _nldat(
            name, {field: array.ravel()[0][field] for field in array.dtype.names}, True
        )
    elif array.dtype.names and array.size == 1:
        for field in array.dtype.names:
            yield from _channels(f"{name}.{field}", array.ravel()[0][field])
    elif array.dtype.names:
        yield name, Channel(array.shape, "structures")
    elif array.dtype.kind == "O":
        yield name, Channel(array.shape, "cells")
    else:
        yield name, in_memory(array)


def _nldat(name: str, properties: Mapping[str, Any], cut: bool) -> Iterator[tuple[str, Channel]]:
    """Channels of the toolbox's ``nldat``, samples x channels x realizations, or of its ``segdat``, which is cut."""
    values = np.asarray(properties.get("dataSet"))
    if values.dtype.kind not in NUMBERS or values.ndim not in (2, 3):
        yield name, Channel(values.shape, "an nldat object without data")
        return
    labels, units = _texts(properties.get("chanNames")), _texts(properties.get("chanUnits"))
    # An increment is one of time in seconds only where the object says so.
    domain = " ".join(_texts(properties.get("domainName"))).lower().replace(" ", "")
    increment = stated_rate(properties.get("domainIncr")) if domain == "time(s)" else None
    for number in range(values.shape[1]):
        label = (
            labels[number]
            if number < len(labels) and labels.count(labels[number]) == 1
            else str(number + 1)
        )
        unit = stated_unit(units[number]) if number < len(units) else ""
        rate = None if increment is None else 1 / increment
        channel = (
            _cut(values, number, properties, unit, rate)
            if cut
            else in_memory(values[:, number], unit, rate)
        )
        yield f"{name}.{label}", channel


def _cut(
    values: NDArray[Any], number: int, properties: Mapping[str, Any], unit: str, rate: float | None
) -> Channel:
    """A channel of a ``segdat``: the samples of its segments, each of which may have a gap before it."""
    try:
        starts, lengths = _segments(properties, number, values.shape[1])
        spans = [
            slice(first - 1, first - 1 + length)
            for first, length in zip(starts, lengths, strict=True)
        ]
    except (ValueError, TypeError, LookupError, AttributeError, OverflowError):
        return Channel(values.shape[:1], f"a segdat whose segments cannot be read; {EXPORT}", unit)
    inside = all(0 <= span.start < span.stop <= len(values) for span in spans)
    if values.ndim != 2 or not spans or not inside:
        return Channel(
            values.shape[:1], "a segdat with segments that its samples do not have", unit
        )
    channel = in_memory(np.concatenate([values[span, number] for span in spans]), unit, rate)
    return attrs.evolve(
        channel, trial_starts=(0, *np.cumsum(lengths)[:-1].tolist()) if len(spans) > 1 else ()
    )


def _segments(properties: Mapping[str, Any], number: int, channels: int) -> list[list[int]]:
    """Onsets and lengths of the segments of one channel: some versions of the toolbox keep a column for each."""
    tables = [
        np.atleast_2d(np.asarray(_parameter(properties, name), dtype=float)) for name in SEGMENTS
    ]
    if any((table != np.round(table)).any() for table in tables):  # NaN among them
        raise ValueError
    onsets = tables[0]
    # A row of as many segments as channels is none of channels: segments begin at different
    # samples.
    by_channel = onsets.shape[1] == channels and (
        len(onsets) > 1 or bool((onsets == onsets[0, 0]).all())
    )
    return [
        [int(item) for item in (table[:, number] if by_channel else table.ravel())]
        for table in tables
    ]


def _parameter(properties: Mapping[str, Any], name: str) -> Any:
    """Value of a property, or of one of the toolbox's ``param`` objects: its value, or if that is NaN its default."""
    if name in properties:
        return properties[name]
    for item in np.ravel(properties["parameterSet"]):
        if _texts(item.properties["paramName"]) == [name]:
            value = np.ravel(item.properties["paramValue"])[0]
            unset = np.size(value) == 1 and np.isnan(np.asarray(value, dtype=float)).all()
            return item.properties["paramDefault"] if unset else value
    raise KeyError


def _texts(values: object) -> list[str]:
    """Texts of a cell array, or of one text."""
    if isinstance(values, str):
        return [values.strip()]
    return (
        [text for item in values.ravel() for text in _texts(item)]
        if isinstance(values, np.ndarray)
        else []
    )


def read_mat_73(file: Path) -> Iterator[tuple[str, Channel]]:
    """Variables of a MAT file of version 7.3, likewise."""
    with h5py.File(file, "r") as root:
        everything = {path: item.thing for path, item in items_of(file, root).items()}
        size = sum(
            thing.nbytes
            for thing in everything.values()
            if isinstance(thing, h5py.Dataset) and thing.size
        )
        items = {path: thing for path, thing in everything.items() if not path.startswith("#")}
        objects = [
            path
            for path, thing in items.items()
            if "/" not in path and _class(thing) not in PLAIN_CLASSES
        ]
        closed: tuple[str, ...] = tuple(
            f"{path}/" for path in objects
        )  # what is inside is read otherwise, or not
        for path, thing in items.items():
            if path in objects or path.startswith(closed):
                continue
            if isinstance(thing, h5py.Group):
                if "MATLAB_sparse" in thing.attrs:
                    closed += (f"{path}/",)
                    yield path.replace("/", "."), Channel((), "a sparse matrix")
            elif not isinstance(thing, h5py.Datatype):
                yield path.replace("/", "."), _matrix(file, thing)
    if objects:
        check_whole(file)
        claim(str(file), size, 4 * size)
        found = _objects(file)
        for name in objects:
            yield from _channels(name, found[name])


def _class(item: Any) -> str:
    told = "" if isinstance(item, str) else item.attrs.get("MATLAB_class", b"")
    return told.decode("ascii", "replace") if isinstance(told, bytes) else str(told)


def _matrix(file: Path, item: h5py.Dataset | str) -> Channel:
    if isinstance(item, str):
        return Channel((), item)
    if item.shape is None or item.attrs.get("MATLAB_empty", 0):
        return Channel((0, 0), "no values")
    # MATLAB stores columns, HDF5 rows.
    shape = item.shape[::-1]
    if _class(item) == "char":
        return Channel(shape, "text")
    if item.dtype.kind == "V" and item.dtype.names == ("real", "imag"):
        return Channel(shape, "complex numbers")
    if item.dtype.kind == "O":
        return Channel(shape, "cells")
    path = item.name
    return stored(shape, item.dtype, lambda: values_of(file, path).T)
