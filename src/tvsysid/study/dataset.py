"""Results of a study as one dataset, which is whatever its tasks measured."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tvsysid.dataset_layout import UNITS
from tvsysid.errors import InputError
from tvsysid.models import IMPEDANCE
from tvsysid.recordings import whole_file
from tvsysid.study.measure import STATISTICS, Rows, place
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
    "other_seconds": ((), "time of simulating, preparing and scoring a draw", "s"),
    "warnings": ((), "warnings of the method", ""),
    "failure": ((), "why the method gave no result", ""),
}
"""Dimensions, meaning and unit of each variable. The first dimension may be that of the labels."""


class Axes(NamedTuple):
    """Names of the dimensions along which cases, draws and methods lie."""

    case: str
    draw: str
    method: str


AXES = (Axes("scenario", "trial", "method_key"), Axes("recording", "bootstrap", "analysis"))


def axes_of(results: xr.Dataset) -> Axes:
    """Return the dimensions of results of either kind."""
    return next(axes for axes in AXES if axes.case in results.dims)


def dataset_of(
    coordinates: Mapping[str, Sequence[Any]],
    rows: Rows,
    period: float,
    rate: float,
) -> xr.Dataset:
    """Return scores as a dataset.

    Parameters
    ----------
    coordinates
        Labels of the cases, draws and methods, by the name of their dimension.
    rows
        Scores by the place of the case, of case and draw, or of case, draw and method.
    period, rate
        Duration of a realization in s, and sampling rate in Hz.
    """
    import xarray as xr  # noqa: PLC0415  # heavy

    shape = tuple(map(len, coordinates.values()))
    labels: dict[str, dict[str, None]] = {"quantity": dict.fromkeys(IMPEDANCE)}
    levels: dict[int, dict[str, dict[str, NDArray[Any]]]] = {}
    for level in sorted({len(index) for index in rows}):
        chosen = {index: row for index, row in rows.items() if len(index) == level}
        parts = levels.setdefault(level, {})
        for key, values in place(chosen, shape[:level]).items():
            name, _, label = key.partition("/")
            parts.setdefault(name, {})[label] = values
            if label and name in VARIABLES:
                labels.setdefault(VARIABLES[name][0][0], {})[label] = None
    variables = {}
    for level, parts in levels.items():
        for name in VARIABLES.keys() & parts.keys():
            dims, meaning, unit = VARIABLES[name]
            of_label = parts[name]
            if "" in of_label:
                values = of_label[""]
            else:
                names = enumerate(labels[dims[0]])
                found: Rows = {
                    (n,): {name: of_label[each]} for n, each in names if each in of_label
                }
                values = np.moveaxis(place(found, (len(labels[dims[0]]),))[name], 0, level)
            attributes = {"long_name": meaning} | ({"units": unit} if unit else {})
            variables[name] = ((*list(coordinates)[:level], *dims), values, attributes)
    units = dict(UNITS)
    for parts in levels.values():
        units |= {name: max(map(str, each.flat)) for name, each in parts.get("unit", {}).items()}
    time = {"units": "s", "long_name": f"time within a realization of {period:g} s"}
    return xr.Dataset(
        {name: variables[name] for name in VARIABLES if name in variables},
        coords={
            **{name: list(each) for name, each in {**coordinates, **labels}.items()},
            "statistic": list(STATISTICS),
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
