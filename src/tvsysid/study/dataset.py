"""Results of a study as one dataset, which holds whatever its tasks measured."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable, Mapping, Sequence, Sized
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
AXES = ("scenario", "trial", "method_key"), ("recording", "bootstrap", "analysis")
"""Dimensions along which cases, draws and methods lie, of simulations and of experiments."""


def axes_of(results: xr.Dataset) -> tuple[str, str, str]:
    """Return the dimensions of results of either kind."""
    return next(axes for axes in AXES if axes[0] in results.dims)


def dataset_of(
    measured: Iterable[tuple[Task, Scores]],
    coordinates: Mapping[str, tuple[Any, Any]],
    rate: float,
    **settings: str,
) -> xr.Dataset:
    """Return the scores of a study as a dataset.

    Parameters
    ----------
    measured
        Tasks and their scores.
    coordinates
        Dimensions and values of coordinates by name, those of cases, draws and methods first.
    rate
        Sampling rate in Hz.
    settings
        Settings of the study, as an attribute beside the versions of the software.
    """
    cells = {
        (task.case, draw, method): {name: values[row, column] for name, values in scores.items()}
        for task, scores in measured
        for row, draw in enumerate(task.draws)
        for column, method in enumerate(task.methods)
    }
    axes = {axis: coordinates[axis][1] for axis in [*coordinates][:3]}
    results = labelled([cells.get(cell, {}) for cell in itertools.product(*axes.values())], axes)
    if "unit" not in results:
        texts = *results.failure.values.flat, *results.get("warnings", results.failure).values.flat
        raise InputError(f"run: no method gave a result. First reason: {next(filter(None, texts))}")
    units = results.unit.transpose("quantity", ...)
    # Draws without an estimate have an empty unit.
    known = [max(own.values.flat) or UNITS.get(str(own["quantity"].values), "") for own in units]
    time = "time", np.arange(results.sizes["time"]) / rate, {"units": "s"}
    results = results.drop_vars("unit").assign_coords(
        {**coordinates, "time": time, "unit": ("quantity", known)}
    )
    return results.assign_attrs(settings, versions=json.dumps(versions()))


def labelled(parts: Sequence[Scores], axes: Mapping[str, Sized]) -> xr.Dataset:
    """Return a dataset of scores: ``parts`` holds those of each combination, the last axis fastest.

    Arrays of a part have the axis time. A name such as ``"estimate quantity stiffness"`` holds
    variable, axis and label.
    """
    import xarray as xr  # noqa: PLC0415  # heavy

    variables = {}
    further: dict[str, dict[str, Scores]] = {"quantity": {name: {} for name in IMPEDANCE}}
    for name, values in stack(parts, *map(len, axes.values())).items():
        variable, *rest = name.split(" ", 2)
        if rest:
            axis, label = rest
            further.setdefault(axis, {}).setdefault(label, {})[variable] = values
        else:
            variables[variable] = [*axes, "time"][: values.ndim], values
    for axis, labels in further.items():
        for variable, values in stack([*labels.values()]).items():
            variables[variable] = [axis, *axes, "time"][: values.ndim], values
    coordinates = {axis: [*labels] for axis, labels in further.items()}
    return xr.Dataset(variables, coordinates).transpose(
        *axes, *further, "time", missing_dims="ignore"
    )


def write_results(results: xr.Dataset, folder: Path) -> None:
    """Write results to a folder; the file appears whole or not at all."""
    with whole_file(folder / RESULTS) as temporary:
        results.to_netcdf(temporary, engine="h5netcdf")


def read_results(folder: str | Path) -> xr.Dataset:
    """Return the results of a study of either kind from its folder.

    They are those of :func:`tvsysid.study.run`.

    Raises
    ------
    InputError
        If the folder has no results, because the study is not finished, or if the file is damaged.
    """
    import xarray as xr  # noqa: PLC0415  # heavy

    file = Path(folder) / RESULTS
    try:
        return xr.load_dataset(file, engine="h5netcdf")
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        raise InputError(
            f"{file}: this file is {'damaged' if file.exists() else 'missing'}. Give the folder of "
            "a study. If it is one, run its command again"
        ) from error
