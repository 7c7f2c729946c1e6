"""A recording, read as the options say."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from tvsysid.cli.options import AngleUnit, Columns

if TYPE_CHECKING:
    from tvsysid.signals import Recording


def read(
    file: Path,
    angle: str,
    torque: str,
    rate: float,
    columns: Columns,
    torque_sign: int,
    angle_unit: AngleUnit,
    start: float,
) -> Recording:
    """Recording as the options say."""
    from tvsysid.recordings import read_recording

    return read_recording(
        file,
        angle=angle,
        torque=torque,
        sampling_rate=rate,
        angle_unit=angle_unit.value,
        torque_sign=torque_sign,  # type: ignore[arg-type]
        columns=columns.value,
        start=start,
    )
