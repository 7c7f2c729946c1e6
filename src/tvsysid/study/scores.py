"""From the trials of a study to its metrics, and how sure they are."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tvsysid import metrics
from tvsysid.simulate import PROFILES, SquareWave

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]

DRAWS = 1000
"""Bootstrap draws."""
WEIGHTS = 2_000_000
"""Weights of draws times trials that are held at a time: with very many trials there are fewer draws."""
AT_SWITCH = 0.05
"""Seconds to either side of a switch that are at it."""
AWAY = 0.3
"""Seconds from a switch beyond which no window or lag of the paper's methods reaches it."""
UNITS = {
    name: metric.unit for name, metric in metrics.CATALOGUE.items() if name != "time_varying_vaf"
} | {
    "lowest_vaf": "%",
    "lowest_time_varying_vaf": "%",
    "switch_dip": "percentage points",
    "time_varying_vaf_sd": "percentage points",
    "time_varying_vaf_sd_soft": "percentage points",
    "time_varying_vaf_sd_stiff": "percentage points",
    "coverage_at_switch": "%",
    "coverage_away": "%",
    "without_band": "%",
    "left_out": "samples",
    "failed": "trials",
    "seconds": "s",
}  # fmt: skip
"""Of every metric that is computed."""
OF_SWITCHES = ("rise_time", "switch_dip", "coverage_at_switch", "coverage_away")
"""Metrics of a stiffness that switches."""


