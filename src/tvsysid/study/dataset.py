"""Results of a study as one dataset, which holds whatever its tasks measured."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid.dataset_layout import UNITS
from tvsysid.errors import InputError
from tvsysid.models import IMPEDANCE
from tvsysid.recordings import whole_file
from tvsysid.study.measure import Scores, stack
from tvsysid.study.tasks import Task, versions

if TYPE_CHECKING:
    import xarray as xr

RESULTS = "results.nc"  # file of a study's results, in its folder
SIMULATIONS = "Simulation study of methods that identify joint impedance over time"
EXPERIMENT = "Experimental study of methods that identify joint impedance over time"
AXES = ("scenario", "trial", "method_key"), ("recording", "bootstrap", "analysis")
"""Dimensions along which cases, draws and methods lie, of simulations and of experiments."""


def axes_of(results: xr.Dataset) -> tuple[str, str, str]:
    """Return the dimensions of results of either kind."""
    return next(axes for axes in AXES if axes[0] in results.dims)


def dataset_of(
    measured: Iterable[tuple[Task, Scores]],
    coordinates: Mapping[str, tuple[Any, Any]],
    period: float,
    rate: float,
    **attributes: str,
) -> xr.Dataset:
    """Return the scores of a study as a dataset.

    Parameters
    ----------
    measured
        Tasks and their scores.
    coordinates
        Dimensions and values of coordinates by name, those of cases, draws and methods first.
    period, rate
        Duration of a realization in s, and sampling rate in Hz.
    attributes
        Title and settings, to which versions of the software are added.
    """
    cells = {
        (task.case, draw, method): {name: values[row, column] for name, values in scores.items()}
        for task, scores in measured
        for row, draw in enumerate(task.draws)
        for column, method in enumerate(task.methods)
    }
    axes = [*coordinates][:3]
    labels = [coordinates[axis][1] for axis in axes]
    scores = stack([cells.get(place, {}) for place in itertools.product(*labels)])
    shape = tuple(map(len, labels))
    results = labelled(
        {name: each.reshape(*shape, *each.shape[1:]) for name, each in scores.items()}, axes
    )
    if "unit" not in results:
        texts = results.failure, results.get("warnings", results.failure)
        reasons = (reason for each in texts for reason in each.values.flat)
        raise InputError(f"run: no method gave a result; the first: {next(filter(None, reasons))}")
    # Draws without an estimate have an empty unit.
    units = {name: max(own.values.flat) for name, own in results.unit.groupby("quantity")}
    further = {
        "time": ("time", np.arange(round(period * rate)) / rate, {"units": "s"}),
        "unit": (
            "quantity",
            [units[name] or UNITS.get(name, "") for name in results["quantity"].values],
        ),
    }
    results = results.drop_vars("unit").assign_coords({**coordinates, **further})
    return results.assign_attrs(attributes, versions=json.dumps(versions()))


def labelled(scores: Scores, axes: Sequence[str]) -> xr.Dataset:
    """Return scores over these axes, and further over time, as a dataset.

    ``"estimate quantity stiffness"`` becomes the variable estimate at stiffness along quantity.
    """
    import xarray as xr  # noqa: PLC0415  # heavy

    variables = {}
    places: dict[str, dict[str, Scores]] = {"quantity": {name: {} for name in IMPEDANCE}}
    for name, values in scores.items():
        variable, *place = name.split(" ", 2)
        if place:
            axis, label = place
            places.setdefault(axis, {}).setdefault(label, {})[variable] = values
        else:
            variables[variable] = [*axes, "time"][: values.ndim], values
    for axis, parts in places.items():
        for variable, values in stack([*parts.values()]).items():
            variables[variable] = [axis, *axes, "time"][: values.ndim], values
    labels = {axis: [*parts] for axis, parts in places.items()}
    return xr.Dataset(variables, labels).transpose(*axes, *places, "time", missing_dims="ignore")


def write_results(results: xr.Dataset, folder: Path) -> None:
    """Write results to a folder; the file appears whole or not at all."""
    with whole_file(folder / RESULTS) as temporary:
        results.to_netcdf(temporary, engine="h5netcdf")


def read_results(folder: str | Path) -> xr.Dataset:
    """Return the results of a study of either kind from its folder.

    They are those of :func:`tvsysid.study.run`; the attribute ``title`` says of which kind.

    Raises
    ------
    InputError
        If the folder has no results, because the study is not finished or the folder is none of a
        study, or if the file is damaged.
    """
    import xarray as xr  # noqa: PLC0415  # heavy

    file = Path(folder) / RESULTS
    try:
        results = xr.load_dataset(file, engine="h5netcdf")
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        raise InputError(
            f"{file}: this file is {'damaged' if file.exists() else 'missing'}. Give the folder of "
            "a study. If it is one, run its command again"
        ) from error
    if results.attrs.get("title") not in (SIMULATIONS, EXPERIMENT):
        raise InputError(f"{file}: these are no results of a study by tvsysid")
    return results
