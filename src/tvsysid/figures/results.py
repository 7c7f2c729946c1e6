"""Access to the results of a study or an experiment for its figures."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid.figures.words import TRAITS, wrapped
from tvsysid.numerics.bands import mean_and_spread

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


def scenario_traits(results: xr.Dataset) -> pd.DataFrame:
    """Return the traits of each scenario of a study, by its label."""
    return results[list(TRAITS)].to_dataframe()[list(TRAITS)]


def traits_of(results: xr.Dataset) -> dict[str, dict[str, Any]]:
    """Return the traits of each scenario as a mapping, by its label."""
    table = scenario_traits(results)
    return {str(label): dict(zip(TRAITS, row, strict=True)) for label, *row in table.itertuples()}


def of_quantity(values: xr.DataArray, quantity: str = "stiffness") -> xr.DataArray:
    """Return the values of a quantity, or all values if they do not depend on one."""
    return values.sel(quantity=quantity) if "quantity" in values.dims else values


def estimates(results: xr.Dataset, quantity: str = "stiffness") -> xr.DataArray:
    """Return the estimates over time and the axes of the study; NaN where there is none."""
    return of_quantity(results.estimate, quantity)


def truth(results: xr.Dataset, quantity: str = "stiffness") -> xr.DataArray:
    """Return the truth over scenario or recording and time; NaN where it is unknown."""
    return of_quantity(results.truth, quantity)


def covered(results: xr.Dataset, quantity: str = "stiffness") -> xr.DataArray:
    """Whether the 95 % band holds the truth: 1, 0, or NaN where there is no band."""
    return of_quantity(results.covered, quantity)


def knows_truth(results: xr.Dataset) -> bool:
    """Whether the true stiffness of anybody is known."""
    return bool(np.isfinite(truth(results).values).any())


def unique(values: Iterable[object]) -> list[str]:
    """Return values as text, each once, in order of appearance."""
    return list(dict.fromkeys(map(str, values)))


def least_data(results: xr.Dataset) -> dict[str, str]:
    """Label of an experiment's analysis with the fewest realizations, by method."""
    table = results.realizations.to_series()
    methods = results.method_key.to_series()
    return {str(method): str(table[methods == method].idxmin()) for method in methods.unique()}


def seconds_of_data(results: xr.Dataset, analysis: str) -> str:
    """Return the amount of data of an analysis as text: realizations times their duration."""
    return f"{int(results.realizations.sel(analysis=analysis))} × {_period(results):.4g} s"


def _period(results: xr.Dataset) -> float:
    """Return the duration of a realization in s."""
    time = results.time.values
    return len(time) * float(time[-1] - time[0]) / max(len(time) - 1, 1)


def headings(results: xr.Dataset, width: int) -> dict[str, str]:
    """Return method and seconds of data, in short lines, by the label of its smallest analysis."""
    shown = {}
    for method, label in least_data(results).items():
        name, amount = wrapped(method, width), seconds_of_data(results, label)
        fits = len(f"{name}, {amount}".rpartition("\n")[2]) <= width
        shown[label] = f"{name}, {amount}" if fits else f"{name},\n{amount}"
    return shown


def label_time(axes: Any, results: xr.Dataset) -> None:
    """Label the time axis of the last row of axes, and limit it to one realization."""
    start = float(results.time.values[0])
    for each in np.ravel(axes):
        each.set_xlabel("time (s)")
        each.set_xlim(start, start + (_period(results) or 1.0))
        each.locator_params(axis="x", nbins=4)
        each.xaxis.set_major_formatter("{x:g}")


def mean_stiffness(results: xr.Dataset) -> xr.DataArray:
    """Return the mean stiffness of each method's smallest analysis, (recording, analysis, time)."""
    here = estimates(results).sel(analysis=list(least_data(results).values()))
    here = here.transpose("bootstrap", "recording", "analysis", "time")
    return here.isel(bootstrap=0, drop=True).copy(data=mean_and_spread(here.values)[0])


def recording_of(results: xr.Dataset, participant: str, perturbation: str) -> str | None:
    """Label of the recording of a participant under a perturbation; None if there is none."""
    there = (results.participant == participant) & (results.perturbation == perturbation)
    labels = results.recording.values[there.values]
    return str(labels[0]) if len(labels) else None
