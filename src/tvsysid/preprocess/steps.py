"""What the steps of preprocessing share: durations that are checked, and one change of all signals."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypedDict

import numpy as np

from tvsysid.errors import InputError
from tvsysid.signals import Array, Ensemble, Recording


class Signals(TypedDict):
    """Signals as a recording or an ensemble takes them."""

    angle: Array
    torque: Array
    channels: dict[str, Array]


def every_signal(signals: Recording | Ensemble, change: Callable[[Array], Array]) -> Signals:
    """Angle, torque and channels, each changed alike."""
    channels = {name: change(values) for name, values in signals.channels.items()}
    return {"angle": change(signals.angle), "torque": change(signals.torque), "channels": channels}


def check_seconds(step: str, *, positive: bool = False, **durations: float) -> None:
    """Raise for durations that are not numbers of seconds, zero or more."""
    expected = "a positive number of seconds" if positive else "a number of seconds, zero or more"
    for name, seconds in durations.items():
        is_number = isinstance(seconds, (int, float, np.number)) and math.isfinite(seconds)
        if not is_number or seconds < 0 or (positive and seconds == 0):
            raise InputError(f"{step}: {name} must be {expected}, got {seconds!r}")
