"""Results of a study as one dataset, which is whatever its tasks measured."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tvsysid.dataset_layout import UNITS
from tvsysid.errors import InputError
from tvsysid.models import IMPEDANCE
from tvsysid.recordings import whole_file
from tvsysid.study.measure import Scores, stack
from tvsysid.study.tasks import versions

if TYPE_CHECKING:
    import xarray as xr

RESULTS = "results.nc"  # file of a study's results, in its folder
SIMULATIONS = "Simulation study of methods that identify joint impedance over time"
EXPERIMENT = "Experimental study of methods that identify joint impedance over time"
VARIABLES: dict[str, tuple[tuple[str, ...], str, str]] = {
    "truth": (("quantity", "time"), "true value, in the unit of its quantity", "unit"),
    "estimate": (("quantity", "time"), "estimate, in the unit of its quantity", "unit"),
    "standard_error": (("quantity", "time"), "standard error of the estimate", "unit"),
    "covered": (("quantity", "time"), "whether the 95 % band of the estimate holds the truth", "1"),
    "time_varying_vaf": (
        ("time",),
        "variance of the torque accounted for at each time",
        "percent",
    ),
    "vaf": (("statistic",), "variance of the torque accounted for, over realizations", "percent"),
    "bandpassed_vaf": (("statistic",), "the same after a band-pass from 1 to 10 Hz", "percent"),
    "pathway_vaf": (
        ("pathway", "statistic"),
        "variance of each pathway's noiseless torque accounted for",
        "percent",
    ),
    "pathway_torque": (
        ("pathway", "time"),
        "root mean square over realizations of each pathway's predicted torque at each time",
        "N m",
    ),
    "scheduled_estimate": (
        ("scheduled", "scheduling"),
        "estimate over a measured variable",
        "unit",
    ),
    "scheduled_standard_error": (("scheduled", "scheduling"), "its standard error", "unit"),
    "scheduling_variable": (("scheduled", "scheduling"), "values of the variable", "unit"),
    "parameters": ((), "effective number of parameters", "1"),
    "seconds": ((), "time of the identification", "s"),
    "stage_seconds": (("stage",), "time of the rest of a trial", "s"),
    "warnings": ((), "warnings of the method", ""),
    "failure": ((), "why the method gave no result", ""),
}
"""Dimensions, meaning and unit of each variable. The first dimension may be that of the labels."""


def dataset_of(
    scores: Sequence[Scores],
    places: Mapping[str, Sequence[Any]],
    rows: Mapping[str, Sequence[Any]],
    others: Mapping[str, Sequence[Any]],
    *,
    period: float,
    rate: float,
) -> xr.Dataset:
    """Return the scores of all tasks as a dataset.

    Parameters
    ----------
    scores
        Scores of the tasks, one for each combination of the places.
    places
        Coordinates of the dimensions over which the tasks lie.
    rows
        Coordinates of the dimension within a task: its methods, or its draws.
    others
        Coordinates of further dimensions.
    period, rate
        Duration of a realization in s, and sampling rate in Hz.
    """
    import xarray as xr  # noqa: PLC0415  # heavy

    lengths = [len(values) for values in places.values()]
    found: dict[str, dict[str, NDArray[Any]]] = {}
    for key, values in stack(scores).items():
        name, _, label = key.partition("/")
        found.setdefault(name, {})[label] = values.reshape(*lengths, *values.shape[1:])
    labels: dict[str, dict[str, None]] = {"quantity": dict.fromkeys(IMPEDANCE)}
    for name, (dims, _, _) in VARIABLES.items():
        if "" not in found.get(name, {"": None}):
            labels.setdefault(dims[0], {}).update(dict.fromkeys(found[name]))
    variables = {}
    for name, (dims, meaning, unit) in VARIABLES.items():
        if name not in found:
            continue
        parts = found[name]
        if "" in parts:
            values = parts[""]
        else:
            beside = [{name: parts[each]} if each in parts else {} for each in labels[dims[0]]]
            values = np.moveaxis(stack(beside)[name], 0, -len(dims))
        is_of_rows = values.ndim > len(places) + len(dims)
        variables[name] = (
            (*places, *(rows if is_of_rows else ()), *dims),
            values,
            {"long_name": meaning} | ({"units": unit} if unit else {}),
        )
    units = UNITS | {name: max(map(str, each.flat)) for name, each in found.get("unit", {}).items()}
    time = {"units": "s", "long_name": f"time within a realization of {period:g} s"}
    return xr.Dataset(
        variables,
        coords={
            **{name: list(each) for name, each in {**places, **rows, **others, **labels}.items()},
            "unit": ("quantity", [units.get(name, "") for name in labels["quantity"]]),
            "time": ("time", np.arange(round(period * rate)) / rate, time),
        },
    )


def complete(results: xr.Dataset, title: str, **settings: str) -> xr.Dataset:
    """Return results with a title, settings, versions of the software, and the machine."""
    machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    return results.assign_attrs(
        title=title, **settings, versions=json.dumps(versions()), machine=machine
    )


def write_results(results: xr.Dataset, folder: Path) -> None:
    """Write results to a folder; the file appears whole or not at all."""
    encoding = {
        name: {"fletcher32": True}  # a checksum, so that a damaged file is noticed
        for name, variable in results.variables.items()
        if variable.dtype.kind == "f" and variable.size
    }
    with whole_file(folder / RESULTS) as temporary:
        results.to_netcdf(temporary, engine="h5netcdf", encoding=encoding)


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
    if not file.is_file():
        raise InputError(
            f"{file}: there is no such file. Give the folder of a study. If the study was "
            "interrupted, run its command again to finish it"
        )
    try:
        results = xr.load_dataset(file, engine="h5netcdf")
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        raise InputError(
            f"{file}: this file is damaged. Run the command of the study again to make it anew"
        ) from error
    if results.attrs.get("title") not in (SIMULATIONS, EXPERIMENT):
        raise InputError(f"{file}: these are no results of a study by tvsysid")
    return results
