"""MAT files of every version, with structures, and the objects of the Kearney lab's toolbox."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import attrs
import h5py
import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.recordings.channel import Channel, in_memory, numeric, stated_rate, stated_unit
from tvsysid.recordings.hdf5 import check_whole, items_of, read_values

SEGMENTS = ("onsetPointer", "segLength")  # first samples, counted from 1, and lengths, of a segdat
EXPORT = (
    "in MATLAB: s = struct('dataSet', z.dataSet, 'chanNames', {z.chanNames}, 'onsetPointer', "
    "get(z, 'onsetPointer'), 'segLength', get(z, 'segLength')), and save s"
)
# Classes whose values HDF5 has as they are; others are objects.
PLAIN_CLASSES = {"double", "single", "logical", "char", "cell", "struct", "function_handle", ""}
PLAIN_CLASSES |= {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}


def read_mat_5(file: Path) -> Iterator[tuple[str, Channel]]:
    """Read variables of a MAT file of version 4 to 7 by name, matrices as time x trial.

    The fields of a structure are channels ``name.field``. The channels of an ``nldat`` object are
    ``name.channel``, with the units and the increment of time that it states.
    """
    from scipy.io import loadmat  # noqa: PLC0415  # heavy
    from scipy.io.matlab import MatlabOpaque, MatReadWarning  # noqa: PLC0415

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MatReadWarning)  # of objects, which are called None
        warnings.filterwarnings("error", message='Duplicate variable name "(?!None")')
        try:
            variables = loadmat(file, mat_dtype=True)
        except MatReadWarning as error:
            what = str(error).partition(" in stream")[0]
            raise InputError(
                f"two variables have one name ({what}); give each a name of its own"
            ) from error
    opaque = {name for name, values in variables.items() if isinstance(values, MatlabOpaque)}
    plain = {name: each for name, each in variables.items() if name not in opaque}
    objects = _objects(file) if opaque else {}
    for name, values in (objects | plain).items():
        if not name.startswith("__"):
            yield from _channels(name, values)


def read_contents(file: Path) -> dict[str, Any]:
    """Return the variables of a MAT file that this package wrote, single values as such."""
    from scipy.io import loadmat  # noqa: PLC0415  # heavy

    found = loadmat(file, mat_dtype=True, chars_as_strings=True)
    return {
        name: values.ravel()[0] if np.size(values) == 1 else values
        for name, values in found.items()
        if not name.startswith("__")
    }


def _objects(file: Path) -> dict[str, Any]:
    """Read variables by the library that knows MATLAB's objects."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of pandas, about options that the library sets
        import matio  # noqa: PLC0415  # heavy

        return dict(matio.load_from_mat(str(file)))


def _channels(name: str, values: Any) -> Iterator[tuple[str, Channel]]:
    """Yield one channel for a matrix, several for a structure or an object."""
    kind, properties = getattr(values, "classname", None), getattr(values, "properties", None)
    array = np.asarray(values)
    if array.dtype.names and array.size == 1:
        properties = {field: array.ravel()[0][field] for field in array.dtype.names}
    is_segdat = kind == "segdat" or (
        kind is None and {"dataSet", *SEGMENTS} <= {*(properties or ())}
    )
    if isinstance(properties, Mapping) and (is_segdat or kind == "nldat"):
        yield from _nldat(name, properties, is_segdat)
    elif kind is not None:
        yield name, Channel(np.shape(values), f"an object of class {kind}")
    elif isinstance(properties, Mapping):
        for field, each in properties.items():
            yield from _channels(f"{name}.{field}", each)
    elif array.dtype.kind in "OV":
        yield name, Channel(array.shape, "cells" if array.dtype.kind == "O" else "structures")
    else:
        yield name, in_memory(array)


def _nldat(
    name: str, properties: Mapping[str, Any], is_segdat: bool
) -> Iterator[tuple[str, Channel]]:
    """Yield channels of the toolbox's ``nldat``: samples x channels x realizations."""
    values = np.asarray(properties.get("dataSet"))
    if values.dtype.kind not in "biufc" or values.ndim not in (2, 3):
        yield name, Channel(values.shape, "an nldat object without data")
        return
    count = values.shape[1]
    labels = [*_texts(properties.get("chanNames")), *[""] * count]
    units = [*_texts(properties.get("chanUnits")), *[""] * count]
    # An increment is one of time in seconds only where the object says so.
    domain = " ".join(_texts(properties.get("domainName"))).lower().replace(" ", "")
    increment = stated_rate(properties.get("domainIncr")) if domain == "time(s)" else None
    for number in range(count):
        is_unique = labels[number] and labels.count(labels[number]) == 1
        channel = in_memory(
            values[:, number], stated_unit(units[number]), increment and 1 / increment
        )
        if is_segdat:
            channel = _cut(channel, values, number, properties)
        yield f"{name}.{labels[number] if is_unique else number + 1}", channel


