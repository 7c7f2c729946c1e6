"""From the trials of a simulation study to its metrics, with bootstrap replicates."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from functools import cached_property
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid import metrics
from tvsysid.metrics import share_covered, weighted_mean
from tvsysid.metrics.errors import Value
from tvsysid.numerics import Array
from tvsysid.simulate import SquareWave

if TYPE_CHECKING:
    import xarray as xr

DRAWS = 1000  # bootstrap draws
MAX_WEIGHTS = 2_000_000  # draw-trial weights kept in memory; very many trials get fewer draws
AT_SWITCH = 0.05  # seconds to either side of a switch that are at it
AWAY = 0.3  # seconds from a switch beyond which no window or lag of the paper's methods reaches it
MAIN = "stiffness"  # the quantity whose metrics have no quantity in their names
PATHWAY = "pathway_vaf"  # metric of each pathway, whose name takes the place of the quantity
NEWTON, PERCENT, POINTS = "N·m/rad", "%", "percentage points"


@attrs.frozen
class Cell:
    """Results of one method in the trials of one scenario, for one quantity.

    Parameters
    ----------
    time, truth
        Time in s, and the true values, shape (time,).
    estimates, covered, over_time
        Estimates, whether bands hold the truth, and time-varying VAF, shape (trial, time). Where
        the truth differs from trial to trial, the estimate's error is added to the mean truth.
    vaf, bandpassed, seconds
        Mean VAFs of the trials, and seconds of the identifications, shape (trial,).
    weights
        Weights of the trials, shape (draw, trial), for replicates.
    """

    time: Array
    truth: Array
    estimates: Array
    covered: Array
    over_time: Array
    vaf: Array
    bandpassed: Array
    seconds: Array
    weights: Array | None = None

    @cached_property
    def wave(self) -> SquareWave | None:
        """Square wave that the truth is, if it is one."""
        return wave_of(self.time, self.truth)

    def near(self, low: float, high: float) -> NDArray[np.bool_]:
        """Return the times whose distance from a switch is in this range, in s."""
        assert self.wave is not None
        distance = from_switch(self.time, self.wave)
        return np.asarray((distance >= low) & (distance <= high + 1e-9))

    def error(self, name: str) -> Value:
        """Return an error of the catalogue of metrics."""
        given = (self.estimates,) if name == "random_error" else (self.estimates, self.truth)
        return metrics.CATALOGUE[name].function(*given, weights=self.weights)

    def mean(self, values: Array) -> Array:
        """Return the mean over trials."""
        return weighted_mean(values, self.weights)

    @property
    def rise(self) -> Value:
        """Time from 10 to 90 % of the step."""
        assert self.wave is not None
        step = self.wave.high - self.wave.low
        low, high = self.wave.low + 0.1 * step, self.wave.high - (1 - 0.9) * step
        return metrics.rise_time(
            self.time, self.estimates, low, high, self.wave.offset, weights=self.weights
        )

    @property
    def dip(self) -> Value:
        """Time-varying VAF away from the switches less that at the switches."""
        mean = self.mean(self.over_time)
        known = np.isfinite(mean).reshape(-1, len(self.time)).all(axis=0)
        at, away = known & self.near(0, AT_SWITCH), known & self.near(AWAY, np.inf)
        if not (at.any() and away.any()):
            return np.full(mean.shape[:-1], np.nan)
        return mean[..., away].mean(axis=-1) - mean[..., at].mean(axis=-1)

    @property
    def lowest(self) -> Value:
        """Lowest mean over trials of the time-varying VAF."""
        mean = self.mean(self.over_time)
        known = np.isfinite(mean)
        least = np.min(mean, axis=-1, where=known, initial=100.0)
        return np.where(known.any(axis=-1), least, np.nan)

    def spread(self, side: int) -> Value:
        """Return the mean SD over trials at all times (0), or for a low (-1) or high (1) truth."""
        own = self.over_time - self.over_time.mean(axis=0)
        variance = self.mean(np.square(own)) - np.square(self.mean(own))
        deviation = np.sqrt(np.maximum(0.0, variance))
        known = np.isfinite(deviation).reshape(-1, len(self.time)).all(axis=0)
        is_side = (side == 0) | (np.sign(self.truth - self.truth.mean()) == side)
        chosen = deviation[..., known & is_side]
        return chosen.mean(axis=-1) if chosen.shape[-1] else np.full(deviation.shape[:-1], np.nan)

    def share(self, low: float, high: float) -> Value:
        """Return the share of bands that hold the truth, at these distances from a switch in s."""
        return share_covered(self.covered[:, self.near(low, high)], self.weights)

    def whole(self, value: Any) -> Value:
        """Return a metric of all trials together, which has no replicates."""
        return value if self.weights is None else np.nan


ERRORS = ("bias_error", "debiased_bias_error", "mean_bias", "random_error", "total_error")


def _error(name: str) -> Callable[[Cell], Value]:
    return lambda cell: cell.error(name)


METRICS: dict[str, tuple[str, Callable[[Cell], Value]]] = {
    **{name: (NEWTON, _error(name)) for name in ERRORS},
    "rise_time": ("s", lambda cell: cell.rise),
    "vaf": (PERCENT, lambda cell: cell.mean(cell.vaf)),
    "bandpassed_vaf": (PERCENT, lambda cell: cell.mean(cell.bandpassed)),
    "coverage": (PERCENT, lambda cell: share_covered(cell.covered, cell.weights)),
    "lowest_vaf": (PERCENT, lambda cell: cell.whole(cell.vaf.min())),
    "lowest_time_varying_vaf": (PERCENT, lambda cell: cell.lowest),
    "switch_dip": (POINTS, lambda cell: cell.dip),
    "time_varying_vaf_sd": (POINTS, lambda cell: cell.spread(0)),
    "time_varying_vaf_sd_soft": (POINTS, lambda cell: cell.spread(-1)),
    "time_varying_vaf_sd_stiff": (POINTS, lambda cell: cell.spread(1)),
    "coverage_at_switch": (PERCENT, lambda cell: cell.share(0, AT_SWITCH)),
    "coverage_away": (PERCENT, lambda cell: cell.share(AWAY, np.inf)),
    "without_band": (PERCENT, lambda cell: 100 * cell.mean(np.isnan(cell.covered).mean(axis=1))),
    "left_out": ("samples", lambda cell: cell.whole(metrics.left_out(cell.estimates))),
    "failed": ("trials", lambda cell: np.nan),
    "seconds": ("s", lambda cell: cell.mean(cell.seconds)),
}
"""Unit and function of each metric."""
OF_SWITCHES = ("rise_time", "switch_dip", "coverage_at_switch", "coverage_away")
"""Metrics of a stiffness that switches."""
OF_QUANTITY = (*ERRORS, "coverage", "without_band", "left_out")
"""Metrics of each quantity that is both estimated and known."""


def score(results: xr.Dataset) -> xr.Dataset:
    """Return every metric of every scenario and method, with bootstrap replicates.

    A replicate is the metric of trials drawn with replacement. The same draws serve all methods and
    scenarios, so that the uncertainty of a difference between methods, which see the same data, is
    that of the difference of their replicates.

    The results are those of :func:`tvsysid.study.run` of a simulation study.
    Trials in which a method failed are left out for that method, and counted.

    Returns
    -------
    xarray.Dataset
        ``value`` and ``standard_error`` over (scenario, method_key, metric), ``replicates`` over
        (scenario, method_key, metric, draw), and ``trials`` that count over (scenario, method_key).
        Along ``metric`` lie ``measure``, ``quantity`` (empty for metrics of the torque) and
        ``unit``: those of the stiffness go by the name of the measure, those of other quantities
        that are both estimated and known have their quantity before it (``"viscosity
        bias_error"``).

        ``vaf`` and ``bandpassed_vaf`` are means over trials, ``lowest_vaf`` is that of the worst
        trial, ``lowest_time_varying_vaf`` that of the worst time after averaging over trials; all
        are against the noiseless torque. ``switch_dip`` (square wave) is the mean time-varying VAF
        0.3 s and more from the switches minus that within 0.05 s of one; ``time_varying_vaf_sd`` is
        its standard deviation over trials, averaged over time, ``..._soft`` and ``..._stiff`` over
        times of less and more than the mean stiffness. ``coverage`` is the share of times and
        trials at which the 95 % band holds the truth, of those that have a band; ``without_band``
        is the share that has none; ``coverage_at_switch`` and ``coverage_away`` (square wave) are
        the former within 0.05 s of a switch and 0.3 s and more from one. ``left_out`` counts times
        without an estimate; ``failed`` counts trials; ``seconds`` is the mean time an
        identification took.

    References
    ----------
    Efron and Tibshirani 1993, An Introduction to the Bootstrap, chapters 6 and 13.
    """
    import xarray as xr  # noqa: PLC0415  # heavy

    known = list(map(str, results.quantity.values))
    pathways = list(map(str, results.pathway.values)) if PATHWAY in results else []
    every = [(MAIN if name in (*OF_QUANTITY, "rise_time") else "", name) for name in METRICS]
    every += [(quantity, name) for quantity in known if quantity != MAIN for name in OF_QUANTITY]
    every += [(name, PATHWAY) for name in pathways]
    place_of = {place: number for number, place in enumerate(every)}
    count = results.sizes["trial"]
    draws = min(DRAWS, max(DRAWS // 10, MAX_WEIGHTS // count))
    chosen = np.random.default_rng(0).multinomial(count, np.full(count, 1 / count), size=draws)
    shape = (results.sizes["scenario"], results.sizes["method_key"], len(every))
    value, replicates = np.full(shape, np.nan), np.full((*shape, draws), np.nan)
    failed = np.asarray(results.failure.values != "")
    value[..., place_of["", "failed"]] = failed.sum(axis=1)
    used = asked(results)[:, None] & ~failed
    for row, column in zip(*np.nonzero(used.any(axis=1)), strict=True):
        mine = used[row, :, column]
        weights = chosen[:, mine].astype(np.float64)
        drawn = weights.any(axis=1)
        one = results.isel(scenario=row, method_key=column, trial=mine)
        found = [*_of_quantities(one, weights[drawn]), *_of_pathways(one, weights[drawn])]
        for place, measured, drawings in found:
            at = place_of.get(place, place_of.get(("", place[1]), 0))
            value[row, column, at] = measured
            if one.sizes["trial"] > 1:
                replicates[row, column, at, drawn] = drawings
    units = units_of(results)
    dims = ("scenario", "method_key", "metric")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # no replicates, no error
        spread = np.nanstd(replicates, axis=-1)
    labels = [name if own in ("", MAIN) else f"{own} {name}" for own, name in every]
    known_units = {name: unit for name, (unit, _) in METRICS.items()} | {PATHWAY: PERCENT}
    switches = [
        wave_of(results.time.values, truth) is not None
        for truth in results.truth.sel(quantity=MAIN).values
    ]
    return xr.Dataset(
        {
            "value": (dims, value),
            "standard_error": (dims, spread),
            "replicates": ((*dims, "draw"), replicates),
            "trials": (dims[:2], used.sum(axis=1)),
        },
        coords={
            name: coord
            for name, coord in results.coords.items()
            if set(coord.dims) <= {"scenario", "method_key"}
        }
        | {
            "metric": labels,
            "measure": ("metric", [name for _, name in every]),
            "quantity": ("metric", [quantity for quantity, _ in every]),
            "unit": (
                "metric",
                [
                    units[own] if own not in ("", MAIN) and name in ERRORS else known_units[name]
                    for own, name in every
                ],
            ),
            "switches": ("scenario", switches),
        },
        attrs=results.attrs,
    )


Measured = Iterator[tuple[tuple[str, str], Value, Value]]


def _of_quantities(one: xr.Dataset, weights: Array) -> Measured:
    """Yield quantity and name, value and replicates of the metrics of a scenario and method."""
    for quantity in map(str, one.quantity.values):
        own = one.sel(quantity=quantity)
        truth, estimates = own.truth.values, own.estimate.values
        if "trial_truth" in own:
            estimates = estimates - (own.trial_truth.values - truth)
        if quantity != MAIN and not (np.isfinite(truth).any() and np.isfinite(estimates).any()):
            continue
        cell = Cell(
            one.time.values,
            truth,
            estimates,
            own.covered.values,
            own.time_varying_vaf.values,
            own.vaf.values[:, 0],
            own.bandpassed_vaf.values[:, 0],
            own.seconds.values,
        )
        names = [
            name for name in (METRICS if quantity == MAIN else OF_QUANTITY) if name != "failed"
        ]
        names = [name for name in names if cell.wave is not None or name not in OF_SWITCHES]
        values = {name: METRICS[name][1](cell) for name in names}
        drawings = dict.fromkeys(names, np.nan)
        if len(estimates) > 1:
            drawings = _replicates(attrs.evolve(cell, weights=weights), names)
        else:
            values["random_error"] = np.nan  # one trial has no spread that could be told
        yield from (((quantity, name), values[name], drawings[name]) for name in names)


def _of_pathways(one: xr.Dataset, weights: Array) -> Measured:
    for name in map(str, one.pathway.values) if PATHWAY in one else ():
        values = one[PATHWAY].sel(pathway=name).values[:, 0]
        yield (name, PATHWAY), weighted_mean(values, None), weighted_mean(values, weights)


def _replicates(cell: Cell, names: list[str]) -> dict[str, Value]:
    """Return replicates of metrics, centred on the measured value.

    A draw varies less than what it is drawn from, by (M - 1) / M. Its bias holds the random
    error's part twice, the sample's and that of drawing from it, so that of the random error, as
    the draw has it, (2M - 1) / (M - 1)² is taken from the square of the bias instead of 1 / (M -
    1).
    """
    count, debiased = len(cell.estimates), "debiased_bias_error"
    found = {name: METRICS[name][1](cell) for name in names if name != debiased}
    part = np.square(found["random_error"]) * (2 * count - 1) / (count - 1) ** 2
    found[debiased] = np.sqrt(np.maximum(0.0, np.square(found["bias_error"]) - part))
    for name in found:
        if name == "random_error" or name.startswith("time_varying_vaf_sd"):
            found[name] *= np.sqrt(count / (count - 1))
    return found


def asked(results: xr.Dataset) -> NDArray[np.bool_]:
    """Return which methods identify each scenario, (scenario, method_key): all by default."""
    shape = results.sizes["scenario"], results.sizes["method_key"]
    every = np.ones(shape, dtype=bool)
    return np.asarray(results.asked.values) if "asked" in results.coords else every


def units_of(results: xr.Dataset) -> dict[str, str]:
    """Return the unit of each quantity for tables; empty if unknown."""
    units = [unit.replace(" ", "·").replace("m2", "m²") for unit in map(str, results.unit.values)]
    return dict(zip(map(str, results.quantity.values), units, strict=True))


def wave_of(time: Array, truth: Array) -> SquareWave | None:
    """Return the square wave that a truth is over one realization, if it is one."""
    levels = np.unique(truth)
    if len(levels) != 2 or not np.isfinite(levels).all():
        return None
    low, high = map(float, levels)
    step = float(time[1] - time[0])
    upward = np.flatnonzero((truth == high) & (np.roll(truth, 1) == low))
    wave = SquareWave(low, high, len(time) * step / len(upward), float(time[upward[0]]))
    beside = from_switch(time, wave) < 1.5 * step  # a switch between two samples is rounded
    return wave if (beside | (wave(time) == truth)).all() else None


def from_switch(time: Array, wave: SquareWave) -> Array:
    """Return the seconds from the nearest switch."""
    half = wave.period / 2
    return np.asarray(np.abs((time - wave.offset + half / 2) % half - half / 2))


def time_spent(results: xr.Dataset) -> dict[str, float]:
    """Return the seconds of each stage and each method over all workers, in order of the work."""
    stages = results.stage_seconds.sum(["scenario", "trial"]).to_series().to_dict()
    methods = results.seconds.sum(["scenario", "trial"]).to_series().to_dict()
    last = {"scoring": stages.pop("scoring")}
    return {str(name): seconds for name, seconds in (stages | methods | last).items()}
