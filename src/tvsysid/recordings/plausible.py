"""Warnings at reading: what a file states otherwise than the caller, and signals that look lost."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from tvsysid.recordings.channel import Channel
from tvsysid.signals import Recording

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


def contradictions(
    channels: Mapping[str, Channel], sampling_rate: float, units: Mapping[str, str]
) -> Iterator[str]:
    """Yield sentences on rates and units that a file states otherwise than the caller.

    Channels and the units of angle and torque are by name in the file.
    """
    for rate in sorted({each.sampling_rate for each in channels.values() if each.sampling_rate}):
        if abs(rate - sampling_rate) > RATE_TOLERANCE * sampling_rate:
            names = ", ".join(name for name in channels if channels[name].sampling_rate == rate)
            yield (
                f"the file states {rate:g} Hz for {names}, you gave {sampling_rate:g} Hz; check "
                "the rate"
            )
    for name, unit in units.items():
        stated = channels[name].unit
        plain = re.sub(r"[\s·⋅.*\-_()\[\]]", "", stated.lower())
        if stated and not re.fullmatch(UNIT_SPELLINGS[unit], plain):
            yield (
                f"the file states the unit {stated!r} for {name}, and is read in {unit}; convert "
                "it, or name its unit"
            )


def implausible(recording: Recording, angle: str, torque: str, angle_unit: str) -> Iterator[str]:
    """Yield sentences on signals that look wrong, by their names in the file."""
    with np.errstate(over="ignore"):  # of a damaged file's numbers
        size = float(np.std(recording.angle))
    if size > MAX_ANGLE_RMS_RAD:
        is_rad = angle_unit == "rad"
        advice = "if it is in degrees, give angle_unit='deg' (--angle-unit deg)"
        yield (
            f"{angle} has an RMS of {size:.3g} rad about its mean; "
            f"{advice if is_rad else 'are these degrees?'}"
        )
    for name, values in recording.channels.items():
        if values.min() == values.max():
            yield (
                f"all {len(values)} values of channel {name} are {values[0]:g}; is this the "
                "right channel?"
            )
    yield from _standstills(recording, angle, "angle")
    yield from _standstills(recording, torque, "torque")


def unlike_trials(recordings: Sequence[Recording], names: Sequence[str]) -> Iterator[str]:
    """Yield sentences on trials whose angle or torque is much larger or smaller than in most."""
    if len(recordings) < 3:
        return
    for what in ("angle", "torque"):
        sizes = np.array([np.std(recording.signal(what)) for recording in recordings])
        usual = float(np.median(sizes))
        for name, size in zip(names, sizes, strict=True):
            ratio = max(size / usual, usual / size) if size > 0 and usual > 0 else np.inf
            if ratio > MAX_SIZE_RATIO:
                side = "large" if size > usual else "small"
                yield (
                    f"{name}: the {what} is {ratio:.3g} times as {side} as in most trials; is "
                    "it in another unit?"
                )


def _standstills(recording: Recording, name: str, which: str) -> Iterator[str]:
    """Yield a sentence for each trial in which a signal keeps exactly one value for too long.

    A joint may be held before and after it is moved, or between two levels, as by a PRBS; a torque
    sensor always has noise.
    """
    trials = recording.trials
    for number, trial in enumerate(trials):
        values = recording.signal(which)[trial]
        edges = np.concatenate([[0], np.flatnonzero(values[1:] != values[:-1]) + 1, [len(values)]])
        starts, lengths = edges[:-1], np.diff(edges)
        seconds = lengths / recording.sampling_rate
        is_lost = seconds > MAX_STANDSTILL_S[which]
        if which == "angle":
            is_lost &= (starts > 0) & (starts + lengths < len(values))
            low, high, margin = values.min(), values.max(), LEVEL_SHARE * np.ptp(values)
            at_low, at_high = values[starts] <= low + margin, values[starts] >= high - margin
            if (is_lost & at_low).any() and (is_lost & at_high).any():
                is_lost &= ~(at_low | at_high)
        places = np.flatnonzero(is_lost)
        if len(places):
            longest = places[np.argmax(lengths[places])]
            more = f", and {len(places) - 1} times more" if len(places) > 1 else ""
            yield (
                f"{name} stays at {values[starts[longest]]:g} for {seconds[longest]:.3g} s from "
                f"{recording.start + starts[longest] / recording.sampling_rate:.6g} s in trial "
                f"{number + 1} of {len(trials)}{more}; if the signal was lost there, cut that out"
            )
