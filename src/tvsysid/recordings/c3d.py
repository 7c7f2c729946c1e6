"""C3D files of motion laboratories."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tvsysid.errors import InputError
from tvsysid.recordings.channel import (
    Channel,
    in_memory,
    numbered,
    optional_library,
    stated_rate,
    stated_unit,
)

BIG_ENDIAN = 86  # processor that wrote the file, as its parameter section states it: MIPS
# Results of body models are stored as points: parameters with their labels, and with their units.
MODEL_UNITS = {
    "ANGLES": "ANGLE_UNITS",
    "FORCES": "FORCE_UNITS",
    "MOMENTS": "MOMENT_UNITS",
    "POWERS": "POWER_UNITS",
    "SCALARS": "SCALAR_UNITS",
}


def read_c3d(file: Path) -> Iterator[tuple[str, Channel]]:
    """Read signals by label, with the units and rates that the file states.

    Analog channels come first, then points, an axis each: ``LAnkleAngles.x``. Joint angles, forces,
    moments, powers and scalars go before markers. Labels that several signals share are followed by
    a number: ``Voltage (3)``, ``C7 (4).x``.
    """
    ezc3d = optional_library("ezc3d", "c3d")
    size, expected = file.stat().st_size, _expected_size(file)
    if size < expected:  # ezc3d would read such a file in part
        raise InputError(f"the C3D file ends after {size} of {expected} bytes; copy it again")
    content = ezc3d.c3d(str(file))
    parameters, header = content["parameters"], content["header"]
    analogs = np.concatenate(list(content["data"]["analogs"]), axis=-1)
    about = parameters.get("ANALOG", {})
    units, rate = _texts(about, "UNITS"), stated_rate(header["analogs"]["frame_rate"])
    units += [""] * len(analogs)
    for name, values, unit in zip(
        numbered(_texts(about, "LABELS"), len(analogs)), analogs, units, strict=False
    ):
        yield name, in_memory(values, stated_unit(unit), rate)
    points, about = content["data"]["points"][:3], parameters.get("POINT", {})
    rate = stated_rate(header["points"]["frame_rate"])
    model_units = {
        label: "".join(_texts(about, unit))
        for kind, unit in MODEL_UNITS.items()
        for label in _texts(about, kind)
    }
    labels, marker_unit = _texts(about, "LABELS"), "".join(_texts(about, "UNITS"))
    names = numbered(labels, points.shape[1])
    labels += [""] * len(names)
    for number in sorted(range(len(names)), key=lambda number: labels[number] not in model_units):
        unit = stated_unit(model_units.get(labels[number], marker_unit))
        for axis, values in zip("xyz", points[:, number], strict=True):
            yield f"{names[number]}.{axis}", in_memory(values, unit, rate)


def _texts(parameters: Mapping[str, Any], name: str) -> list[str]:
    """Return texts of a parameter and of its continuations, which have a number at the end."""
    parts = (name, *(f"{name}{number}" for number in range(2, 10)))
    return [
        str(text).strip()
        for part in parts
        if part in parameters
        for text in parameters[part]["value"]
    ]


def _expected_size(file: Path) -> int:
    """Return the bytes that the header promises at least."""
    with file.open("rb") as stream:
        head = stream.read(512)
        stream.seek(512 * (head[0] - 1) + 3)
        order = ">" if stream.read(1) == bytes([BIG_ENDIAN]) else "<"
    _, points, analogs, first, last, _, scale, start = struct.unpack(f"{order}HHHHHHfH", head[:18])
    width = 4 if scale < 0 else 2
    return int(512 * (start - 1) + max(last - first + 1, 0) * (4 * points + analogs) * width)
