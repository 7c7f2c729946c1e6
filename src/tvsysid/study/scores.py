"""From the draws of a study to its metrics, with bootstrap replicates."""

from __future__ import annotations

import warnings
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from tvsysid import metrics
from tvsysid.metrics.errors import Value
from tvsysid.numerics import Array
from tvsysid.study.dataset import axes_of
from tvsysid.study.measure import at, merge, over

if TYPE_CHECKING:
    import xarray as xr

DRAWS = 1000  # replicates
AT_SWITCH = 0.05  # seconds to either side of a switch that are at it
AWAY = 0.3  # seconds from a switch beyond which no window or lag of the paper's methods reaches it
MAIN = "stiffness"  # the quantity whose metrics have no quantity in their names
PATHWAY = "pathway_vaf"  # metric of each pathway, whose name takes the place of the quantity
PERCENT, POINTS = "%", "percentage points"
OF_QUANTITY = {
    "mean": "",
    "bias_error": "",
    "debiased_bias_error": "",
    "mean_bias": "",
    "random_error": "",
    "total_error": "",
    "rise_time": "s",
    "coverage": PERCENT,
    "without_band": PERCENT,
    "left_out": "samples",
}
"""Unit of each metric of a quantity; empty for that of the quantity."""
METRICS = OF_QUANTITY | {
    "vaf": PERCENT,
    "bandpassed_vaf": PERCENT,
    "lowest_vaf": PERCENT,
    "lowest_time_varying_vaf": PERCENT,
    "switch_dip": POINTS,
    "time_varying_vaf_sd": POINTS,
    "time_varying_vaf_sd_soft": POINTS,
    "time_varying_vaf_sd_stiff": POINTS,
    "coverage_at_switch": PERCENT,
    "coverage_away": PERCENT,
    "failed": "draws",
    "seconds": "s",
}
"""Unit of each metric."""


def score(results: xr.Dataset) -> xr.Dataset:
    """Return every metric of every case and method; of trials, with bootstrap replicates.

    A replicate is the metric of trials drawn with replacement. The same draws serve all methods and
    scenarios, so that the uncertainty of a difference between methods, which see the same data, is
    that of the difference of their replicates. Bootstraps of a recording have no replicates.

    The results are those of :func:`tvsysid.study.run`. Draws in which a method failed are left out
    for that method, and counted.

    Returns
    -------
    xarray.Dataset
        ``value`` and ``standard_error`` over (scenario, method_key, metric), ``replicates`` over
        (scenario, method_key, metric, draw), and ``trials`` that count over (scenario, method_key).
        Metrics of other quantities than the stiffness have their quantity before their name
        (``"viscosity bias_error"``); ``unit`` lies along ``metric``. Of an experiment ``value``
        over (recording, analysis, metric) and ``bootstraps`` that count.

        ``mean`` is that over time and trials. ``vaf`` and ``bandpassed_vaf`` are
        means over trials, ``lowest_vaf`` is that of the worst trial, ``lowest_time_varying_vaf``
        that of the worst time after averaging over trials; all are against the noiseless torque.
        ``switch_dip`` (square wave) is the mean time-varying VAF 0.3 s and more from the switches
        minus that within 0.05 s of one; ``time_varying_vaf_sd`` is its standard deviation over
        trials, averaged over time, ``..._soft`` and ``..._stiff`` over times of less and more than
        the mean stiffness. ``coverage`` is the share of times and trials at which the 95 % band
        holds the truth, of those that have a band; ``without_band`` is the share that has none;
        ``coverage_at_switch`` and ``coverage_away`` (square wave) are the former within 0.05 s of a
        switch and 0.3 s and more from one. ``left_out`` counts times without an estimate;
        ``failed`` counts trials; ``seconds`` is the mean time an identification took.

    References
    ----------
    Efron and Tibshirani 1993, An Introduction to the Bootstrap, chapters 6 and 13.
    """
    import xarray as xr  # noqa: PLC0415  # heavy

    case, draw, method = axes_of(results)
    resampled, count = draw == "bootstrap", results.sizes[draw]
    chosen = np.random.default_rng(0).multinomial(count, np.full(count, 1 / count), size=DRAWS)
    draws = results.isel(statistic=0, missing_dims="ignore")
    if "trial_truth" in draws:  # an error is added to the mean truth
        draws = draws.assign(estimate=draws.estimate - (draws.trial_truth - draws.truth))
    parts = []
    for row, column in np.ndindex(draws.sizes[case], draws.sizes[method]):
        own = draws.isel({case: row, method: column})
        asked, failed = bool(own.coords.get("asked", True)), own.failure.values != ""
        used = asked & ~failed
        own = own.isel({draw: used})
        found = {"failed": np.sum(asked & failed), **_metrics(own, resampled)}
        part = over("metric", metric=[*found], value=[*found.values()])
        if not resampled:
            weights = chosen[:, used].astype(np.float64)
            drawn = _metrics(own, resampled, weights) if used.sum() > 1 else {}
            nothing = np.full(DRAWS, np.nan)
            replicates = [drawn.get(name, nothing) for name in found]
            part |= over("metric", "draw", replicates=replicates)
        part |= over(**{f"{draw}s": used.sum()})
        parts.append(at(part, **{case: own[case].item(), method: own[method].item()}))
    labels = {dim: results[dim].values.tolist() for dim in (case, method)}
    merged = merge(parts, labels | {"metric": METRICS})
    merged.pop("draw", None)
    scores = xr.Dataset(merged).assign_attrs(results.attrs)
    scores[f"{draw}s"] = scores[f"{draw}s"].astype(int)
    if not resampled:
        scores["standard_error"] = scores.replicates.std("draw")
    units, fixed = units_of(results), METRICS | {"failed": f"{draw}s", PATHWAY: PERCENT}
    names = (str(name).rpartition(" ") for name in scores.metric.values)
    unit = [fixed[measure] or units[quantity or MAIN] for quantity, _, measure in names]
    kept = {name: own for name, own in results.coords.items() if set(own.dims) <= {case, method}}
    return scores.assign_coords(kept | {"unit": ("metric", unit)})


