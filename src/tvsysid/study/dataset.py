"""Results of a study as one dataset, which holds whatever its tasks measured."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid.dataset_layout import UNITS
from tvsysid.errors import InputError
from tvsysid.models import IMPEDANCE
from tvsysid.recordings import whole_file
from tvsysid.study.measure import AXES, STATISTICS, Scores, merge
from tvsysid.study.tasks import versions

if TYPE_CHECKING:
    import xarray as xr

RESULTS = "results.nc"  # file of a study's results, in its folder
SIMULATIONS = "Simulation study of methods that identify joint impedance over time"
EXPERIMENT = "Experimental study of methods that identify joint impedance over time"
VARIABLES: dict[str, tuple[str, ...]] = {
    "truth": ("true value, in the unit of its quantity", "unit"),
    "estimate": ("estimate, in the unit of its quantity", "unit"),
    "standard_error": ("standard error of the estimate", "unit"),
    "covered": ("whether the 95 % band of the estimate holds the truth", "1"),
    "time_varying_vaf": ("variance of the torque accounted for at each time", "percent"),
    "vaf": ("variance of the torque accounted for, over realizations", "percent"),
    "bandpassed_vaf": ("the same after a band-pass from 1 to 10 Hz", "percent"),
    "pathway_vaf": ("variance of each pathway's noiseless torque accounted for", "percent"),
    "pathway_torque": (
        "root mean square over realizations of each pathway's predicted torque at each time",
        "N m",
    ),
    "scheduled_estimate": ("estimate over a measured variable", "unit"),
    "scheduled_standard_error": ("its standard error", "unit"),
    "scheduling_variable": ("values of the variable", "unit"),
    "parameters": ("effective number of parameters", "1"),
    "seconds": ("time of the identification", "s"),
    "other_seconds": ("time of simulating, preparing and scoring a draw", "s"),
    "warnings": ("warnings of the method",),
    "failure": ("why the method gave no result",),
}
"""Meaning and unit of each variable."""


def axes_of(results: xr.Dataset) -> tuple[str, str, str]:
    """Return the dimensions of results of either kind."""
    return next(axes for axes in AXES if axes[0] in results.dims)


def dataset_of(
    parts: Iterable[Scores],
    coordinates: Mapping[str, tuple[Any, Any]],
    period: float,
    rate: float,
    **attributes: str,
) -> xr.Dataset:
    """Return the scores of a study as a dataset, with units and meanings.

    Parameters
    ----------
    parts
        Scores of tasks.
    coordinates
        Dimensions and values of coordinates by name, those of cases, draws and methods among them.
    period, rate
        Duration of a realization in s, and sampling rate in Hz.
    attributes
        Title and settings, to which versions of the software and the machine are added.
    """
    import xarray as xr  # noqa: PLC0415  # heavy

    labels = {name: values for name, (dims, values) in coordinates.items() if dims == name}
    scores = merge(parts, {**labels, "quantity": IMPEDANCE})
    if "unit" not in scores:
        reasons = [*scores["failure"][1].flat, *scores["warnings"][1].flat]
        raise InputError(f"run: no method gave a result; the first: {next(filter(None, reasons))}")
    _, names = scores["quantity"]
    _, texts = scores.pop("unit")
    units = zip(names, texts.reshape(-1, len(names)).T, strict=True)
    results = xr.Dataset(scores).drop_vars("scheduling", errors="ignore")
    for name in VARIABLES.keys() & results.keys():
        results[name].attrs = dict(zip(("long_name", "units"), VARIABLES[name], strict=False))
    time = {"units": "s", "long_name": f"time within a realization of {period:g} s"}
    further = {
        "statistic": list(STATISTICS),
        "time": ("time", np.arange(round(period * rate)) / rate, time),
        "unit": ("quantity", [max(own) or UNITS.get(str(name), "") for name, own in units]),
    }
    return results.assign_coords({**coordinates, **further}).assign_attrs(
        attributes,
        versions=json.dumps(versions()),
        machine=f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores",
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
    try:
        results = xr.load_dataset(file, engine="h5netcdf")
    except FileNotFoundError as error:
        raise InputError(
            f"{file}: there is no such file. Give the folder of a study. If the study was "
            "interrupted, run its command again to finish it"
        ) from error
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        raise InputError(
            f"{file}: this file is damaged. Run the command of the study again to make it anew"
        ) from error
    if results.attrs.get("title") not in (SIMULATIONS, EXPERIMENT):
        raise InputError(f"{file}: these are no results of a study by tvsysid")
    return results
