"""Warnings at reading: what a file states otherwise than the caller, and signals that look lost."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from tvsysid.recordings.channel import Channel
from tvsysid.recordings.reading import Reading
from tvsysid.signals import Array, Recording

MAX_ANGLE_RMS_RAD = 0.2  # about the mean; more is probably in degrees
MAX_STANDSTILL_S = {"angle": 0.25, "torque": 0.08}
MAX_SIZE_RATIO = 10.0  # of a trial's RMS to that of most; more is probably another unit
LEVEL_SHARE = 0.02  # of a signal's range: values so close to its lowest or highest are at a level
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
    """Yield sentences on what a file states otherwise than the caller, and on odd signals.

    Channels are those that were read, by their names in the file.
    """
    given = recording.sampling_rate
    for rate in sorted({each.sampling_rate for each in channels.values() if each.sampling_rate}):
        if abs(rate - given) > RATE_TOLERANCE * given:
            names = ", ".join(name for name in channels if channels[name].sampling_rate == rate)
            yield f"the file states {rate:g} Hz for {names}, you gave {given:g} Hz; check the rate"
    units = (reading.angle_unit, reading.torque_unit)
    for name, unit in zip(reading.names[:2], units, strict=True):
        stated = channels[name].unit
        plain = re.sub(r"[\s·⋅.*\-_()\[\]]", "", stated.lower())
        if stated and not re.fullmatch(UNIT_SPELLINGS[unit], plain):
            yield (
                f"the file states the unit {stated!r} for {name}, and is read in {unit}; convert "
                "it, or name its unit"
            )
    size = float(np.std(recording.angle))
    if size > MAX_ANGLE_RMS_RAD:
        remedy = (
            "if it is in degrees, give angle_unit='deg' (--angle-unit deg)"
            if reading.angle_unit == "rad"
            else "are these degrees?"
        )
        yield f"{reading.angle} has an RMS of {size:.3g} rad about its mean; {remedy}"
    for name, values in recording.channels.items():
        if values.min() == values.max():
            yield (
                f"all {len(values)} values of channel {name} are {values[0]:g}; is this the right "
                "channel?"
            )
    for which, name in zip(("angle", "torque"), reading.names, strict=False):
        for number, trial in enumerate(recording.trials, start=1):
            values = recording.signal(which)[trial]
            starts, lengths = _standstills(values, which, recording.sampling_rate)
            if len(starts):
                longest = np.argmax(lengths)
                first = starts[longest]
                more = f", and {len(starts) - 1} times more" if len(starts) > 1 else ""
                yield (
                    f"{name} stays at {values[first]:g} for "
                    f"{lengths[longest] / recording.sampling_rate:.3g} s from "
                    f"{recording.start + first / recording.sampling_rate:.6g} s in trial {number} "
                    f"of {len(recording.trials)}{more}; if the signal was lost there, cut that out"
                )


def _standstills(
    values: Array, which: str, sampling_rate: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return first samples and lengths of stretches where a signal keeps one value for too long.

    A joint may be held before and after it is moved, or between two levels, as by a PRBS; a torque
    sensor always has noise.
    """
    edges = np.flatnonzero(np.r_[True, values[1:] != values[:-1], True])
    starts, lengths = edges[:-1], np.diff(edges)
    is_lost = lengths > MAX_STANDSTILL_S[which] * sampling_rate
    if which == "angle":
        is_lost &= (starts > 0) & (edges[1:] < len(values))
        margin = LEVEL_SHARE * np.ptp(values)
        is_low = values[starts] <= values.min() + margin
        is_high = values[starts] >= values.max() - margin
        if (is_lost & is_low).any() and (is_lost & is_high).any():
            is_lost &= ~(is_low | is_high)
    return starts[is_lost], lengths[is_lost]


def unlike_trials(recordings: Mapping[str, Recording]) -> Iterator[tuple[str, str]]:
    """Yield trials whose angle or torque is much larger or smaller than in most, and a sentence."""
    for what in ("angle", "torque") if len(recordings) > 2 else ():
        sizes = {name: float(np.std(each.signal(what))) for name, each in recordings.items()}
        usual = float(np.median([*sizes.values()]))
        for name, size in sizes.items():
            ratio = max(size, usual) / min(size, usual)
            if ratio > MAX_SIZE_RATIO:
                side = "large" if size > usual else "small"
                yield (
                    name,
                    (
                        f"the {what} is {ratio:.3g} times as {side} as in most trials; is it in "
                        "another unit?"
                    ),
                )
