"""Lay a model out as a dataset: variables with names, axes and units."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tvsysid.errors import InputError

if TYPE_CHECKING:
    import xarray as xr

    from tvsysid.models import Model
    from tvsysid.signals import Ensemble

UNITS = {
    "stiffness": "N m/rad",
    "viscosity": "N m s/rad",
    "inertia": "kg m2",
    "reflex_gain": "N m s/rad",
    "impulse_response": "N m/rad/s",
    "reflex_response": "N m/rad",
    "frequency_response": "N m/rad",
    **dict.fromkeys(("coherence", "rank", "instrument_strength"), "1"),
    **dict.fromkeys(("time", "lag", "reflex_lag"), "s"),
    **dict.fromkeys(("velocity", "nonlinearity"), "rad/s"),
    "frequency": "Hz",
}
"""Units of the quantities that the package estimates or simulates."""

Labelled = dict[str, tuple[tuple[str, ...], ArrayLike]]  # axes and values, by name
Variable = tuple[tuple[str, ...], NDArray[Any], dict[str, str]]  # axes, values, attributes
Variables = dict[str, Variable]


def to_dataset(model: Model, ensemble: Ensemble | None) -> xr.Dataset:
    """Return the dataset of :meth:`tvsysid.Model.to_xarray`."""
    import xarray as xr  # noqa: PLC0415  # heavy

    return xr.Dataset(*layout(model, ensemble))


def layout(model: Model, ensemble: Ensemble | None) -> tuple[Variables, Variables, dict[str, Any]]:
    """Return the variables, coordinates and attributes of a model's dataset."""
    rows: list[tuple[str, tuple[str, ...], ArrayLike, str | None]] = []
    for name, estimate in model.estimates.items():
        axes, unit = estimate.axes, estimate.unit
        rows.append((name, axes, estimate.values, unit))
        if (error := estimate.standard_error) is not None:
            lower, upper = error.limits(estimate.values, 0.95)
            rows += [
                (f"{name}_standard_error", axes, error.values, unit),
                (f"{name}_freedom", axes, error.freedom, None),
                (f"{name}_lower", axes, lower, unit),
                (f"{name}_upper", axes, upper, unit),
            ]
    further, further_coordinates = model._identified()
    for name, each in (
        ("rank", model.diagnostics.rank),
        ("instrument_strength", model.diagnostics.strength),
    ):
        if each is not None:
            rows.append((name, ("time",), each, UNITS[name]))
    rows += [(name, *each, UNITS.get(name)) for name, each in further.items()]
    if ensemble is not None:
        rows += [
            (f"torque_{name}", ("realization", "time"), torque, "N m")
            for name, torque in model.pathways(ensemble).items()
        ]
    coordinates: Labelled = {"time": (("time",), model.time)} | {
        name: ((name,), values) for name, values in model.coordinates.items()
    }
    coordinates |= further_coordinates
    (name, count), *_ = Counter([*(row[0] for row in rows), *coordinates]).most_common(1)
    if count > 1:
        raise InputError(
            f"to_xarray: two variables have the name {name!r}; give the estimate another name"
        )
    return (
        {name: _with_unit(axes, values, unit) for name, axes, values, unit in rows},
        {name: _with_unit(*each, UNITS.get(name)) for name, each in coordinates.items()},
        {
            "method": model.method,
            "sampling_rate_hz": model.sampling_rate,
            "effective_parameters": model.diagnostics.parameters,
            "seconds": model.diagnostics.seconds,
            "warnings": "\n".join(model.diagnostics.warnings),
            **model.diagnostics.details,
        },
    )


def _with_unit(
    axes: tuple[str, ...], values: ArrayLike, unit: str | None
) -> tuple[tuple[str, ...], NDArray[Any], dict[str, str]]:
    return axes, np.asarray(values), {} if unit is None else {"units": unit}
