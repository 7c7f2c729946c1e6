"""C3D files of motion laboratories: each analog channel is a channel."""

from __future__ import annotations

import struct
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from tvsysid.errors import InputError
from tvsysid.recordings.channel import Channel, in_memory, stated_rate, stated_unit
from tvsysid.recordings.memory import check_fits

BIG_ENDIAN = 86
"""Processor that wrote the file, as its parameter section tells: MIPS."""


def read_c3d(file: Path) -> dict[str, Channel]:
    """Analog channels of a C3D file by label, with the units and the rate that it states.

    Labels that several channels share are followed by the channel's number: ``Voltage (3)``.
    """
    ezc3d = _ezc3d()
    size = file.stat().st_size
    check_fits(str(file), 4 * size)
    expected = _expected_size(file)
    if size < expected:
        raise InputError(f"{file}: the C3D file ends after {size} of {expected} bytes; copy it again")
    content = ezc3d.c3d(str(file))
    values = np.concatenate(list(content["data"]["analogs"]), axis=-1)
    parameters = content["parameters"].get("ANALOG", {})
    labels = _texts(parameters, "LABELS")
    repeated = {label for label, count in Counter(labels).items() if count > 1}
    units = _texts(parameters, "UNITS")
    rate = stated_rate(content["header"]["analogs"]["frame_rate"])
    channels = {}
    for number, samples in enumerate(values):
        label = labels[number] if number < len(labels) else ""
        name = f"{label} ({number + 1})".lstrip() if label in repeated or not label else label
        channels[name] = in_memory(samples, stated_unit(units[number]) if number < len(units) else "", rate)
    return channels


def _texts(parameters: Any, name: str) -> list[str]:
    """Texts of a parameter and of its continuations, which have a number behind the name."""
    found: list[str] = []
    for part in (name, *(f"{name}{number}" for number in range(2, 10))):
        found += [str(text).strip() for text in parameters[part]["value"]] if part in parameters else []
    return found


def _expected_size(file: Path) -> int:
    """Bytes that the header promises at least: a file that was cut short is otherwise read in part without a word."""
    with file.open("rb") as stream:
        head = stream.read(512)
        stream.seek(512 * (head[0] - 1) + 3)
        order = ">" if stream.read(1) == bytes([BIG_ENDIAN]) else "<"
    _, points, analogs, first, last, _, scale, start = struct.unpack(f"{order}HHHHHHfH", head[:18])
    width = 4 if scale < 0 else 2
    return int(512 * (start - 1) + max(last - first + 1, 0) * (4 * points + analogs) * width)


def _ezc3d() -> Any:
    try:
        import ezc3d  # noqa: PLC0415  # optional
    except ImportError as error:
        raise InputError("C3D files need ezc3d: pip install 'tvsysid[c3d]'") from error
    return ezc3d
