"""Read C3D files of motion laboratories."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tvsysid.errors import InputError
from tvsysid.recordings.channel import Channel, channel_of, numbered, padded

MODEL_OUTPUTS = ("ANGLE", "FORCE", "MOMENT", "POWER", "SCALAR")
"""Results of body models are stored as points: ``ANGLES`` has labels, ``ANGLE_UNITS`` the unit."""


def read_c3d(file: Path) -> Iterator[tuple[str, Channel]]:
    """Read signals by label, with the units and rates that the file states.

    Analog channels come first, then points, an axis each: ``LAnkleAngles.x``. Labels that several
    signals share are followed by a number: ``Voltage (3)``, ``C7 (4).x``.
    """
    import ezc3d  # noqa: PLC0415  # optional

    content = ezc3d.c3d(str(file))
    points, analogs = content["data"]["points"][:3], content["data"]["analogs"][0]
    if points.shape[2] < (expected := _frames(file)):
        raise InputError(
            f"the C3D file ends after {points.shape[2]} of {expected} frames; copy it again"
        )
    parameters, header = content["parameters"], content["header"]
    about, rate = parameters.get("ANALOG", {}), header["analogs"]["frame_rate"]
    units, labels = (padded(_texts(about, name), len(analogs)) for name in ("UNITS", "LABELS"))
    for name, values, unit in zip(numbered(labels), analogs, units, strict=True):
        yield name, channel_of(values, unit, rate)
    about, rate = parameters.get("POINT", {}), header["points"]["frame_rate"]
    model_units = {
        label: "".join(_texts(about, f"{kind}_UNITS"))
        for kind in MODEL_OUTPUTS
        for label in _texts(about, f"{kind}S")
    }
    labels = padded(_texts(about, "LABELS"), points.shape[1])
    marker_unit, names = "".join(_texts(about, "UNITS")), numbered(labels)
    for point, label in enumerate(labels):
        unit = model_units.get(label, marker_unit)
        for axis, values in zip("xyz", points[:, point], strict=True):
            yield f"{names[point]}.{axis}", channel_of(values, unit, rate)


def _texts(parameters: Mapping[str, Any], name: str) -> list[str]:
    """Return texts of a parameter and of its continuations, which have a number at the end."""
    parts = (parameters.get(f"{name}{number}") for number in ("", *range(2, 10)))
    return [str(text).strip() for part in parts if part for text in part["value"]]


def _frames(file: Path) -> int:
    """Return the number of frames by the header: the smaller one of the two orders of bytes."""
    with file.open("rb") as stream:
        head = stream.read(10)
    ranges = (np.frombuffer(head, order)[3:].astype(int) for order in ("<u2", ">u2"))
    return int(min(last - first + 1 for first, last in ranges))
