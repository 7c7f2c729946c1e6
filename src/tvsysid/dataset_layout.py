"""Lay a model out as a dataset: variables with names, axes and units."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

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
    **dict.fromkeys(("coherence", "rank"), "1"),
    **dict.fromkeys(("time", "lag", "reflex_lag"), "s"),
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
    variables: Variables = {}
    for name, estimate in model.estimates.items():
        parts, error = {"": estimate.values}, estimate.standard_error
        if error is not None:
            lower, upper = error.band_around(estimate.values, 0.95, simultaneous=False)
            parts |= {"_standard_error": error.values, "_lower": lower, "_upper": upper}
            variables[f"{name}_freedom"] = _variable(estimate.axes, error.freedom, None)
        for ending, values in parts.items():
            variables[name + ending] = _variable(estimate.axes, values, estimate.unit)
    further, coordinates = model._further_variables()
    if model.diagnostics.rank is not None:
        further["rank"] = ("time",), model.diagnostics.rank
    variables |= {name: _variable(*each, UNITS.get(name)) for name, each in further.items()}
    if ensemble is not None:
        for name, torque in model.pathways(ensemble).items():
            variables[f"torque_{name}"] = _variable(("realization", "time"), torque, "N m")
    along: Labelled = {name: ((name,), values) for name, values in model.coordinates.items()}
    along |= {"time": (("time",), model.time)} | coordinates
    return (
        variables,
        {name: _variable(*each, UNITS.get(name)) for name, each in along.items()},
        {
            "method": model.method,
            "sampling_rate_hz": model.sampling_rate,
            "effective_parameters": model.diagnostics.parameters,
            "seconds": model.diagnostics.seconds,
            "warnings": "\n".join(model.diagnostics.warnings),
            **model.diagnostics.details,
        },
    )


def _variable(axes: tuple[str, ...], values: ArrayLike, unit: str | None) -> Variable:
    return axes, np.asarray(values), {} if unit is None else {"units": unit}
