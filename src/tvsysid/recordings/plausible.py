"""What a file states against what the caller says of it, and signals that look lost: legal, but worth a warning."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from tvsysid.recordings.channel import Channel
from tvsysid.signals import Array, Recording

# ratio of a trial's size to that of the others from which on it is probably in another unit
UNLIKE = 10.0
AT_A_LEVEL = 0.02  # part of a signal's range that is counted to its lowest or highest level
MAX_ANGLE_RMS_RAD = 0.2
MAX_STANDSTILL_S = {"angle": 0.25, "torque": 0.08}  # of a signal that is recorded
SAME_RATE = 1e-3  # relative difference of rates that counts as none: files round them
SPELLINGS = {
    "rad": ("rad", "radian", "radians"),
    "deg": ("deg", "degree", "degrees", "°"),
    "Nm": ("nm", "newtonmeter", "newtonmeters", "newtonmetre", "newtonmetres"),
    "Nmm": (
        "nmm",
        "newtonmillimeter",
        "newtonmillimeters",
        "newtonmillimetre",
        "newtonmillimetres",
    ),
}


def contradictions(
    channels: Mapping[str, Channel], sampling_rate: float, units: Mapping[str, str]
) -> Iterator[str]:
    """Rates and units that a file states of the channels that are read, where the caller says others.

    Channels and the units of angle and torque are by name in the file.
    """
    for rate in sorted(
        {
            channel.sampling_rate
            for channel in channels.values()
            if channel.sampling_rate is not None
        }
    ):
        if abs(rate - sampling_rate) > SAME_RATE * sampling_rate:
            names = ", ".join(
                name for name, channel in channels.items() if channel.sampling_rate == rate
            )
            yield (
                f"the file states {rate:g} Hz for {names}, you gave {sampling_rate:g} Hz; check "
                "the rate"
            )
    for name, unit in units.items():
        told = channels[name].unit
        if told and re.sub(r"[\s·⋅.*\-_()\[\]]", "", told.lower()) not in SPELLINGS[unit]:
            yield (
                f"the file states the unit {told!r} for {name}, and is read in {unit}; convert "
                "it, or name its unit"
            )


def implausible(recording: Recording, angle: str, torque: str, angle_unit: str) -> Iterator[str]:
    """What looks wrong in the signals themselves.

    ``angle`` and ``torque`` are their names in the file.
    """
    with np.errstate(over="ignore"):  # of a damaged file's numbers
        size = float(np.std(recording.angle))
    if size > MAX_ANGLE_RMS_RAD:
        advice = (
            "if it is in degrees, give angle_unit='deg' (--angle-unit deg)"
            if angle_unit == "rad"
            else "are these degrees?"
        )
        yield f"{angle} has an RMS of {size:.3g} rad about its mean; {advice}"
    for name, values in recording.channels.items():
        if values.min() == values.max():
            yield (
                f"all {len(values)} values of channel {name} are {values[0]:g}; is this the "
                "right channel?"
            )
    # A joint may be held before and after it is moved; but a torque sensor always has noise.
    yield from _standstills(recording, angle, "angle")
    yield from _standstills(recording, torque, "torque")


def unlike_trials(recordings: Sequence[Recording], names: Sequence[str]) -> Iterator[str]:
    """Trials, each a recording, whose angle or torque is much larger or smaller than that of the others."""
    if len(recordings) < 3:
        return
    for what in ("angle", "torque"):
        sizes = np.array([np.std(recording.signal(what)) for recording in recordings])
        usual = float(np.median(sizes))
        for name, size in zip(names, sizes, strict=True):
            ratio = max(size / usual, usual / size) if size > 0 and usual > 0 else np.inf
            if ratio > UNLIKE:
                side = "large" if size > usual else "small"
                yield (
                    f"{name}: the {what} is {ratio:.3g} times as {side} as in most trials; is "
                    "it in another unit?"
                )


def _standstills(recording: Recording, name: str, which: str) -> Iterator[str]:
    """Where a signal keeps exactly one value for too long; the angle, only between other values."""
    for number, trial in enumerate(recording.trials):
        values = recording.signal(which)[trial]
        # Only standstills are looked at: all steps of a long signal would take several times its
        # memory.
        edges = np.concatenate([[0], np.flatnonzero(values[1:] != values[:-1]) + 1, [len(values)]])
        standing = np.flatnonzero(np.diff(edges) > 2)
        starts, lengths = edges[standing], edges[standing + 1] - edges[standing]
        seconds = lengths / recording.sampling_rate
        lost = seconds > MAX_STANDSTILL_S[which]
        if which == "angle":
            lost &= (starts > 0) & (starts + lengths < len(values))
            lost &= ~_held(values, values[starts], lost)
        places = np.flatnonzero(lost)
        if len(places):
            longest = places[np.argmax(lengths[places])]
            more = f", and {len(places) - 1} times more" if len(places) > 1 else ""
            yield (
                f"{name} stays at {values[starts[longest]]:g} for {seconds[longest]:.3g} s from "
                f"{recording.start + starts[longest] / recording.sampling_rate:.6g} s in trial "
                f"{number + 1} of "
                f"{len(recording.trials)}{more}; if the signal was lost there, cut that out"
            )


def _held(values: Array, levels: Array, lost: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which standstills are those of a perturbation that switches between two levels, such as a PRBS."""
    low, high, margin = values.min(), values.max(), AT_A_LEVEL * np.ptp(values)
    at_low, at_high = levels <= low + margin, levels >= high - margin
    two_levels = (lost & at_low).any() and (lost & at_high).any()
    return np.asarray((at_low | at_high) & two_levels)
