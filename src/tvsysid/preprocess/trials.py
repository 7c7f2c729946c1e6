"""Apply one function to every signal of a recording, trial by trial, or of an ensemble."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import attrs
import numpy as np

from tvsysid.signals import Array, Ensemble, Recording


def map_signals(signals: Recording | Ensemble, change: Callable[[Array], Array]) -> dict[str, Any]:
    """Return angle, torque, channels and recorded angle after the same change.

    The recorded angle has one axis more than the others.
    """
    recorded = signals.recorded_angle
    return {
        "angle": change(signals.angle),
        "torque": change(signals.torque),
        "channels": {name: change(values) for name, values in signals.channels.items()},
        "recorded_angle": None if recorded is None else change(recorded),
    }


def map_trials(
    recording: Recording, change: Callable[[Array], Array], **attributes: Any
) -> Recording:
    """Return a recording after the same change to every signal of each trial.

    Parameters
    ----------
    change
        Function of the samples of one trial. It may change their number.
    attributes
        Further attributes of the new recording.
    """
    lengths: list[int] = []

    def change_all(values: Array) -> Array:
        changed = [change(values[trial]) for trial in recording.trials]
        lengths[:] = map(len, changed)
        return np.concatenate(changed)

    signals = map_signals(recording, change_all)
    starts = (0, *np.cumsum(lengths[:-1]).tolist())
    return attrs.evolve(recording, **signals | {"trial_starts": starts} | attributes)


def shortest_trial(recording: Recording) -> int:
    """Return the number of samples of the shortest trial."""
    return min(int(trial.stop - trial.start) for trial in recording.trials)
