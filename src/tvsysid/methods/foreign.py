"""Models of other people's methods."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.models import Diagnostics, Model
from tvsysid.signals import Ensemble

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class ForeignModel(Model):
    """What a method of other people found, with NaN for what it does not say.

    Parameters
    ----------
    found
        Its own model.
    """

    found: Any

    def _predict(self, ensemble: Ensemble) -> Array:
        predicted = np.asarray(self.found.predict(ensemble), dtype=np.float64)
        if predicted.shape != (len(ensemble), ensemble.samples):
            raise InputError(
                f"{self.method}: predict(ensemble) must be of shape (realization, time), here ({len(ensemble)}, "
                f"{ensemble.samples}), it is {predicted.shape}"
            )
        return predicted

    def _given_band(self, name: str, level: float) -> tuple[Array, Array] | None:
        own = getattr(self.found, name, None)
        if not callable(own):
            return None
        edges = np.asarray(own(level), dtype=np.float64)
        if edges.shape != (2, len(self.time)):
            raise InputError(
                f"{self.method}: {name}(level) must be a lower and an upper edge of shape ({len(self.time)},) each, it "
                f"is of shape {edges.shape}"
            )
        return edges[0], edges[1]


def adopted(found: Any, label: str, ensemble: Ensemble) -> Model:
    """Model of the package from what a method found.

    Parameters
    ----------
    found
        A model of the package, which is returned as it is, or anything with ``stiffness`` and ``predict(ensemble)``.
    label
        The method and its settings, in words.
    ensemble
        That it was identified from.

    Raises
    ------
    InputError
        If it has no ``stiffness`` or ``predict``, or its stiffness is not one number for each time.
    """
    if isinstance(found, Model):
        return found
    for name in ("stiffness", "predict"):
        if not hasattr(found, name):
            raise InputError(f"{label}: identify returned an object of type {type(found).__name__} without {name}")
    count = ensemble.samples
    stiffness = np.array(found.stiffness, dtype=np.float64)
    if stiffness.shape != (count,):
        raise InputError(f"{label}: the model's stiffness must be of shape ({count},), it is {stiffness.shape}")

    def optional(name: str) -> Array:
        values = np.array(getattr(found, name, np.nan), dtype=np.float64)
        return np.array(np.broadcast_to(values, count)) if values.shape in ((), (count,)) else np.full(count, np.nan)

    return ForeignModel(
        method=label,
        sampling_rate=ensemble.sampling_rate,
        time=ensemble.time,
        stiffness=stiffness,
        viscosity=optional("viscosity"),
        inertia=optional("inertia"),
        diagnostics=Diagnostics(parameters=math.nan),
        found=found,
    )
