"""Formats whose libraries only those install who need them: Parquet, C3D and EDF."""

from __future__ import annotations

import struct
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.recordings.channel import Channel, in_memory, stated, stated_rate, stated_unit, stored
from tvsysid.recordings.limits import claim

BIG_ENDIAN = 86  # processor that wrote a C3D file, as its parameter section tells: MIPS
# What a model of the body computes is stored in C3D as if it were points: which parameter lists it,
# and its unit's.
MODELLED = {"ANGLES": "ANGLE_UNITS", "FORCES": "FORCE_UNITS", "MOMENTS": "MOMENT_UNITS"}
MODELLED |= {"POWERS": "POWER_UNITS", "SCALARS": "SCALAR_UNITS"}


def read_parquet(file: Path) -> Iterator[tuple[str, Channel]]:
    """Columns of a Parquet file by name; each is read when it is asked for.

    Units are those in the metadata of a column, sampling rates those in its or the file's.
    """
    parquet, kind = (
        _optional(f"pyarrow.{part}", "Parquet", "parquet") for part in ("parquet", "types")
    )

    def values(name: str) -> NDArray[Any]:
        with parquet.ParquetFile(file) as table:
            # What is missing becomes NaN.
            return np.asarray(table.read(columns=[name], use_threads=False).column(0).to_numpy())

    with parquet.ParquetFile(file) as table:
        schema, shape = table.schema_arrow, (table.metadata.num_rows,)
    for item in schema:
        unit, rate = stated(_decoded(item.metadata), _decoded(schema.metadata))
        if kind.is_integer(item.type) or kind.is_floating(item.type) or kind.is_boolean(item.type):
            dtype = np.dtype(item.type.to_pandas_dtype())
            yield item.name, stored(shape, dtype, partial(values, item.name), unit, rate)
        else:
            yield item.name, Channel(shape, f"values of type {item.type}", unit, rate)


def _decoded(metadata: dict[bytes, bytes] | None) -> dict[str, str]:
    return {
        str(key, "utf-8", "replace"): str(value, "utf-8", "replace")
        for key, value in (metadata or {}).items()
    }


def _optional(module: str, files: str, extra: str) -> ModuleType:
    """A module of a library that is installed only by those who need it."""
    try:
        return import_module(module)
    except ImportError as error:
        library = module.partition(".")[0]
        raise InputError(f"{files} files need {library}: pip install 'tvsysid[{extra}]'") from error


def read_c3d(file: Path) -> Iterator[tuple[str, Channel]]:
    """Signals of a C3D file of a motion laboratory by label, with the units and rates that it states.

    Analog channels come first; then what is stored as points, an axis each, ``LAnkleAngles.x``:
    joint angles, forces, moments, powers and scalars, and markers last. Labels that several
    share are followed by the number: ``Voltage (3)``, ``C7 (4).x``.
    """
    ezc3d = _optional("ezc3d", "C3D", "c3d")
    size = file.stat().st_size
    claim(str(file), 4 * size, 40 * size)
    expected = _expected_size(file)
    if size < expected:
        raise InputError(
            f"{file}: the C3D file ends after {size} of {expected} bytes; copy it again"
        )
    content = ezc3d.c3d(str(file))
    parameters, header = content["parameters"], content["header"]
    values = np.concatenate(list(content["data"]["analogs"]), axis=-1)
    about = parameters.get("ANALOG", {})
    units, rate = _texts(about, "UNITS"), stated_rate(header["analogs"]["frame_rate"])
    for number, (name, samples) in enumerate(
        zip(_names(_texts(about, "LABELS"), len(values)), values, strict=True)
    ):
        yield (
            name,
            in_memory(samples, stated_unit(units[number]) if number < len(units) else "", rate),
        )
    points = content["data"]["points"][:3]
    yield from _points(
        points, parameters.get("POINT", {}), stated_rate(header["points"]["frame_rate"])
    )


def _points(values: NDArray[Any], about: Any, rate: float | None) -> Iterator[tuple[str, Channel]]:
    """Channels of what is stored as points, of shape (axis, point, time)."""
    units = {
        label: "".join(_texts(about, unit))
        for kind, unit in MODELLED.items()
        for label in _texts(about, kind)
    }
    labels, of_markers = _texts(about, "LABELS"), "".join(_texts(about, "UNITS"))
    names = _names(labels, values.shape[1])
    labelled = list(
        zip([*labels, *[""] * len(names)], names, np.moveaxis(values, 1, 0), strict=False)
    )
    for label, name, axes in sorted(labelled, key=lambda item: item[0] not in units):
        for axis, samples in zip("xyz", axes, strict=True):
            yield (
                f"{name}.{axis}",
                in_memory(samples, stated_unit(units.get(label, of_markers)), rate),
            )


def _names(labels: Sequence[str], count: int) -> list[str]:
    """Name of each of so many signals: its label, with the number behind where that is missing or not the only one."""
    found = Counter(labels)
    padded = [*labels[:count], *[""] * (count - len(labels))]
    return [
        label if label and found[label] == 1 else f"{label} ({n})".lstrip()
        for n, label in enumerate(padded, 1)
    ]


def _texts(parameters: Any, name: str) -> list[str]:
    """Texts of a parameter and of its continuations, which have a number behind the name."""
    parts = (name, *(f"{name}{number}" for number in range(2, 10)))
    return [
        str(text).strip()
        for part in parts
        if part in parameters
        for text in parameters[part]["value"]
    ]


def _expected_size(file: Path) -> int:
    """Bytes that the header promises at least: a file that was cut short is otherwise read in part without a word."""
    with file.open("rb") as stream:
        head = stream.read(512)
        stream.seek(512 * (head[0] - 1) + 3)
        order = ">" if stream.read(1) == bytes([BIG_ENDIAN]) else "<"
    _, points, analogs, first, last, _, scale, start = struct.unpack(f"{order}HHHHHHfH", head[:18])
    width = 4 if scale < 0 else 2
    return int(512 * (start - 1) + max(last - first + 1, 0) * (4 * points + analogs) * width)


def read_edf(file: Path) -> Iterator[tuple[str, Channel]]:
    """Signals of an EDF, EDF+ or BDF file by label, in physical units.

    Each is read when it is asked for.
    """
    edfio = _optional("edfio", "EDF and BDF", "edf")
    size = file.stat().st_size
    claim(str(file), 4 * size, 20 * size)
    read = edfio.read_bdf if file.suffix.lower() == ".bdf" else edfio.read_edf
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # of records that are missing at the end
        content = read(file, header_encoding="latin-1")
    if content.reserved[3:5] == "+D" and not content.is_continuous:
        raise InputError(
            f"{file}: the recording was interrupted (EDF+D); save each part as a file of its own"
        )
    signals = content.signals
    for name, signal in zip(
        _names([signal.label for signal in signals], len(signals)), signals, strict=True
    ):
        shape = (signal.samples_per_data_record * content.num_data_records,)
        read_data = partial(getattr, signal, "data")
        unit, rate = stated_unit(signal.physical_dimension), stated_rate(signal.sampling_frequency)
        yield name, stored(shape, np.dtype(np.float64), read_data, unit, rate)
