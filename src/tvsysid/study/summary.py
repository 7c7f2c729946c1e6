"""Tables of a study: metrics, stiffness over time, and what became of each realization."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from tvsysid.study.bootstraps import Prepared
from tvsysid.study.scores import MAIN, score

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

COLUMNS = (
    *("stiffness", "participant", "perturbation", "duration_s", "snr_db", "method"),
    *("realizations", "trials", "bootstraps", "metric", "value", "unit", "standard_error"),
    *("viscosity", "scenario", "system"),
)
"""Columns of the summary, as far as they apply."""
LABELS = ("participant", "perturbation", "method", "realizations")
NAMES = {"profile": "stiffness", "method_key": "method", "time": "time_s"}
"""Columns of tables by the names of coordinates."""


def summarize(found: xr.Dataset) -> pd.DataFrame:
    """Return the metrics of a study as a table.

    Parameters
    ----------
    found
        Scores, as of :func:`score`, or results, as of :func:`tvsysid.study.run`.

    Returns
    -------
    pandas.DataFrame
        A row for each scenario or recording, method and metric. Columns of a simulation study are
        stiffness (the name of the profile), perturbation, duration_s, snr_db, method, trials (the
        number that count), metric, value, unit, standard_error (that of the Monte-Carlo estimate;
        NaN for counts, for the worst trial, and for a single one), viscosity, scenario and
        system. Those of an experiment are participant, perturbation, method, realizations,
        bootstraps, metric, value and unit. A metric of another quantity than the stiffness, or of a
        pathway, begins with its name. Rows of metrics without a value are left out.
    """
    scores = found if "metric" in found.dims else score(found)
    table = scores.drop_vars("replicates", errors="ignore").to_dataframe(scores.value.dims)
    table = table.dropna(subset="value").reset_index().rename(columns=NAMES)
    table["metric"] = table.metric.replace("mean", f"mean_{MAIN}")
    return table[[name for name in COLUMNS if name in table]]


def stiffness_over_time(results: xr.Dataset) -> pd.DataFrame:
    """Return stiffness over time: mean and standard deviation over bootstraps.

    Columns are participant, perturbation, method, realizations, time_s, stiffness,
    standard_deviation (N·m/rad) and time_varying_vaf (%).
    """
    import xarray as xr  # noqa: PLC0415  # heavy

    stiffness, draws = results.estimate.sel(quantity=MAIN), "bootstrap"
    values = {
        "stiffness": stiffness.mean(draws),
        "standard_deviation": stiffness.std(draws, ddof=1),
        "time_varying_vaf": results.time_varying_vaf.mean(draws),
    }
    table = xr.Dataset(values).to_dataframe().reset_index().rename(columns=NAMES)
    return table[[*LABELS, "time_s", *values]]


def exclusions(prepared: Sequence[Prepared]) -> pd.DataFrame:
    """Return which realizations were excluded, from :func:`prepared_recordings`.

    A row for each: participant, perturbation, realization, trial, onset_s, shift_s, excluded_by
    (empty for one that was kept), reached, limit, unit.
    """
    import pandas as pd  # noqa: PLC0415  # heavy

    tables = {item.recorded[:2]: item.preparation.table for item in prepared if item.preparation}
    return pd.concat(tables, names=["participant", "perturbation"]).reset_index()