def _metrics(draws: xr.Dataset, resampled: bool, weights: Array | None = None) -> dict[str, Value]:
    """Return the metrics of a method in its draws of a case; none without a draw.

    Weights of the draws, shape (replicate, draw), give a replicate each.
    """
    found: dict[str, Value] = {}
    if not len(draws.failure):
        return found
    with warnings.catch_warnings(action="ignore", category=RuntimeWarning):  # the mean of nothing
        for quantity in map(str, draws.quantity.values):
            own = draws.sel(quantity=quantity)
            if quantity == MAIN:
                found |= _of_quantity(own, resampled, weights) | _of_torque(own, weights)
            elif own.estimate.notnull().any():
                values = _of_quantity(own, resampled, weights)
                found |= {f"{quantity} {name}": value for name, value in values.items()}
        for pathway in map(str, draws.pathway.values) if PATHWAY in draws else ():
            shares = draws[PATHWAY].sel(pathway=pathway)
            found[f"{pathway} {PATHWAY}"] = metrics.weighted_mean(shares, weights)
    return found


def _of_quantity(own: xr.Dataset, resampled: bool, weights: Array | None) -> dict[str, Value]:
    """Return the metrics of a quantity.

    A draw of trials varies less than what it is drawn from, by (M - 1) / M. Its bias holds the
    random error's part twice, the sample's and that of drawing from it, so that of the random
    error, as the draw has it, (2M - 1) / (M - 1)² is taken from the square of the bias instead of
    1 / (M - 1). The random error of bootstraps is a standard error, with the divisor M - 1.
    """
    estimate, truth = own.estimate.values, own.truth.values
    count = len(estimate)
    others = count - 1 or np.nan  # one draw has no spread
    divisor = others if weights is None else others**2 / (2 * count - 1)
    wider = count / others if resampled or weights is not None else others / others
    random = metrics.random_error(estimate, weights)
    bias = metrics.bias_error(estimate, truth, weights)
    left = np.square(bias) - np.square(random) / divisor
    known = np.isfinite(estimate).all(axis=0)
    found = {
        "mean": metrics.weighted_mean(estimate[:, known].mean(axis=1), weights),
        "bias_error": bias,
        "debiased_bias_error": np.sqrt(np.maximum(0.0, left)),
        "mean_bias": metrics.mean_bias(estimate, truth, weights),
        "random_error": random * np.sqrt(wider),
        "total_error": metrics.total_error(estimate, truth, weights),
    }
    if "covered" in own:
        covered = own.covered.values
        missing = np.isnan(covered).mean(axis=1)
        found["coverage"] = metrics.share_covered(covered, weights)
        found["without_band"] = 100 * metrics.weighted_mean(missing, weights)
    return found | ({"left_out": metrics.left_out(estimate)} if weights is None else {})


