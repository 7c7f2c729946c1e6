"""Access to the results of a study or an experiment for its figures."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid.figures.words import TRAITS, wrapped
from tvsysid.numerics import Array
from tvsysid.numerics.bands import mean_and_spread

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

OVER_TIME = ["estimate", "truth", "time_varying_vaf"]
"""Variables of a study that are drawn over time.

Of an experiment, also those of :data:`TORQUES`.
"""
TORQUES = ["target_torque", "mean_torque"]
BANDS = ["covered", "truth"]  # variables that :func:`tvsysid.figures.coverage_over_time` takes
SPIKE = 0.3  # how far beyond 98 % of a method's values an axis reaches, as a share of their range
FAR = 0.75  # how far beyond the middle one of the methods' ranges an axis reaches, as a share of it


def scenario_traits(results: xr.Dataset) -> pd.DataFrame:
    """Return the traits of each scenario of a study, by its label."""
    return results[list(TRAITS)].to_dataframe()[list(TRAITS)]


def traits_of(results: xr.Dataset) -> dict[str, dict[str, Any]]:
    """Return the traits of each scenario as a mapping, by its label."""
    table = scenario_traits(results)
    return {
        str(label): dict(zip(TRAITS, traits, strict=True)) for label, *traits in table.itertuples()
    }


def estimates(results: xr.Dataset, quantity: str = "stiffness") -> xr.DataArray:
    """Return the estimates over time and the axes of the study.

    NaN where there is no estimate.
    """
    return _of(results.estimate, quantity)


def truth(results: xr.Dataset, quantity: str = "stiffness") -> xr.DataArray:
    """Return the truth over scenario or recording and time; NaN where it is unknown."""
    return _of(results.truth, quantity)


def covered(results: xr.Dataset, quantity: str = "stiffness") -> xr.DataArray:
    """Whether the 95 % band holds the truth: 1, 0, or NaN where there is no band."""
    return _of(results.covered, quantity)


def _of(values: xr.DataArray, quantity: str) -> xr.DataArray:
    found: xr.DataArray = values.sel(quantity=quantity) if "quantity" in values.dims else values
    return found


def knows_truth(results: xr.Dataset) -> bool:
    """Whether the true stiffness of anybody is known."""
    return bool(np.isfinite(truth(results).values).any())


def unique(values: Iterable[object]) -> list[str]:
    """Return values as text, each once, in order of appearance."""
    return list(dict.fromkeys(map(str, values)))


def least_data(results: xr.Dataset) -> dict[str, str]:
    """Label of an experiment's analysis with the fewest realizations, by method."""
    counts = dict(
        zip(map(str, results.analysis.values), results.realizations.values.tolist(), strict=True)
    )
    labels: dict[str, list[str]] = {}
    for label, method in zip(counts, results.method_key.values, strict=True):
        labels.setdefault(str(method), []).append(label)
    return {method: min(mine, key=lambda label: counts[label]) for method, mine in labels.items()}


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


def usual_range(values: Array, always: Array) -> tuple[float, float]:
    """Return axis limits for the usual range of methods and all of some further values.

    From zero if near.

    A method that is out of its depth has spikes, or is far off; that shall not hide the rest.
    Values have shape (method, ...), those that are always shown any.
    """
    extents = [_without_spikes(known) for each in values if (known := each[np.isfinite(each)]).size]
    ends = [float(each) for each in always[np.isfinite(always)]]
    if extents:
        low, high = np.median(extents, axis=0)
        beyond = FAR * (high - low)
        ends += [
            max(min(each for each, _ in extents), float(low - beyond)),
            min(max(each for _, each in extents), float(high + beyond)),
        ]
    if not ends:
        return 0.0, 1.0
    least, most = min(ends), max(ends)
    room = 0.08 * max(most - least, 0.2 * abs(most), 1e-9)
    return (0.0 if 0 <= least < 0.6 * most else least - room), most + room


def _without_spikes(values: Array) -> tuple[float, float]:
    """Return the lowest and highest value, without outliers beyond 98 %."""
    low, high = np.percentile(values, [1, 99])
    beyond = SPIKE * (high - low)
    return max(float(values.min()), float(low - beyond)), min(
        float(values.max()), float(high + beyond)
    )
