"""Tables of a study: metrics, stiffness over time, and what became of each realization."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tvsysid.numerics import Array
from tvsysid.study.alignment import AlignmentEffect
from tvsysid.study.prepared import Prepared
from tvsysid.study.scores import MAIN, OF_SWITCHES, PATHWAY, units_of

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
UNITS = {
    "mean_stiffness": "N·m/rad",
    "random_error": "N·m/rad",
    "vaf": "%",
    "bandpassed_vaf": "%",
    "lowest_time_varying_vaf": "%",
    "bias_error": "N·m/rad",
    "mean_bias": "N·m/rad",
    "seconds": "s",
    "failed": "draws",
}
"""Of every metric of an experiment; of those of a quantity, the stiffness."""
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
        stiffness. ``seconds``: that all draws took. ``failed``: draws without a result. Every other
        quantity that was estimated has rows of its own: ``mean_viscosity``, ``random_error``, and
        where it is known ``bias_error`` and ``mean_bias``.
    """
    return _of_simulations(found) if "scenario" in found.dims else _of_experiment(found)


def _of_simulations(scores: xr.Dataset) -> pd.DataFrame:
    order = ["scenario", "method_key", "metric"]
    table = scores.drop_vars("replicates").to_dataframe(dim_order=order).reset_index()
    known = table.quantity.isin(["", MAIN]) | np.isfinite(table.value)
    applies = table.switches | ~table.measure.isin(OF_SWITCHES)
    rows: pd.DataFrame = table[known & applies & table.get("asked", True)].drop(columns="metric")
    names = {"profile": "stiffness", "method_key": "method", "measure": "metric"}
    chosen: pd.DataFrame = rows.rename(columns=names)[list(COLUMNS)]
    return chosen.reset_index(drop=True)


def of_quantity(summary: pd.DataFrame, quantity: str = MAIN) -> pd.DataFrame:
    """Return the rows of a summary on a quantity or on none."""
    return summary[summary.quantity.isin(["", quantity])]


def by_full_name(summary: pd.DataFrame) -> pd.DataFrame:
    """Return a summary whose metrics other than stiffness name their quantity."""
    own = summary.quantity.isin(["", MAIN])
    return summary.assign(metric=summary.metric.where(own, summary.quantity + " " + summary.metric))


def _of_experiment(results: xr.Dataset) -> pd.DataFrame:
    import pandas as pd  # noqa: PLC0415  # heavy

    # Quantity, metric, unit, and values over recording and analysis.
    values = measured(results)
    entries = [
        (MAIN if unit == UNITS["mean_stiffness"] else "", name, unit, values[name])
        for name, unit in UNITS.items()
    ]
    for quantity, unit in units_of(results).items():
        errors = _errors(results, quantity) if quantity != MAIN else {}
        entries += [(quantity, name, unit, each) for name, each in errors.items()]
    for name in map(str, results.pathway.values) if PATHWAY in results else ():
        shares = mean_over_draws(results[PATHWAY].sel(pathway=name).values)
        entries.append((name, PATHWAY, "%", shares))
    known = np.isfinite(results.truth).any("time")
    rows = []
    for place in np.ndindex(results.sizes["recording"], results.sizes["analysis"]):
        recording, analysis = results.isel(recording=place[0]), results.isel(analysis=place[1])
        labels = (
            str(recording.participant.values),
            str(recording.perturbation.values),
            str(analysis.method_key.values),
            int(analysis.realizations),
        )
        for quantity, name, unit, each in entries:
            if name in OF_TRUTH and not known.sel(quantity=quantity)[place[0]]:
                continue
            if quantity in ("", MAIN) or np.isfinite(each[place]):
                rows.append((*labels, name, float(each[place]), unit, quantity))
    return pd.DataFrame(rows, columns=[*LABELS, "metric", "value", "unit", "quantity"])