def _cut(
    channel: Channel, values: NDArray[Any], number: int, properties: Mapping[str, Any]
) -> Channel:
    """Return the segments of a channel of a ``segdat``, which may have gaps between them."""
    refused = attrs.evolve(channel, shape=values.shape[:1], values=None)
    try:
        starts, lengths = _segments(properties, number, values.shape[1])
        spans = [
            slice(start, start + length) for start, length in zip(starts, lengths, strict=True)
        ]
    except (ValueError, TypeError, LookupError, AttributeError, OverflowError):
        return attrs.evolve(refused, dtype=f"a segdat whose segments cannot be read; {EXPORT}")
    is_inside = all(0 <= span.start < span.stop <= len(values) for span in spans)
    if values.ndim != 2 or not spans or not is_inside:
        return attrs.evolve(refused, dtype="a segdat with segments that its samples do not have")
    samples = np.concatenate([values[span, number] for span in spans])
    trial_starts = (0, *np.cumsum(lengths)[:-1].tolist()) if len(spans) > 1 else ()
    return attrs.evolve(channel, shape=samples.shape, values=samples, trial_starts=trial_starts)


def _segments(
    properties: Mapping[str, Any], number: int, channels: int
) -> tuple[list[int], list[int]]:
    """Return first samples and lengths of the segments of a channel.

    Some versions of the toolbox keep a column for each channel.
    """
    onsets, lengths = (
        np.atleast_2d(np.asarray(_parameter(properties, name), dtype=float)) for name in SEGMENTS
    )
    # Segments begin at different samples. So a row that fits is one of channels only if all of its
    # onsets are the same.
    if onsets.shape[1] == channels and (len(onsets) > 1 or np.ptp(onsets) == 0):
        onsets, lengths = onsets[:, number], lengths[:, number]
    tables = (onsets.ravel() - 1, lengths.ravel())
    if any((table != np.round(table)).any() for table in tables):  # NaN among them
        raise ValueError
    return tables[0].astype(int).tolist(), tables[1].astype(int).tolist()


def _parameter(properties: Mapping[str, Any], name: str) -> Any:
    """Return a property, or the value, or else the default, of one of the ``param`` objects."""
    if name in properties:
        return properties[name]
    for item in np.ravel(properties["parameterSet"]):
        if _texts(item.properties["paramName"]) == [name]:
            value = np.ravel(item.properties["paramValue"])[0]
            is_unset = np.size(value) == 1 and np.isnan(np.asarray(value, dtype=float)).all()
            return item.properties["paramDefault"] if is_unset else value
    raise KeyError


def _texts(values: object) -> list[str]:
    """Return the texts of a cell array, or of one text."""
    if isinstance(values, str):
        return [values.strip()]
    items = values.ravel() if isinstance(values, np.ndarray) else ()
    return [text for item in items for text in _texts(item)]


def read_mat_73(file: Path) -> Iterator[tuple[str, Channel]]:
    """Read variables of a MAT file of version 7.3, likewise."""
    with h5py.File(file, "r") as root:
        items = items_of(root)
        objects = [
            path
            for path, item in items.items()
            if path[0] != "#" and "/" not in path and _class(item.thing) not in PLAIN_CLASSES
        ]
        # Groups whose content is read otherwise, or not: objects, references, sparse matrices.
        closed = ["#", *(f"{path}/" for path in objects)]
        for path, (thing, _) in items.items():
            if path in objects or path.startswith(tuple(closed)):
                continue
            name = path.replace("/", ".")
            if isinstance(thing, h5py.Group) and "MATLAB_sparse" in thing.attrs:
                closed.append(f"{path}/")
                yield name, Channel((), "a sparse matrix")
            elif isinstance(thing, str):
                yield name, Channel((), thing)
            elif isinstance(thing, h5py.Dataset):
                yield name, _matrix(file, thing)
        if objects:
            check_whole(root)
    if objects:
        found = _objects(file)
        for name in objects:
            yield from _channels(name, found[name])


def _class(thing: Any) -> str:
    """Return the MATLAB class of a variable; empty if it states none."""
    name = "" if isinstance(thing, str) else thing.attrs.get("MATLAB_class", b"")
    return name.decode("ascii", "replace") if isinstance(name, bytes) else str(name)


def _matrix(file: Path, item: h5py.Dataset) -> Channel:
    if item.shape is None or item.attrs.get("MATLAB_empty", 0):
        return Channel((0, 0), "no values")
    shape = item.shape[::-1]  # MATLAB stores columns, HDF5 rows
    if _class(item) == "char":
        return Channel(shape, "text")
    if item.dtype.names == ("real", "imag"):
        return Channel(shape, "complex numbers")
    if item.dtype.kind == "O":
        return Channel(shape, "cells")
    return numeric(shape, item.dtype, partial(_transposed, file, item.name))


def _transposed(file: Path, name: str) -> NDArray[Any]:
    return read_values(file, name).T
