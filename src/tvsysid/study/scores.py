"""Compute the metrics of a study with bootstrap replicates, and tabulate them."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from tvsysid import metrics
from tvsysid.numerics import Array
from tvsysid.study.bootstraps import Prepared
from tvsysid.study.dataset import axes_of
from tvsysid.study.measure import Scores, stack

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

REPLICATES = 1000
AT_SWITCH = 0.05  # seconds from a switch up to which a time is at the switch
AWAY = 0.3  # seconds from a switch beyond which no window or lag of the paper's methods reaches it
MAIN = "stiffness"  # the quantity whose metrics have no quantity in their names
PATHWAY = "pathway_vaf"  # metric of each pathway, whose name takes the place of the quantity
PERCENT, POINTS = "%", "percentage points"
METRICS = {
    "mean": "",
    "bias_error": "",
    "debiased_bias_error": "",
    "mean_bias": "",
    "random_error": "",
    "total_error": "",
    "rise_time": "s",
    "coverage": PERCENT,
    "vaf": PERCENT,
    "bandpassed_vaf": PERCENT,
    "lowest_vaf": PERCENT,
    "lowest_time_varying_vaf": PERCENT,
    "switch_dip": POINTS,
    "time_varying_vaf_sd": POINTS,
    "time_varying_vaf_sd_soft": POINTS,
    "time_varying_vaf_sd_stiff": POINTS,
    "failed": "draws",
    "seconds": "s",
}
"""Unit of each metric; empty for that of the quantity."""


COLUMNS = (
    *("stiffness", "participant", "perturbation", "duration_s", "snr_db", "method"),
    *("realizations", "trials", "bootstraps", "metric", "value", "unit", "standard_error"),
    *("viscosity", "scenario", "system"),
)
"""Columns of the summary, as far as they apply."""
LABELS = ("participant", "perturbation", "method", "realizations")
NAMES = {"profile": "stiffness", "method_key": "method", "time": "time_s"}
"""Columns of tables by the names of coordinates."""


def score(results: xr.Dataset) -> xr.Dataset:
    """Return every metric of every case and method. Trials also give bootstrap replicates.

    A replicate is the metric of trials drawn with replacement. All methods and scenarios share the
    drawn trials, so that the uncertainty of a difference between methods, which see the same data,
    is that of the difference of their replicates. Bootstraps of a recording have no replicates.

    The results are those of :func:`tvsysid.study.run`. Draws in which a method failed are left out
    for that method, and counted.

    Returns
    -------
    xarray.Dataset
        ``value`` and ``standard_error`` over (scenario, method_key, metric), ``replicates`` over
        (scenario, method_key, metric, replicate), and the number of ``trials`` that did not fail
        over (scenario, method_key). Metrics of other quantities than the stiffness have their
        quantity before their name (``"viscosity bias_error"``); ``unit`` lies along ``metric``. An
        experiment has ``value`` over (recording, analysis, metric), and the number of
        ``bootstraps`` that did not fail.

        ``mean`` is that over time and trials. ``vaf`` and ``bandpassed_vaf`` are
        means over trials, ``lowest_vaf`` is that of the worst trial, ``lowest_time_varying_vaf``
        that of the worst time after averaging over trials; all are against the noiseless torque.
        ``switch_dip`` (square wave) is the mean time-varying VAF 0.3 s and more from the switches
        minus that within 0.05 s of one; ``time_varying_vaf_sd`` is its standard deviation over
        trials, averaged over time, ``..._soft`` and ``..._stiff`` over times of less and more than
        the mean stiffness. ``coverage`` is the share of times and trials at which the 95 % band
        holds the truth, of those that have a band. ``failed`` counts trials; ``seconds`` is the
        mean time an identification took.

    References
    ----------
    Efron and Tibshirani 1993, An Introduction to the Bootstrap, chapters 6 and 13.
    """
    import xarray as xr  # noqa: PLC0415  # heavy

    case, draw, method = axes_of(results)
    count, shape = results.sizes[draw], (results.sizes[case], results.sizes[method])
    drawn = np.random.default_rng(0).multinomial(
        count, np.full(count, 1 / count), REPLICATES if draw == "trial" else 0
    )
    weights, scored = np.vstack([np.ones(count), drawn]), results
    if "trial_truth" in results:  # shift estimates, so that their error stays the same
        scored = results.assign(estimate=results.estimate - (results.trial_truth - results.truth))
    cells = np.ndindex(shape)
    found = stack(
        [_metrics(scored.isel({case: row, method: column}), weights) for row, column in cells],
        *shape,
    )
    samples = np.stack([*found.values()], axis=2)
    units = results.unit.to_series().str.replace(" ", "·").str.replace("m2", "m²")
    pairs = (name.rpartition(" ") for name in found)
    unit = [
        METRICS.get(metric, PERCENT) or units[quantity or MAIN] for quantity, _, metric in pairs
    ]
    labels = results.failure.isel({draw: 0}, drop=True).coords
    coordinates = {**labels, "metric": [*found], "unit": ("metric", unit)}
    dims = case, method, "metric"
    scores = xr.Dataset({"value": (dims, samples[..., 0])}, coordinates, results.attrs)
    failed = scores.value.sel(metric="failed", drop=True)
    scores[f"{draw}s"] = (count - failed).fillna(0).astype(int)
    if draw == "trial":
        scores["replicates"] = (*dims, "replicate"), samples[..., 1:]
        scores["standard_error"] = scores.replicates.std("replicate").where(scores.trials > 1)
    return scores


def _metrics(draws: xr.Dataset, weights: Array) -> Scores:
    """Return the metrics of a method in its draws of a case; NaN if the study does not ask for it.

    Each row of ``weights`` (replicate, draw) gives a replicate. The first row weighs all draws
    equally, and gives the metric itself.
    """
    found: Scores = dict.fromkeys(METRICS, np.full(len(weights), np.nan))
    if not draws.coords.get("asked", True):
        return found
    used = draws.failure.values == ""
    found["failed"] = _without_replicates(np.sum(~used), weights)
    if not used.any():
        return found
    own, weights = draws.isel(trial=used, bootstrap=used, missing_dims="ignore"), weights[:, used]
    # Factors of the variance: trials drawn for a replicate have on average (M - 1) / M of the
    # variance of all M trials. One trial has no spread.
    unbiased = used.sum() / (used.sum() - 1 or np.nan)
    factors = np.full(len(weights), unbiased)
    factors[0] /= unbiased  # 1, or NaN for one trial
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # the mean of nothing
        for quantity in map(str, own.quantity.values):
            one, prefix = own.sel(quantity=quantity), "" if quantity == MAIN else f"{quantity} "
            if one.estimate.notnull().any():
                values = _of_quantity(one, weights, unbiased, factors)
                found |= {prefix + name: each for name, each in values.items()}
        return found | _of_torque(own, weights, factors)


def _without_replicates(value: float, weights: Array) -> Array:
    """Return a metric that has no replicates."""
    return np.append(value, np.full(len(weights) - 1, np.nan))


def _of_quantity(own: xr.Dataset, weights: Array, unbiased: float, factors: Array) -> Scores:
    """Return the metrics of a quantity.

    The squared bias of M trials includes 1 / M of their variance. That of a replicate includes it
    twice: for the trials, and for drawing from them. The random error of bootstraps is a standard
    error, with the divisor M - 1.
    """
    estimate, truth = own.estimate.values, own.truth.values
    known = np.isfinite(estimate).all(axis=0)
    random = metrics.random_error(estimate, weights)
    bias = metrics.bias_error(estimate, truth, weights)
    debiased = np.square(bias) - np.square(random) * (unbiased * factors - 1)
    found = {
        "mean": metrics.weighted_mean(estimate[:, known].mean(axis=1), weights),
        "bias_error": bias,
        "debiased_bias_error": np.sqrt(np.maximum(0.0, debiased)),
        "mean_bias": metrics.mean_bias(estimate, truth, weights),
        "random_error": random * np.sqrt(unbiased if "bootstrap" in own.dims else factors),
        "total_error": metrics.total_error(estimate, truth, weights),
    }
    if "covered" in own:
        found["coverage"] = metrics.share_covered(own.covered.values, weights)
    return found


def _of_torque(draws: xr.Dataset, weights: Array, factors: Array) -> Scores:
    """Return the metrics of the torque, and those at switches of the stiffness."""
    over_draws = partial(metrics.weighted_mean, weights=weights)
    over_time = partial(np.nanmean, axis=1)
    own = draws.sel(quantity=MAIN)
    varying, truth, time = own.time_varying_vaf.values, own.truth.values, own.time.values
    mean, off = over_draws(varying), varying - varying.mean(axis=0)
    variance = np.maximum(0.0, over_draws(np.square(off)) - np.square(over_draws(off)))
    spread = np.sqrt(variance * factors[:, None])

    found = {name: over_draws(own[name]) for name in ("vaf", "bandpassed_vaf", "seconds")} | {
        "lowest_vaf": _without_replicates(own.vaf.values.min(), weights),
        "lowest_time_varying_vaf": np.nanmin(mean, axis=1),
        "time_varying_vaf_sd": over_time(spread),
        "time_varying_vaf_sd_soft": over_time(spread[:, truth < truth.mean()]),
        "time_varying_vaf_sd_stiff": over_time(spread[:, truth > truth.mean()]),
    }
    for pathway in map(str, draws.pathway.values) if PATHWAY in draws else ():
        found[f"{pathway} {PATHWAY}"] = over_draws(draws[PATHWAY].sel(pathway=pathway))
    distance = from_switch(time, truth)
    if np.isfinite(distance).all():
        near = distance <= AT_SWITCH + 1e-9
        found["switch_dip"] = over_time(mean[:, distance >= AWAY]) - over_time(mean[:, near])
        rise, upward = 0.1 * np.ptp(truth), np.argmax(truth > np.roll(truth, 1))
        switch = truth.min() + rise, truth.max() - rise, time[upward]
        found["rise_time"] = metrics.rise_time(time, own.estimate.values, *switch, weights=weights)
    return found


def from_switch(time: Array, truth: Array) -> Array:
    """Return the seconds from the nearest switch of a truth of two levels; otherwise NaN.

    The realizations follow each other without a gap.
    """
    if len(np.unique(truth)) != 2:
        return np.full(len(time), np.nan)
    apart = np.abs(time[:, None] - time[truth != np.roll(truth, 1)])
    return np.minimum(apart, len(time) * (time[1] - time[0]) - apart).min(axis=1)


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