def measured(results: xr.Dataset) -> dict[str, Array]:
    """Return metrics of stiffness and torque, each over (recording, analysis).

    NaN where there is none.
    """
    with warnings.catch_warnings():
        # A method that failed has no values to average
        warnings.simplefilter("ignore", RuntimeWarning)
        return _errors(results, MAIN) | {
            "vaf": np.nanmean(results.vaf.values, axis=-1),
            "bandpassed_vaf": np.nanmean(results.bandpassed_vaf.values, axis=-1),
            "lowest_time_varying_vaf": np.nanmin(
                mean_over_draws(results.time_varying_vaf.values), axis=-1
            ),
            "seconds": results.seconds.values,
            "failed": np.isnan(results.vaf.values).sum(axis=-1),
        }


def _errors(results: xr.Dataset, quantity: str) -> dict[str, Array]:
    """Return the metrics of a quantity, each over (recording, analysis).

    NaN where it is not estimated, or not known.
    """
    estimates = results.estimate.sel(quantity=quantity).values
    mean = mean_over_draws(estimates)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        error = mean - results.truth.sel(quantity=quantity).values[:, None]
        return {
            f"mean_{quantity}": np.nanmean(mean, axis=-1),
            "random_error": np.sqrt(np.nanmean(np.nanvar(estimates, axis=2, ddof=1), axis=-1)),
            "bias_error": np.sqrt(np.nanmean(error**2, axis=-1)),
            "mean_bias": np.nanmean(error, axis=-1),
        }


def mean_over_draws(values: Array) -> Array:
    """Return the mean over successful draws, from (recording, analysis, bootstrap, ...)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # where all failed
        return np.asarray(np.nanmean(values, axis=2))


def stiffness_over_time(results: xr.Dataset) -> pd.DataFrame:
    """Return stiffness over time: mean and standard deviation over bootstraps.

    Columns are participant, perturbation, method, realizations, time_s, stiffness,
    standard_deviation (N·m/rad) and time_varying_vaf (%).
    """
    chosen = (
        results[["estimate", "time_varying_vaf"]]
        .sel(quantity=MAIN, drop=True)
        .rename(estimate="stiffness")
    )
    chosen = chosen.drop_vars("unit", errors="ignore")
    means = chosen.mean("bootstrap")
    means["standard_deviation"] = chosen.stiffness.std("bootstrap", ddof=1)
    table = means.to_dataframe().reset_index()
    table = table.rename(columns={"method_key": "method", "time": "time_s"})
    columns = [*LABELS, "time_s", "stiffness", "standard_deviation", "time_varying_vaf"]
    return table[columns]


def alignments(results: xr.Dataset) -> pd.DataFrame:
    """Return the change of each recording's mean stiffness by its alignment, identified by sds.

    A row for each recording that was aligned: recording, participant, perturbation; aligned,
    unshifted, difference and its standard_error in N·m/rad; percent, the difference in per cent
    of the stiffness unshifted.
    """
    import pandas as pd  # noqa: PLC0415  # heavy

    names = [name for name in AlignmentEffect._fields if f"alignment_{name}" in results]
    table = pd.DataFrame(
        {name: results[name].values.astype(object).astype(str) for name in OF_RECORDING}
    )
    table = table.assign(**{name: results[f"alignment_{name}"].values for name in names})
    table = table.reindex(columns=[*OF_RECORDING, *AlignmentEffect._fields]).dropna(
        ignore_index=True
    )
    table.insert(len(table.columns) - 1, "difference", table.aligned - table.unshifted)
    return table.assign(percent=100 * table.difference / table.unshifted)


def exclusions(prepared: Sequence[Prepared]) -> pd.DataFrame:
    """Return which realizations were excluded, from :func:`prepared_recordings`.

    A row for each: recording, participant, perturbation, realization, trial, onset_s, shift_s,
    excluded_by (empty for one that was kept), reached, limit, unit.
    """
    import pandas as pd  # noqa: PLC0415  # heavy

    columns = [*OF_RECORDING, "realization", "trial", "onset_s", "shift_s"]
    columns += ["excluded_by", "reached", "limit", "unit"]
    tables = [pd.DataFrame(columns=columns)]
    for item in prepared:
        if item.table is not None:
            recorded = item.recorded
            labels = (recorded.label, recorded.participant, recorded.perturbation)
            own = item.table.reset_index().assign(**dict(zip(OF_RECORDING, labels, strict=True)))
            tables.append(own[columns])
    return pd.concat(tables[1:] or tables, ignore_index=True)
