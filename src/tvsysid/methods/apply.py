"""Run anybody's method on an ensemble: what it needs is checked before, what it returns becomes a model."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tvsysid.errors import InputError
from tvsysid.estimates import IMPEDANCE, UNITS, Estimate
from tvsysid.methods.base import inputs_of, reason_to_skip
from tvsysid.models import Diagnostics, Model
from tvsysid.signals import Array, Ensemble


class Identifies(Protocol):
    """What every method is: an object with one verb.

    It may also have ``inputs``, ``contiguous`` and ``skip(ensemble)``, as :class:`tvsysid.methods.Method` has.
    """

    def identify(self, ensemble: Ensemble) -> object:
        """Model with ``stiffness`` or ``estimates``, and ``predict(ensemble)`` or ``pathways(ensemble)``."""


def deviating_channels(methods: Iterable[object]) -> tuple[str, ...]:
    """Channels that lose their mean with the angle, because they act on the joint: references and inputs."""
    every = [item for method in methods for item in inputs_of(method)]
    found = dict.fromkeys(item.name for item in every if item.kind != "scheduling")
    if both := [item.name for item in every if item.kind == "scheduling" and item.name in found]:
        raise InputError(
            f"the channel {both[0]!r} is a scheduling variable, which keeps its mean, for one method, and for another "
            "an input or reference, which loses it; identify by one of them at a time, or read it under two names"
        )
    return tuple(found)


def apply(method: Identifies, ensemble: Ensemble, label: str | None = None) -> Model:
    """Identify realizations, mean subtracted, by any object with ``identify(ensemble)``.

    Gives what the method returned if that is a model of the package; else one with its estimates. ``label`` is the
    method and its settings in words; its ``repr`` by default.

    Raises
    ------
    InputError
        If the method cannot serve the ensemble, or what it returns is no model. The method's own errors pass.
    """
    label = repr(method) if label is None else label
    if reason := reason_to_skip(method, ensemble):
        raise InputError(f"{label}: {reason}")
    found = method.identify(ensemble)
    model = found if isinstance(found, Model) else _adopted(found, label, ensemble)
    _check_shapes(model, label, ensemble)
    return model


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class AdoptedModel(Model):
    """Model of a method that has ``found`` one of its own."""

    found: object

    def _pathways(self, ensemble: Ensemble) -> dict[str, Array]:
        own = getattr(self.found, "pathways", None)
        torques = own(ensemble) if callable(own) else {"intrinsic": self.found.predict(ensemble)}  # type: ignore[attr-defined]
        return {str(name): self._checked(torque, ensemble) for name, torque in torques.items()}

    def _checked(self, torque: object, ensemble: Ensemble) -> Array:
        predicted = np.asarray(torque, dtype=np.float64)
        if predicted.shape != (len(ensemble), ensemble.samples):
            raise InputError(
                f"{self.method}: predict(ensemble) must be of shape (realization, time), here ({len(ensemble)}, "
                f"{ensemble.samples}), it is {predicted.shape}"
            )
        return predicted


def _adopted(found: object, label: str, ensemble: Ensemble) -> AdoptedModel:
    """Model with the estimates of an object that a method returned."""
    for names in (("stiffness", "estimates"), ("predict", "pathways")):
        if not any(hasattr(found, name) for name in names):
            raise InputError(
                f"{label}: identify returned an object of type {type(found).__name__} without {' or '.join(names)}"
            )
    own = getattr(found, "estimates", None)
    given = own if isinstance(own, Mapping) else _plain_attributes(found, label, ensemble.samples)
    estimates = {str(name): _estimate(str(name), value, label) for name, value in given.items()}
    coordinates = {name: np.asarray(each) for name, each in getattr(found, "coordinates", {}).items()}
    return AdoptedModel(
        method=label,
        sampling_rate=ensemble.sampling_rate,
        time=ensemble.time,
        estimates=estimates,
        coordinates=coordinates,
        diagnostics=Diagnostics(parameters=math.nan),
        found=found,
    )


def _plain_attributes(found: object, label: str, count: int) -> dict[str, Array]:
    """Stiffness, viscosity and inertia given as attributes, each (time,); the last two may be single numbers."""
    stiffness = np.array(getattr(found, "stiffness", np.nan), dtype=np.float64)
    if stiffness.shape != (count,):
        raise InputError(f"{label}: the model's stiffness must be of shape ({count},), it is {stiffness.shape}")
    given = {"stiffness": stiffness}
    for name in IMPEDANCE[1:]:
        values = np.array(getattr(found, name, np.nan), dtype=np.float64)
        if np.isfinite(values).any() and values.shape in ((), (count,)):
            given[name] = np.array(np.broadcast_to(values, count))
    return given


def _estimate(name: str, value: object, label: str) -> Estimate:
    if isinstance(value, Estimate):
        return value
    try:
        return Estimate(np.asarray(value), UNITS.get(name, ""))
    except InputError as error:
        raise InputError(f"{label}: {name}: {error}") from error


def _check_shapes(model: Model, label: str, ensemble: Ensemble) -> None:
    lengths = {"realization": len(ensemble), "time": ensemble.samples}
    lengths |= {name: len(values) for name, values in model.coordinates.items()}
    for name, estimate in model.estimates.items():
        if {"realization", "time"} <= set(estimate.axes) and estimate.axes[:2] != ("realization", "time"):
            raise InputError(
                f"{label}: {name} is over {', '.join(estimate.axes)}; expected realization before time, first of all"
            )
        unknown = [axis for axis in estimate.axes if axis not in lengths]
        if unknown:
            raise InputError(
                f"{label}: {name} has the axis {unknown[0]!r}, for which the model has no coordinates; expected "
                f"coordinates={{{unknown[0]!r}: values}} beside its estimates"
            )
        expected = tuple(lengths[axis] for axis in estimate.axes)
        if estimate.values.shape != expected:
            raise InputError(
                f"{label}: {name} over {', '.join(estimate.axes)} must be of shape {expected}, it is "
                f"{estimate.values.shape}"
            )
