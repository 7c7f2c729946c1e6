"""A recording, read as the options say."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from tvsysid.cli.options import AngleUnit, Columns
from tvsysid.errors import InputError

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
    channel: Iterable[str],
) -> Recording:
    """Recording as the options say; each of the further channels as NAME=CHANNEL.

    Raises
    ------
    InputError
        For what :func:`tvsysid.read_recording` raises, or a channel without a name.
    """
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
        channels=dict(map(_named, channel)),
    )


def _named(text: str) -> tuple[str, str]:
    name, _, in_file = text.partition("=")
    if not name or not in_file:
        raise InputError(f"--channel {text}: expected NAME=CHANNEL, as in emg=EMG_SIGNAL")
    return name, in_file
