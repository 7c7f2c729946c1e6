"""Results of a study as a table: a row for each scenario, method and metric."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tvsysid import metrics
from tvsysid.benchmark.study import PROFILES
from tvsysid.simulate import SquareWave

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]

COLUMNS = (
    "stiffness",
    "perturbation",
    "duration_s",
    "snr_db",
    "method",
    "trials",
    "metric",
    "value",
    "unit",
)


def summarize(results: xr.Dataset) -> pd.DataFrame:
    """Every metric for every scenario and method.

    Parameters
    ----------
    results
        As of :func:`tvsysid.benchmark.run`.

    Returns
    -------
    pandas.DataFrame
        Columns stiffness (name of the profile), perturbation, duration_s, snr_db, method, trials, metric, value
        and unit. ``vaf`` and ``bandpassed_vaf`` are means over trials, ``lowest_vaf`` is that of the worst trial, and
        ``lowest_time_varying_vaf`` that of the worst time after averaging over trials; all are against the noiseless
        torque. ``left_out`` counts the times without an estimate, ``seconds`` is the mean time an identification took.
    """
    rows = []
    for profile in results.profile.values:
        for perturbation in results.perturbation.values:
            for duration in results.duration_s.values:
                for snr in results.snr_db.values:
                    for method in results.method_key.values:
                        cell = {
                            "profile": profile,
                            "perturbation": perturbation,
                            "duration_s": duration,
                            "snr_db": snr,
                            "method_key": method,
                        }
                        labels = (profile, perturbation, duration, snr, method, results.sizes["trial"])
                        rows += [(*labels, *row) for row in _rows(results.sel(cell), str(profile))]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _rows(cell: Any, profile: str) -> Iterator[tuple[str, float, str]]:
    estimates, truth = cell.stiffness.values, cell.true_stiffness.values
    values: dict[str, float] = {
        "bias_error": metrics.bias_error(estimates, truth),
        "debiased_bias_error": metrics.debiased_bias_error(estimates, truth),
        "random_error": metrics.random_error(estimates),
        "total_error": metrics.total_error(estimates, truth),
    }
    wave = PROFILES[profile]
    if isinstance(wave, SquareWave):
        step = wave.high - wave.low
        levels = wave.low + 0.1 * step, wave.high - 0.1 * step
        values["rise_time"] = metrics.rise_time(cell.time.values, estimates, *levels, switch=wave.offset)
    values["vaf"] = float(cell.vaf.mean())
    values["bandpassed_vaf"] = float(cell.bandpassed_vaf.mean())
    for name, value in values.items():
        yield name, value, metrics.CATALOGUE[name].unit
    yield "lowest_vaf", float(cell.vaf.min()), "%"
    yield "lowest_time_varying_vaf", float(cell.time_varying_vaf.mean("trial").min()), "%"
    yield "left_out", float(metrics.left_out(estimates)), "samples"
    yield "seconds", float(cell.seconds.mean()), "s"
