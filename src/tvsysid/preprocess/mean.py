"""Subtract the mean over realizations, if the perturbation differs between them."""

from __future__ import annotations

from collections.abc import Iterable

import attrs
import numpy as np

from tvsysid.errors import InputError
from tvsysid.signals import Ensemble

# Changes from sample to sample: those of deviations from the mean, divided by those of the signal.
# Below, the deviations are noise (angle and channels) or rounding (torque).
MIN_DIFFERENCE, ROUNDING = 3e-3, 1e-9


def subtract_mean(ensemble: Ensemble, channels: Iterable[str] = ()) -> Ensemble:
    """Subtract the mean over realizations from angle and torque, and set ``mean_subtracted``.

    The mean does not respond to the perturbation. It holds the voluntary torque and imposed
    movements. The angle with its mean stays as ``recorded_angle``.

    Parameters
    ----------
    ensemble
        At least two realizations.
    channels
        Channels whose mean is subtracted too: those that act on angle or torque, such as a
        reference signal or the EMG that drives a reflex. A scheduling variable keeps its mean.

    Raises
    ------
    InputError
        For one realization, and for a signal that is the same in all realizations: its changes from
        sample to sample differ by less than 0.3 %. (With a perturbation of 0.5 degrees on a
        movement of 60 degrees, they differ by 8 %.)
    """
    if len(ensemble) < 2:
        raise InputError(
            f"subtract_mean: expected at least two realizations, got {ensemble!r}; record more, or "
            "cut the recording with a shorter period (--period) or less context (--context 0)"
        )
    deviations, same = {}, []
    for name in ("angle", "torque", *channels):
        values = ensemble.signal(name)
        deviations[name] = values - values.mean(axis=0)
        different, whole = (np.linalg.norm(np.diff(x)) for x in (deviations[name], values))
        if whole and different <= (ROUNDING if name == "torque" else MIN_DIFFERENCE) * whole:
            same.append(name)
    if same:
        raise InputError(
            f"subtract_mean: the {same[0]} is the same in all {len(ensemble)} realizations. "
            "Nothing but noise is left. Use a perturbation that differs between realizations: a "
            "multisine needs lines that are no multiples of 1/period."
        )
    angle = deviations.pop("angle")
    torque = deviations.pop("torque")
    return attrs.evolve(
        ensemble,
        angle=angle,
        torque=torque,
        channels={**ensemble.channels, **deviations},
        recorded_angle=ensemble.angle_as_recorded,
        mean_subtracted=True,
    )
