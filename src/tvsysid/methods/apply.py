"""Run any method on an ensemble: check what it needs, and turn what it returns into a model."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple, Protocol

import attrs
import numpy as np

from tvsysid.errors import InputError
from tvsysid.estimates import IMPEDANCE, UNITS, Estimate, plain_array
from tvsysid.methods.base import Method, SkippedError, aligned, inputs_of, reason_to_skip
from tvsysid.methods.tuning.evidence import Evidence, Tuned
from tvsysid.models import Diagnostics, Model
from tvsysid.numerics.threads import single_thread
from tvsysid.signals import Array, Ensemble
from tvsysid.validators import settings_of

LONGEST_NAME = 80  # letters of a quantity, pathway or axis


class Identifies(Protocol):
    """What every method is: an object with one verb.

    It may also have ``inputs``, ``contiguous`` and ``skip(ensemble)``, as
    :class:`tvsysid.methods.Method` has.
    """

    def identify(self, ensemble: Ensemble) -> object:
        """Model with ``stiffness`` or ``estimates``, and ``predict(ensemble)`` or ``pathways(ensemble)``."""


def deviating_channels(methods: Iterable[object]) -> tuple[str, ...]:
    """Channels that lose their mean with the angle, because they act on the joint: references and inputs."""
    every = [item for method in methods for item in inputs_of(method)]
    found = dict.fromkeys(item.name for item in every if item.kind != "scheduling")
    if both := [item.name for item in every if item.kind == "scheduling" and item.name in found]:
        raise InputError(
            f"the channel {both[0]!r} is a scheduling variable, which keeps its mean, for one "
            "method, and for another "
            "an input or reference, which loses it; identify by one of them at a time, or read it "
            "under two names"
        )
    return tuple(found)


def apply(method: Identifies, ensemble: Ensemble, label: str | None = None) -> Model:
    """Identify realizations, mean subtracted, by any object with ``identify(ensemble)``.

    Gives what the method returned if that is a model of the package; else one with its estimates.
    ``label`` is the method and its settings in words; its ``repr`` by default.

    Raises
    ------
    InputError
        If the method cannot serve the ensemble, or what it returns is no model. The method's own
        errors pass.
    """
    label = repr(method) if label is None else label
    if reason := reason_to_skip(method, ensemble):
        raise InputError(f"{label}: {reason}")
    return _applied(method, ensemble, label)


def _applied(method: Identifies, ensemble: Ensemble, label: str) -> Model:
    """Model of an ensemble that the method can serve."""
    found = method.identify(ensemble)
    model = found if isinstance(found, Model) else _adopted(found, label, ensemble)
    _check_shapes(model, label, ensemble)
    return model


class Identified(NamedTuple):
    """A model, and the evidence for settings that were chosen from the data."""

    model: Model
    evidence: Evidence | None


def identify(
    method: Identifies, ensemble: Ensemble, label: str = "", *, tune: bool = False
) -> Identified:
    """Identify as :func:`apply`, on one thread. ``tune`` chooses the settings from the data first.

    Raises
    ------
    SkippedError
        If the method cannot serve the ensemble.
    InputError
        As :func:`apply`. The method's own errors pass.
    """
    with single_thread():
        if reason := reason_to_skip(method, ensemble):
            raise SkippedError(reason)
        chosen, evidence = _tuned(method, ensemble) if tune else (method, None)
        return Identified(_applied(chosen, ensemble, label or type(method).__name__), evidence)


def _tuned(method: object, ensemble: Ensemble) -> tuple[Method, Evidence | None]:
    """Return the method with settings chosen from the data, and the evidence for them."""
    own = method.method if isinstance(method, Tuned) else method
    if not isinstance(own, Method):
        raise InputError(
            "its settings cannot be chosen from data; leave out tune (--tune), and write "
            "key:tuned=true for those "
            "methods whose settings can"
        )
    return (
        own.tuned(ensemble) if settings_of(own) else (own, None)
    )  # a method without settings has none to choose


@attrs.frozen(eq=False, repr=False, kw_only=True)
class AdoptedModel(Model):
    """Model with the estimates and the torque of an object that a method returned (``found``)."""

    found: Any

    def _pathways(self, ensemble: Ensemble) -> dict[str, Array]:
        own = getattr(self.found, "pathways", None)
        torques = own(ensemble) if callable(own) else {"intrinsic": self.found.predict(ensemble)}
        return _checked_torques(torques, ensemble, self.method)


def _checked_torques(torques: object, ensemble: Ensemble, label: str) -> dict[str, Array]:
    """Return the torque of each pathway, if its shape and its numbers are right."""
    if not isinstance(torques, Mapping) or not torques:
        raise InputError(
            f"{label}: pathways(ensemble) must be a mapping of the torque of each pathway by its "
            "name, got "
            f"{type(torques).__name__ if torques else 'none'}"
        )
    whole = f"{label}: predict(ensemble) must be of shape (realization, time), here"
    shape = (len(ensemble), ensemble.samples)
    return {
        checked_name(name, label): _numbers(torque, shape, whole)
        for name, torque in torques.items()
    }


def _adopted(found: object, label: str, ensemble: Ensemble) -> AdoptedModel:
    """Model with the estimates of an object that a method returned."""
    for names in (("stiffness", "estimates"), ("predict", "pathways")):
        if not any(hasattr(found, name) for name in names):
            raise InputError(
                f"{label}: identify returned an object of type {type(found).__name__} without "
                f"{' or '.join(names)}"
            )
    own = getattr(found, "estimates", None)
    given = own if isinstance(own, Mapping) else _plain_attributes(found, label, ensemble.samples)
    estimates = {
        checked_name(name, label): _estimate(str(name), value, label)
        for name, value in given.items()
    }
    return AdoptedModel(
        method=label,
        sampling_rate=ensemble.sampling_rate,
        time=ensemble.time,
        estimates=estimates,
        coordinates={
            checked_name(name, label): plain_array(f"{label}: coordinates of {name}", each)
            for name, each in getattr(found, "coordinates", {}).items()
        },
        diagnostics=Diagnostics(parameters=math.nan, details=aligned(ensemble)),
        found=found,
    )


def _plain_attributes(found: object, label: str, count: int) -> dict[str, Array]:
    """Stiffness, viscosity and inertia given as attributes, each (time,).

    The last two may be single numbers.
    """
    given = {}
    for name in IMPEDANCE:
        value = plain_array(f"{label}: the model's {name}", getattr(found, name, np.nan))
        if name != "stiffness" and value.shape == ():
            value = np.broadcast_to(np.nan if value.item() is None else value, count)
        values = _numbers(value, (count,), f"{label}: the model's {name} must be of shape")
        if name == "stiffness" or not np.isnan(values).all():
            given[name] = values
    return given


def _numbers(given: object, shape: tuple[int, ...], expected: str) -> Array:
    """Real numbers of this shape; NaN among them, but nothing infinite."""
    what = expected.partition(" must")[0]
    values = plain_array(what, given)
    if values.shape != shape:
        raise InputError(f"{expected} {shape}, it is {values.shape}")
    if values.dtype.kind not in "fiu" or np.isinf(values).any():
        infinite = (
            ", some of them infinite; give NaN where nothing can be said"
            if values.dtype.kind == "f"
            else ""
        )
        raise InputError(
            f"{what}: expected real numbers, got values of type {values.dtype}{infinite}"
        )
    return np.array(values, dtype=np.float64)


def checked_name(name: object, label: str) -> str:
    """Name of a quantity, pathway or axis, if files and tables may have it."""
    text = str(name)
    if (
        not text.isprintable()
        or not 0 < len(text) <= LONGEST_NAME
        or not text[0].isalpha()
        or "/" in text
    ):
        raise InputError(
            f"{label}: expected names of 1 to {LONGEST_NAME} letters, the first a letter of the "
            "alphabet, and no "
            f"slash; got {text[: LONGEST_NAME + 1]!r}"
        )
    return text


def _estimate(name: str, value: object, label: str) -> Estimate:
    if isinstance(value, Estimate):
        return value
    try:
        return Estimate(value, UNITS.get(name, ""))  # type: ignore[arg-type]  # it says what it expected
    except InputError as error:
        raise InputError(f"{label}: {name}: {error}") from error


def _check_shapes(model: Model, label: str, ensemble: Ensemble) -> None:
    for name in (*model.estimates, *model.coordinates):
        checked_name(name, label)
    lengths = {"realization": len(ensemble), "time": ensemble.samples}
    lengths |= {name: len(values) for name, values in model.coordinates.items()}
    for name, estimate in model.estimates.items():
        if {"realization", "time"} <= set(estimate.axes) and estimate.axes[:2] != (
            "realization",
            "time",
        ):
            raise InputError(
                f"{label}: {name} is over {', '.join(estimate.axes)}; expected realization before "
                "time, first of all"
            )
        unknown = [axis for axis in estimate.axes if axis not in lengths]
        if unknown:
            raise InputError(
                f"{label}: {name} has the axis {unknown[0]!r}, for which the model has no "
                "coordinates; expected "
                f"coordinates={{{unknown[0]!r}: values}} beside its estimates"
            )
        expected = tuple(lengths[axis] for axis in estimate.axes)
        if estimate.values.shape != expected:
            raise InputError(
                f"{label}: {name} over {', '.join(estimate.axes)} must be of shape {expected}, it "
                "is "
                f"{estimate.values.shape}"
            )
