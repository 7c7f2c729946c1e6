"""From the trials of a simulation study to its metrics, with bootstrap replicates."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import cached_property, partial
from typing import TYPE_CHECKING

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid import metrics
from tvsysid.metrics.errors import Value
from tvsysid.numerics import Array

if TYPE_CHECKING:
    import xarray as xr

DRAWS = 1000  # bootstrap draws
MAX_WEIGHTS = 2_000_000  # draw-trial weights kept in memory; very many trials get fewer draws
AT_SWITCH = 0.05  # seconds to either side of a switch that are at it
AWAY = 0.3  # seconds from a switch beyond which no window or lag of the paper's methods reaches it
MAIN = "stiffness"  # the quantity whose metrics have no quantity in their names
PATHWAY = "pathway_vaf"  # metric of each pathway, whose name takes the place of the quantity
NEWTON, PERCENT, POINTS = "N·m/rad", "%", "percentage points"


@attrs.frozen(slots=False)
class Cell:
    """Results of one method in the trials of one scenario, for one quantity.

    Parameters
    ----------
    time, truth
        Time in s, and the true values, shape (time,).
    estimate, covered, time_varying_vaf
        Estimates, whether bands hold the truth, and time-varying VAF, shape (trial, time).
    vaf, bandpassed_vaf, seconds
        Mean VAFs of the trials, and seconds of the identifications, shape (trial,).
    weights
        Weights of the trials, shape (draw, trial), for replicates.
    """

    time: Array
    truth: Array
    estimate: Array
    covered: Array
    time_varying_vaf: Array
    vaf: Array
    bandpassed_vaf: Array
    seconds: Array
    weights: Array | None = None

    @classmethod
    def of(cls, trials: xr.Dataset, quantity: str) -> Cell:
        """Return the cell of a dataset of the trials.

        Where the truth differs from trial to trial, the estimate's error is added to the mean
        truth.
        """
        own = trials.sel(quantity=quantity).isel(statistic=0)
        if "trial_truth" in own:
            own = own.assign(estimate=own.estimate - (own.trial_truth - own.truth))
        names = [field.name for field in attrs.fields(cls)[:-1]]
        return cls(**{name: own[name].values for name in names})

    @cached_property
    def distance(self) -> Array:
        """Seconds from the nearest switch; NaN if the truth does not switch."""
        return from_switch(self.time, self.truth)

    def near(self, low: float, high: float) -> NDArray[np.bool_]:
        """Return the times whose distance from a switch is in this range, in s."""
        return np.asarray((self.distance >= low) & (self.distance <= high + 1e-9))

    def mean(self, values: Array) -> Array:
        """Return the mean over trials."""
        return metrics.weighted_mean(values, self.weights)


def _error(cell: Cell, name: str) -> Value:
    """Return an error of the catalogue of metrics."""
    if name == "random_error" and len(cell.estimate) == 1:
        return np.nan  # one trial has no spread
    given = (cell.estimate,) if name == "random_error" else (cell.estimate, cell.truth)
    return metrics.CATALOGUE[name].function(*given, weights=cell.weights)


def _rise_time(cell: Cell) -> Value:
    """Return the time from 10 to 90 % of the first step upward."""
    if np.isnan(cell.distance).all():
        return np.nan
    low, high = np.unique(cell.truth)
    upward = np.flatnonzero((cell.truth == high) & (np.roll(cell.truth, 1) == low))
    levels = low + 0.1 * (high - low), high - (1 - 0.9) * (high - low)
    switch = float(cell.time[upward[0]])
    return metrics.rise_time(cell.time, cell.estimate, *levels, switch, weights=cell.weights)


def _switch_dip(cell: Cell) -> Value:
    """Return the time-varying VAF away from the switches less that at the switches."""
    mean = cell.mean(cell.time_varying_vaf)
    away, at = cell.near(AWAY, np.inf), cell.near(0, AT_SWITCH)
    return np.nanmean(mean[..., away], axis=-1) - np.nanmean(mean[..., at], axis=-1)


def _vaf_sd(cell: Cell, side: int = 0) -> Value:
    """Return the mean SD over trials at all times (0), or for a low (-1) or high (1) truth."""
    own = cell.time_varying_vaf - cell.time_varying_vaf.mean(axis=0)
    variance = cell.mean(np.square(own)) - np.square(cell.mean(own))
    chosen = (side == 0) | (np.sign(cell.truth - cell.truth.mean()) == side)
    return np.nanmean(np.sqrt(np.maximum(0.0, variance))[..., chosen], axis=-1)


def _coverage(cell: Cell, low: float, high: float) -> Value:
    """Return the share of bands that hold the truth, at these distances from a switch in s."""
    return metrics.share_covered(cell.covered[:, cell.near(low, high)], cell.weights)


ERRORS = ("bias_error", "debiased_bias_error", "mean_bias", "random_error", "total_error")
METRICS: dict[str, tuple[str, Callable[[Cell], Value]]] = {
    **{name: (NEWTON, partial(_error, name=name)) for name in ERRORS},
    "rise_time": ("s", _rise_time),
    "vaf": (PERCENT, lambda cell: cell.mean(cell.vaf)),
    "bandpassed_vaf": (PERCENT, lambda cell: cell.mean(cell.bandpassed_vaf)),
    "coverage": (PERCENT, lambda cell: metrics.share_covered(cell.covered, cell.weights)),
    "lowest_vaf": (PERCENT, lambda cell: cell.vaf.min()),
    "lowest_time_varying_vaf": (
        PERCENT,
        lambda cell: np.nanmin(cell.mean(cell.time_varying_vaf), axis=-1),
    ),
    "switch_dip": (POINTS, _switch_dip),
    "time_varying_vaf_sd": (POINTS, _vaf_sd),
    "time_varying_vaf_sd_soft": (POINTS, partial(_vaf_sd, side=-1)),
    "time_varying_vaf_sd_stiff": (POINTS, partial(_vaf_sd, side=1)),
    "coverage_at_switch": (PERCENT, partial(_coverage, low=0, high=AT_SWITCH)),
    "coverage_away": (PERCENT, partial(_coverage, low=AWAY, high=np.inf)),
    "without_band": (PERCENT, lambda cell: 100 * cell.mean(np.isnan(cell.covered).mean(axis=1))),
    "left_out": ("samples", lambda cell: metrics.left_out(cell.estimate)),
    "failed": ("trials", lambda cell: np.nan),
    "seconds": ("s", lambda cell: cell.mean(cell.seconds)),
}
"""Unit and function of each metric."""
OF_SWITCHES = ("rise_time", "switch_dip", "coverage_at_switch", "coverage_away")
"""Metrics of a stiffness that switches."""
OF_QUANTITY = (*ERRORS, "coverage", "without_band", "left_out")
"""Metrics of each quantity that is both estimated and known."""
OF_ALL_TRIALS = ("lowest_vaf", "left_out")
"""Metrics of all trials together, which have no replicates."""


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

    units = units_of(results)
    pathways = list(map(str, results.pathway.values)) if PATHWAY in results else []
    rows = [
        (MAIN if name in (*OF_QUANTITY, "rise_time") else "", name, *each)
        for name, each in METRICS.items()
    ]
    rows += [
        (other, name, units[other] if name in ERRORS else METRICS[name][0], METRICS[name][1])
        for other in units
        if other != MAIN
        for name in OF_QUANTITY
    ]
    rows += [(pathway, PATHWAY, *METRICS["vaf"]) for pathway in pathways]
    quantities, measures, metric_units, _ = zip(*rows, strict=True)
    count = results.sizes["trial"]
    chosen = np.random.default_rng(0).multinomial(count, np.full(count, 1 / count), size=DRAWS)
    failed = results.failure.transpose("scenario", "method_key", "trial").values != ""
    used = results.asked.values[..., None] & ~failed
    value = np.full((*used.shape[:2], len(rows)), np.nan)
    replicates = np.full((*value.shape, DRAWS), np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # the mean of nothing is NaN
        for place in zip(*np.nonzero(used.any(axis=-1)), strict=True):
            mine = used[place]
            weights = chosen[:, mine].astype(np.float64)
            drawn = weights.any(axis=1)
            cells = _cells(results.isel(scenario=place[0], method_key=place[1], trial=mine))
            for number, (quantity, name, _, function) in enumerate(rows):
                if (cell := cells.get(quantity)) is None:
                    continue
                value[place][number] = function(cell)
                if mine.sum() > 1 and name not in OF_ALL_TRIALS:
                    cell = attrs.evolve(cell, weights=weights[drawn])
                    replicates[place][number, drawn] = _replicates(cell, name, function)
        spread = np.nanstd(replicates, axis=-1)
    value[..., measures.index("failed")] = failed.sum(axis=-1)
    dims = ("scenario", "method_key", "metric")
    labels = [
        name if quantity in ("", MAIN) else f"{quantity} {name}" for quantity, name, *_ in rows
    ]
    return xr.Dataset(
        {
            "value": (dims, value),
            "standard_error": (dims, spread),
            "replicates": ((*dims, "draw"), replicates),
            "trials": (dims[:2], used.sum(axis=-1)),
        },
        {
            **{name: each for name, each in results.coords.items() if set(each.dims) <= {*dims}},
            "metric": labels,
            "measure": ("metric", list(measures)),
            "quantity": ("metric", list(quantities)),
            "unit": ("metric", list(metric_units)),
            "switches": (
                "scenario",
                [len(np.unique(truth)) == 2 for truth in results.truth.sel(quantity=MAIN).values],
            ),
        },
        results.attrs,
    )


def _cells(trials: xr.Dataset) -> dict[str, Cell]:
    """Return the cells of the stiffness, of other quantities that are known, and of pathways."""
    cells = {name: Cell.of(trials, name) for name in map(str, trials.quantity.values)}
    main = cells[MAIN]
    cells = {
        name: cell
        for name, cell in cells.items()
        if np.isfinite(cell.truth).any() and np.isfinite(cell.estimate).any()
    }
    for name in map(str, trials.pathway.values) if PATHWAY in trials else ():
        shares = trials[PATHWAY].sel(pathway=name).isel(statistic=0).values
        cells[name] = attrs.evolve(main, vaf=shares)
    return cells | {MAIN: main, "": main}


def _replicates(cell: Cell, name: str, function: Callable[[Cell], Value]) -> Value:
    """Return replicates of a metric, centred on the measured value.

    A draw varies less than what it is drawn from, by (M - 1) / M. Its bias holds the random
    error's part twice, the sample's and that of drawing from it, so that of the random error, as
    the draw has it, (2M - 1) / (M - 1)² is taken from the square of the bias instead of 1 / (M -
    1).
    """
    count = len(cell.estimate)
    if name == "debiased_bias_error":
        part = np.square(_error(cell, "random_error")) * (2 * count - 1) / (count - 1) ** 2
        return np.sqrt(np.maximum(0.0, np.square(_error(cell, "bias_error")) - part))
    is_spread = name == "random_error" or name.startswith("time_varying_vaf_sd")
    return function(cell) * (np.sqrt(count / (count - 1)) if is_spread else 1)


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
