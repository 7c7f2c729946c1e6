"""Warnings at reading: where a file contradicts the caller, and values that look wrong."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

import numpy as np

from tvsysid.recordings.channel import Channel
from tvsysid.recordings.reading import Reading
from tvsysid.signals import Recording

MAX_ANGLE_RMS_RAD = 0.2  # about the mean; more is probably in degrees
RATE_TOLERANCE = 1e-3  # relative: files round their rates
UNIT_SPELLINGS = {
    "rad": r"rad(ians?)?",
    "deg": r"deg(rees?)?|°",
    "Nm": r"nm|newtonmet(er|re)s?",
    "Nmm": r"nmm|newtonmillimet(er|re)s?",
}


def doubts(
    channels: Mapping[str, Channel], recording: Recording, reading: Reading
) -> Iterator[str]:
    """Yield sentences on what a file states otherwise than the caller, and on odd values.

    Channels are those that were read, by their names in the recording.
    """
    given, names = recording.sampling_rate, reading.names
    for rate in sorted({each.sampling_rate for each in channels.values() if each.sampling_rate}):
        if abs(rate - given) > RATE_TOLERANCE * given:
            stating = [names[own] for own in names if channels[own].sampling_rate == rate]
            yield (
                f"the file states {rate:g} Hz for {', '.join(stating)}, you gave {given:g} Hz; "
                "check the rate"
            )
    for own, unit in (("angle", reading.angle_unit), ("torque", reading.torque_unit)):
        stated = channels[own].unit
        plain = re.sub(r"[\s·⋅.*\-_()\[\]]", "", stated.lower())
        if stated and not re.fullmatch(UNIT_SPELLINGS[unit], plain):
            yield (
                f"the file states the unit {stated!r} for {names[own]}, and is read in {unit}; "
                "convert it, or name its unit"
            )
    size = float(np.std(recording.angle))
    if size > MAX_ANGLE_RMS_RAD:
        yield (
            f"{reading.angle} has an RMS of {size:.3g} rad about its mean; if it is in degrees, "
            "give angle_unit='deg' (--angle-unit deg)"
        )
    for own, values in recording.channels.items():
        if values.min() == values.max():
            yield (
                f"all {len(values)} values of channel {own} are {values[0]:g}; is this the right "
                "channel?"
            )