def score(results: xr.Dataset) -> xr.Dataset:
    """Every metric of every scenario and method, with bootstrap replicates.

    A replicate is the metric of trials drawn with replacement. The same draws serve all methods and scenarios, so that
    the uncertainty of a difference between methods, which see the same data, is that of the difference of their
    replicates.

    Parameters
    ----------
    results
        As of :func:`tvsysid.study.run`, or of a run that is not finished. Trials in which a method failed are left
        out for that method, and counted.

    Returns
    -------
    xarray.Dataset
        ``value`` and ``standard_error`` over (scenario, method_key, metric), ``replicates`` over (scenario,
        method_key, metric, draw), and ``trials`` that count over (scenario, method_key). ``vaf`` and
        ``bandpassed_vaf`` are means over trials, ``lowest_vaf`` is that of the worst trial, ``lowest_time_varying_vaf``
        that of the worst time after averaging over trials; all are against the noiseless torque. ``switch_dip`` (square
        wave) is the mean time-varying VAF 0.3 s and more from the switches minus that within 0.05 s of one;
        ``time_varying_vaf_sd`` is its standard deviation over trials, averaged over time, ``..._soft`` and
        ``..._stiff`` over times of less and more than the mean stiffness. ``coverage`` is the share of times and trials
        at which the 95 % band of the stiffness holds the truth, of those that have a band; ``without_band`` is the
        share that has none; ``coverage_at_switch`` and ``coverage_away`` (square wave) are the former within 0.05 s of
        a switch and 0.3 s and more from one. ``left_out`` counts times without an estimate; ``failed`` counts trials;
        ``seconds`` is the mean time an identification took.

    References
    ----------
    Efron and Tibshirani 1993, An Introduction to the Bootstrap, chapters 6 and 13.
    """
    import xarray as xr  # noqa: PLC0415  # heavy

    count = results.sizes["trial"]
    draws = min(DRAWS, max(DRAWS // 10, WEIGHTS // count))
    chosen = np.random.default_rng(0).multinomial(count, np.full(count, 1 / count), size=draws)
    names = list(UNITS)
    shape = (results.sizes["scenario"], results.sizes["method_key"], len(names))
    value, replicates = np.full(shape, np.nan), np.full((*shape, draws), np.nan)
    trials = np.zeros(shape[:2], dtype=np.int64)
    for place, scenario in enumerate(results.scenario.values):
        cell = results.sel(scenario=scenario).load()
        there = cell.checksums.values.any(axis=-1)
        for column, method in enumerate(results.method_key.values):
            own = cell.sel(method_key=method)
            failed = np.array([text != "" for text in own.failure.values], dtype=bool)
            used = there & ~failed
            trials[place, column] = np.count_nonzero(used)
            value[place, column, names.index("failed")] = np.count_nonzero(there & failed)
            if not used.any():
                continue
            own, weights = own.isel(trial=used), chosen[:, used]
            drawn = weights.any(axis=1)
            weights = weights[drawn] / weights[drawn].sum(axis=1, keepdims=True)
            for name, number in _values(own):
                value[place, column, names.index(name)] = number
            if trials[place, column] > 1:
                for name, numbers in _replicates(own, weights):
                    replicates[place, column, names.index(name), drawn] = numbers
    dims = ("scenario", "method_key", "metric")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # no replicates, no error
        spread = np.nanstd(replicates, axis=-1)
    return xr.Dataset(
        {
            "value": (dims, value),
            "standard_error": (dims, spread),
            "replicates": ((*dims, "draw"), replicates),
            "trials": (dims[:2], trials),
        },
        coords={name: coord for name, coord in results.coords.items() if set(coord.dims) <= {"scenario", "method_key"}}
        | {"metric": names, "unit": ("metric", list(UNITS.values()))},
        attrs=results.attrs,
    )


def time_spent(results: xr.Dataset) -> dict[str, float]:
    """Seconds that each stage of the trials and each method took, over all workers, in the order of the work."""
    stages = results.stage_seconds.sum(["scenario", "trial"])
    methods = results.seconds.sum(["scenario", "trial"])
    before, after = (
        {name: float(stages.sel(stage=name)) for name in names}
        for names in (("simulation", "preprocessing"), ("bands", "scoring"))
    )
    identified = {str(name): float(methods.sel(method_key=name)) for name in results.method_key.values}
    return before | identified | after


def _values(own: Any) -> Iterator[tuple[str, float]]:
    """Metrics of one method in one scenario, from all its trials."""
    estimates, over_time = own.stiffness.values, own.time_varying_vaf.values
    truth, time = own.true_stiffness.values, own.time.values
    yield "bias_error", metrics.bias_error(estimates, truth)
    yield "debiased_bias_error", metrics.debiased_bias_error(estimates, truth)
    # One trial has no spread that could be told.
    yield "random_error", metrics.random_error(estimates) if len(estimates) > 1 else np.nan
    yield "total_error", metrics.total_error(estimates, truth)
    wave = PROFILES[str(own.profile.values)]
    if isinstance(wave, SquareWave):
        yield "rise_time", _rise_time(time, estimates, wave)
        yield "switch_dip", float(_dip(time, over_time.mean(axis=0), wave))
    yield "vaf", float(own.vaf.values[:, 0].mean())
    yield "bandpassed_vaf", float(own.bandpassed_vaf.values[:, 0].mean())
    yield "lowest_vaf", float(own.vaf.values[:, 0].min())
    yield "lowest_time_varying_vaf", float(_least(over_time.mean(axis=0)))
    for name, spread in _spreads(over_time.std(axis=0), truth):
        yield name, float(spread)
    for name, held, told in _coverages(own.covered.values, time, wave):
        yield name, float(_share(held.sum(), told.sum()))
    yield "without_band", 100 * float(np.mean(np.isnan(own.covered.values)))
    yield "left_out", float(metrics.left_out(estimates))
    yield "seconds", float(own.seconds.values.mean())


def _replicates(own: Any, weights: Array) -> Iterator[tuple[str, Array]]:
    """The same for trials drawn with replacement: weights of shape (draw, trial), with rows that sum to one."""
    estimates, over_time = own.stiffness.values, own.time_varying_vaf.values
    known = np.isfinite(estimates).all(axis=0)
    truth, time = own.true_stiffness.values, own.time.values
    count = len(estimates)
    narrower = count / (count - 1)  # a draw varies less than what it is drawn from
    if known.any():
        mean = weights @ estimates[:, known]
        random = np.maximum(0.0, (weights @ estimates[:, known] ** 2 - mean**2).mean(axis=1))
        bias = ((mean - truth[known]) ** 2).mean(axis=1)
        yield "bias_error", np.sqrt(bias)
        # A draw's bias holds the random error's part twice: the sample's, and that of drawing from it.
        twice = random * (2 * count - 1) / (count - 1) ** 2
        yield "debiased_bias_error", np.sqrt(np.maximum(0.0, bias - twice))
        yield "random_error", np.sqrt(random * narrower)
        yield "total_error", np.sqrt(bias + random)
    mean_over_time = weights @ over_time
    wave = PROFILES[str(own.profile.values)]
    if isinstance(wave, SquareWave):
        yield "rise_time", np.array([_rise_time(time, row[None], wave) for row in weights @ estimates])
        yield "switch_dip", _dip(time, mean_over_time, wave)
    yield "vaf", weights @ own.vaf.values[:, 0]
    yield "bandpassed_vaf", weights @ own.bandpassed_vaf.values[:, 0]
    yield "lowest_time_varying_vaf", _least(mean_over_time)
    variance = narrower * np.maximum(0.0, weights @ over_time**2 - mean_over_time**2)
    yield from _spreads(np.sqrt(variance), truth)
    for name, held, told in _coverages(own.covered.values, time, wave):
        yield name, _share(weights @ held, weights @ told)
    yield "without_band", weights @ (100 * np.isnan(own.covered.values).mean(axis=1))
    yield "seconds", weights @ own.seconds.values


def _spreads(deviation: Array, truth: Array) -> Iterator[tuple[str, Array]]:
    """Standard deviations over trials averaged over all, soft and stiff times; time is the last axis."""
    known = np.isfinite(deviation).reshape(-1, len(truth)).all(axis=0)
    mean = truth.mean()
    for ending, times in (("", truth > -np.inf), ("_soft", truth < mean), ("_stiff", truth > mean)):
        chosen = deviation[..., known & times]
        empty = np.full(deviation.shape[:-1], np.nan)
        yield f"time_varying_vaf_sd{ending}", chosen.mean(axis=-1) if chosen.shape[-1] else empty


def _coverages(covered: Array, time: Array, wave: object) -> Iterator[tuple[str, Array, Array]]:
    """At how many times each trial's band holds the truth, and at how many there is one, shape (trial,) each."""
    chosen = {"coverage": np.full(len(time), True)}
    if isinstance(wave, SquareWave):
        distance = from_switch(time, wave)
        chosen |= {"coverage_at_switch": distance <= AT_SWITCH + 1e-9, "coverage_away": distance >= AWAY}
    for name, times in chosen.items():
        shown = covered[:, times]
        yield name, np.nansum(shown, axis=1), np.isfinite(shown).sum(axis=1).astype(np.float64)


def _share(held: ArrayLike, told: ArrayLike) -> Array:
    """Per cent, NaN of nothing; as :func:`tvsysid.metrics.coverage`."""
    whole = np.asarray(told, dtype=np.float64)
    return np.where(whole > 0, 100 * np.asarray(held) / np.where(whole > 0, whole, 1.0), np.nan)


def _rise_time(time: Array, estimates: Array, wave: SquareWave) -> float:
    step = wave.high - wave.low
    return metrics.rise_time(time, estimates, wave.low + 0.1 * step, wave.high - 0.1 * step, switch=wave.offset)


def _dip(time: Array, over_time: Array, wave: SquareWave) -> Array:
    """How far the mean at the switches lies below that away from them; time is the last axis."""
    distance = from_switch(time, wave)
    known = np.isfinite(over_time).reshape(-1, len(time)).all(axis=0)
    at, away = known & (distance <= AT_SWITCH + 1e-9), known & (distance >= AWAY)
    if not (at.any() and away.any()):
        return np.full(over_time.shape[:-1], np.nan)
    return np.asarray(over_time[..., away].mean(axis=-1) - over_time[..., at].mean(axis=-1))


def from_switch(time: Array, wave: SquareWave) -> Array:
    """Seconds from the nearest switch."""
    half = wave.period / 2
    return np.asarray(np.abs((time - wave.offset + half / 2) % half - half / 2))


def _least(values: Array) -> Array:
    known = np.isfinite(values)
    return np.where(known.any(axis=-1), np.min(values, axis=-1, where=known, initial=100.0), np.nan)