def _of_torque(own: xr.Dataset, weights: Array | None) -> dict[str, Value]:
    """Return the metrics of the torque, and those at switches of the stiffness."""
    mean = partial(metrics.weighted_mean, weights=weights)
    vaf, varying, truth = own.vaf.values, own.time_varying_vaf.values, own.truth.values
    over_time, count = mean(varying), len(varying)
    off = varying - varying.mean(axis=0)
    variance = np.maximum(0.0, mean(np.square(off)) - np.square(mean(off)))
    spread = np.sqrt(variance) * (1 if weights is None else np.sqrt(count / (count - 1)))
    found = {
        "vaf": mean(vaf),
        "bandpassed_vaf": mean(own.bandpassed_vaf.values),
        "lowest_time_varying_vaf": np.nanmin(over_time, axis=-1),
        "time_varying_vaf_sd": np.nanmean(spread, axis=-1),
        "time_varying_vaf_sd_soft": np.nanmean(spread[..., truth < truth.mean()], axis=-1),
        "time_varying_vaf_sd_stiff": np.nanmean(spread[..., truth > truth.mean()], axis=-1),
        "seconds": mean(own.seconds.values),
    }
    if weights is None:
        found["lowest_vaf"] = vaf.min()
    distance = from_switch(own.time.values, truth)
    if np.isfinite(distance).all():
        at_switch, away = distance <= AT_SWITCH + 1e-9, distance >= AWAY
        dip = np.nanmean(over_time[..., away], axis=-1)
        found["switch_dip"] = dip - np.nanmean(over_time[..., at_switch], axis=-1)
        found["rise_time"] = _rise_time(own, weights)
        if "covered" in own:
            for name, chosen in (("at_switch", at_switch), ("away", away)):
                covered = own.covered.values[:, chosen]
                found[f"coverage_{name}"] = metrics.share_covered(covered, weights)
    return found


def _rise_time(own: xr.Dataset, weights: Array | None) -> Value:
    """Return the time from 10 to 90 % of the first step upward."""
    time, truth = own.time.values, own.truth.values
    low, high = np.unique(truth)
    upward = np.flatnonzero((truth == high) & (np.roll(truth, 1) == low))
    levels = low + 0.1 * (high - low), high - (1 - 0.9) * (high - low)
    switch = float(time[upward[0]])
    return metrics.rise_time(time, own.estimate.values, *levels, switch, weights=weights)


def units_of(results: xr.Dataset) -> dict[str, str]:
    """Return the unit of each quantity for tables; empty if unknown."""
    units = [unit.replace(" ", "·").replace("m2", "m²") for unit in map(str, results.unit.values)]
    return dict(zip(map(str, results.quantity.values), units, strict=True))


def from_switch(time: Array, truth: Array) -> Array:
    """Return the seconds from the nearest switch of a truth of two levels; otherwise NaN.

    The realizations follow each other without a gap.
    """
    if len(np.unique(truth)) != 2:
        return np.full(len(time), np.nan)
    apart = np.abs(time[:, None] - time[truth != np.roll(truth, 1)])
    return np.asarray(np.minimum(apart, len(time) * (time[1] - time[0]) - apart).min(axis=1))
