"""Tables of a study: metrics, stiffness over time, and what became of each realization."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tvsysid.study.alignment import AlignmentEffect
from tvsysid.study.prepared import Prepared
from tvsysid.study.scores import MAIN, OF_SWITCHES, PATHWAY, score, units_of

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

COLUMNS = (
    *("stiffness", "perturbation", "duration_s", "snr_db", "method", "trials"),
    *("metric", "value", "unit", "standard_error", "viscosity", "scenario", "system", "quantity"),
)
"""Of the summary of a simulation study."""
OF_RECORDING = ("recording", "participant", "perturbation")
LABELS = ("participant", "perturbation", "method", "realizations")
NAMES = {
    "profile": "stiffness",
    "method_key": "method",
    "measure": "metric",
    "time": "time_s",
}
"""Columns of tables by the names of coordinates."""
UNITS = {
    **dict.fromkeys(("vaf", "bandpassed_vaf", "lowest_time_varying_vaf", PATHWAY), "%"),
    "seconds": "s",
    "failed": "draws",
}
"""Units of metrics of the torque, and of an analysis."""
OF_TRUTH = ("bias_error", "mean_bias")  # known of virtual participants only


def summarize(found: xr.Dataset) -> pd.DataFrame:
    r"""Return the metrics of a study as a table.

    Parameters
    ----------
    found
        Of a simulation study its scores, as of :func:`score`; of an experiment its results, as of
        :func:`tvsysid.study.run`.

    Returns
    -------
    pandas.DataFrame
        Of a simulation study a row for each scenario, method and metric, with columns ``COLUMNS``:
        stiffness is the name of the profile, trials the number that count, standard_error that of
        the Monte-Carlo estimate (NaN for counts, for the worst trial, and for a single one),
        quantity the one that was estimated, or empty. Rows of metrics that do not apply are left
        out.

        Of an experiment columns participant, perturbation, method, realizations, metric, value,
        unit, quantity. ``mean_stiffness``: over time and bootstraps. ``random_error``:
        :math:`\sqrt{\overline{s^2(t)}}`, with s the standard deviation over bootstraps. ``vaf``,
        ``bandpassed_vaf``: means over bootstraps. ``lowest_time_varying_vaf``: that of the worst
        time after averaging over bootstraps. ``bias_error``, ``mean_bias`` (virtual participants):
        root mean square over time, and mean, of the mean estimate minus the survivors' mean true
        stiffness. ``seconds``: mean time of an identification. ``failed``: draws without a result.
        Every other quantity that was estimated has rows of its own: ``mean_viscosity``,
        ``random_error``, and where it is known ``bias_error`` and ``mean_bias``.
    """
    if "recording" in found.dims:
        return _of_experiment(found)
    scores = found if "metric" in found.dims else score(found)
    table = scores.drop_vars("replicates").to_dataframe(dim_order=scores.value.dims).reset_index()
    known = table.quantity.isin(["", MAIN]) | np.isfinite(table.value)
    applies = table.asked & (table.switches | ~table.measure.isin(OF_SWITCHES))
    table = table[known & applies].drop(columns="metric").rename(columns=NAMES)
    chosen: pd.DataFrame = table[list(COLUMNS)].reset_index(drop=True)
    return chosen


def _of_experiment(results: xr.Dataset) -> pd.DataFrame:
    import pandas as pd  # noqa: PLC0415  # heavy

    scores = measured(results)
    of_torque = scores.drop_dims("quantity")
    parts = [scores.drop_vars(of_torque), of_torque]
    if PATHWAY in results:
        parts.append(results[[PATHWAY]].mean("bootstrap").rename(pathway="quantity"))
    arrays = [each.to_array("metric", "value").transpose(..., "metric") for each in parts]
    table = pd.concat([each.to_dataframe().reset_index() for each in arrays], ignore_index=True)
    table = table.rename(columns=NAMES).fillna({"quantity": ""})
    table["unit"] = table.metric.map(UNITS).fillna(table.quantity.map(units_of(results)))
    is_mean = table.metric == "mean"
    table["metric"] = table.metric.mask(is_mean, "mean_" + table.quantity)
    is_main = table.quantity.isin(["", MAIN]) & ~table.metric.isin(OF_TRUTH)
    table = table[is_main | np.isfinite(table.value)]
    groups = [rows for _, rows in table.groupby(["recording", "analysis"], sort=False)]
    columns = [*LABELS, "metric", "value", "unit", "quantity"]
    chosen: pd.DataFrame = pd.concat(groups, ignore_index=True)[columns]
    return chosen


def measured(results: xr.Dataset) -> xr.Dataset:
    """Return the metrics of an experiment, each over recording, analysis and perhaps quantity.

    They are NaN where there is no value.
    """
    import xarray as xr  # noqa: PLC0415  # heavy

    draws = "bootstrap"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a method that failed has no values
        mean = results.estimate.mean(draws)
        error = mean - results.truth
        return xr.Dataset(
            {
                "mean": mean.mean("time"),
                "random_error": np.sqrt(results.estimate.var(draws, ddof=1).mean("time")),
                "bias_error": np.sqrt(np.square(error).mean("time")),
                "mean_bias": error.mean("time"),
                "vaf": results.vaf.mean(draws),
                "bandpassed_vaf": results.bandpassed_vaf.mean(draws),
                "lowest_time_varying_vaf": results.time_varying_vaf.mean(draws).min("time"),
                "seconds": results.seconds.mean(draws),
                "failed": results.vaf.isnull().sum(draws),
            }
        )


def of_quantity(summary: pd.DataFrame, quantity: str = MAIN) -> pd.DataFrame:
    """Return the rows of a summary on a quantity or on none."""
    return summary[summary.quantity.isin(["", quantity])]


def by_full_name(summary: pd.DataFrame) -> pd.DataFrame:
    """Return a summary whose metrics other than stiffness name their quantity."""
    own = summary.quantity.isin(["", MAIN])
    return summary.assign(metric=summary.metric.where(own, summary.quantity + " " + summary.metric))


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


def alignments(results: xr.Dataset) -> pd.DataFrame:
    """Return the change of each recording's mean stiffness by its alignment, identified by sds.

    A row for each recording that was aligned: recording, participant, perturbation; aligned,
    unshifted, difference and its standard_error in N·m/rad; percent, the difference in per cent
    of the stiffness unshifted.
    """
    names = {f"alignment_{name}": name for name in AlignmentEffect._fields}
    table = results[list(names)].to_dataframe().reset_index().rename(columns=names)
    table["difference"] = table.aligned - table.unshifted
    table["percent"] = 100 * table.difference / table.unshifted
    columns = [*OF_RECORDING, "aligned", "unshifted", "difference", "standard_error", "percent"]
    return table[columns].dropna(ignore_index=True)


def exclusions(prepared: Sequence[Prepared]) -> pd.DataFrame:
    """Return which realizations were excluded, from :func:`prepared_recordings`.

    A row for each: recording, participant, perturbation, realization, trial, onset_s, shift_s,
    excluded_by (empty for one that was kept), reached, limit, unit.
    """
    import pandas as pd  # noqa: PLC0415  # heavy

    columns = [*OF_RECORDING, "realization", "trial", "onset_s", "shift_s"]
    columns += ["excluded_by", "reached", "limit", "unit"]
    tables = [
        item.table.reset_index().assign(
            recording=item.recorded.label,
            participant=item.recorded.participant,
            perturbation=item.recorded.perturbation,
        )
        for item in prepared
        if item.table is not None
    ]
    return pd.concat(tables or [pd.DataFrame(columns=columns)], ignore_index=True)[columns]
