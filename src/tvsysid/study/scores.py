"""From the draws of a study to its metrics, with bootstrap replicates."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import cached_property, partial
from typing import TYPE_CHECKING, NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid import metrics
from tvsysid.metrics.errors import Value
from tvsysid.numerics import Array
from tvsysid.study.dataset import axes_of

if TYPE_CHECKING:
    import xarray as xr

DRAWS = 1000  # replicates
AT_SWITCH = 0.05  # seconds to either side of a switch that are at it
AWAY = 0.3  # seconds from a switch beyond which no window or lag of the paper's methods reaches it
MAIN = "stiffness"  # the quantity whose metrics have no quantity in their names
PATHWAY = "pathway_vaf"  # metric of each pathway, whose name takes the place of the quantity
NEWTON, PERCENT, POINTS = "N·m/rad", "%", "percentage points"


@attrs.frozen(slots=False)
class Cell:
    """Results of one method in the draws of one case, for one quantity.

    Parameters
    ----------
    time, truth
        Time in s, and the true values, shape (time,).
    estimate, covered, time_varying_vaf
        Estimates, whether bands hold the truth, and time-varying VAF, shape (draw, time).
    vaf, bandpassed_vaf, seconds
        Mean VAFs of the draws, and seconds of the identifications, shape (draw,).
    resampled
        Whether the draws are bootstraps of a recording.
    weights
        Weights of the draws, shape (replicate, draw), for replicates.
    """

    time: Array
    truth: Array
    estimate: Array
    covered: Array
    time_varying_vaf: Array
    vaf: Array
    bandpassed_vaf: Array
    seconds: Array
    resampled: bool
    weights: Array | None = None

    @classmethod
    def of(cls, draws: xr.Dataset, quantity: str, resampled: bool) -> Cell:
        """Return the cell of a dataset of the draws.

        Where the truth differs from draw to draw, the estimate's error is added to the mean truth.
        """
        own = draws.sel(quantity=quantity).isel(statistic=0, missing_dims="ignore")
        if "trial_truth" in own:
            own = own.assign(estimate=own.estimate - (own.trial_truth - own.truth))
        if "covered" not in own:
            own = own.assign(covered=np.nan * own.estimate)
        names = [field.name for field in attrs.fields(cls)[:-2]]
        return cls(**{name: own[name].values for name in names}, resampled=resampled)

    @cached_property
    def distance(self) -> Array:
        """Seconds from the nearest switch; NaN if the truth does not switch."""
        return from_switch(self.time, self.truth)

    def near(self, low: float, high: float) -> NDArray[np.bool_]:
        """Return the times whose distance from a switch is in this range, in s."""
        return np.asarray((self.distance >= low) & (self.distance <= high + 1e-9))

    def mean(self, values: Array) -> Array:
        """Return the mean over draws."""
        return metrics.weighted_mean(values, self.weights)


def _error(cell: Cell, name: str) -> Value:
    """Return an error of the catalogue of metrics."""
    count = len(cell.estimate)
    if name == "random_error" and count == 1:
        return np.nan  # one draw has no spread
    given = (cell.estimate,) if name == "random_error" else (cell.estimate, cell.truth)
    value = metrics.CATALOGUE[name].function(*given, weights=cell.weights)
    # That of bootstraps is a standard error, whose variance has the divisor n - 1.
    is_unbiased = cell.resampled and name == "random_error"
    return value * np.sqrt(count / (count - 1)) if is_unbiased else value


def _mean(cell: Cell) -> Value:
    """Return the mean over times with an estimate in every draw."""
    known = np.isfinite(cell.estimate).all(axis=0)
    return cell.mean(cell.estimate[:, known].mean(axis=1))


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
    """Return the mean SD over draws at all times (0), or for a low (-1) or high (1) truth."""
    own = cell.time_varying_vaf - cell.time_varying_vaf.mean(axis=0)
    variance = cell.mean(np.square(own)) - np.square(cell.mean(own))
    chosen = (side == 0) | (np.sign(cell.truth - cell.truth.mean()) == side)
    return np.nanmean(np.sqrt(np.maximum(0.0, variance))[..., chosen], axis=-1)


def _coverage(cell: Cell, low: float, high: float) -> Value:
    """Return the share of bands that hold the truth, at these distances from a switch in s."""
    return metrics.share_covered(cell.covered[:, cell.near(low, high)], cell.weights)


ERRORS = ("bias_error", "debiased_bias_error", "mean_bias", "random_error", "total_error")
METRICS: dict[str, tuple[str, Callable[[Cell], Value]]] = {
    "mean": (NEWTON, _mean),
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
    "failed": ("draws", lambda cell: np.nan),
    "seconds": ("s", lambda cell: cell.mean(cell.seconds)),
}
"""Unit and function of each metric."""
OF_QUANTITY = ("mean", *ERRORS, "coverage", "without_band", "left_out")
"""Metrics of each quantity."""
OF_BANDS = ("coverage", "coverage_at_switch", "coverage_away", "without_band")
OF_ALL_DRAWS = ("lowest_vaf", "left_out")
"""Metrics of all draws together, which have no replicates."""


class Row(NamedTuple):
    """A metric of a quantity, or of a pathway; of the torque, the quantity is empty."""

    quantity: str
    measure: str
    unit: str

    @property
    def label(self) -> str:
        """Name of the metric."""
        return self.measure if self.quantity in ("", MAIN) else f"{self.quantity} {self.measure}"


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
        Along ``metric`` lie ``measure``, ``quantity`` (empty for metrics of the torque) and
        ``unit``: those of the stiffness go by the name of the measure, those of other quantities
        have their quantity before it (``"viscosity bias_error"``). Of an experiment ``value`` over
        (recording, analysis, metric) and ``bootstraps`` that count.

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
    rows = _metrics_of(results, f"{draw}s")
    random = np.random.default_rng(0)
    sizes = 0 if resampled else DRAWS
    chosen = random.multinomial(count, np.full(count, 1 / count), size=sizes)
    failed = results.failure.transpose(case, method, draw).values != ""
    asked = results.asked.values if "asked" in results.coords else np.ones(failed.shape[:2], bool)
    used = asked[..., None] & ~failed
    value = np.full((*used.shape[:2], len(rows)), np.nan)
    replicates = np.full((*value.shape, sizes), np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # the mean of nothing is NaN
        for place in zip(*np.nonzero(used.any(axis=-1)), strict=True):
            mine = used[place]
            weights = chosen[:, mine].astype(np.float64)
            drawn = weights.any(axis=1)
            own = results.isel({case: place[0], method: place[1], draw: mine})
            cells = _cells(own, resampled)
            for number, row in enumerate(rows):
                if (cell := cells.get(row.quantity)) is None:
                    continue
                function = METRICS.get(row.measure, METRICS["vaf"])[1]
                value[place][number] = function(cell)
                if mine.sum() > 1 and drawn.any() and row.measure not in OF_ALL_DRAWS:
                    weighted = attrs.evolve(cell, weights=weights[drawn])
                    replicates[place][number, drawn] = _replicates(weighted, row.measure, function)
        spread = np.nanstd(replicates, axis=-1)
    value[..., [row.measure for row in rows].index("failed")] = (asked[..., None] & failed).sum(-1)
    dims = (case, method, "metric")
    variables = {"value": (dims, value), f"{draw}s": (dims[:2], used.sum(axis=-1))}
    if not resampled:
        variables |= {
            "standard_error": (dims, spread),
            "replicates": ((*dims, "draw"), replicates),
        }
    return xr.Dataset(
        variables,
        {
            **{name: each for name, each in results.coords.items() if set(each.dims) <= {*dims}},
            "metric": [row.label for row in rows],
            "measure": ("metric", [row.measure for row in rows]),
            "quantity": ("metric", [row.quantity for row in rows]),
            "unit": ("metric", [row.unit for row in rows]),
        },
        results.attrs,
    )


def _metrics_of(results: xr.Dataset, draws: str) -> list[Row]:
    """Return the metrics of the stiffness and the torque, of other quantities, and of pathways."""
    units, own = units_of(results), (*OF_QUANTITY, "rise_time")
    of_main = {name: unit for name, (unit, _) in METRICS.items()} | {"failed": draws}
    rows = [Row(MAIN if name in own else "", name, unit) for name, unit in of_main.items()]
    for other in (each for each in units if each != MAIN):
        for name in OF_QUANTITY:
            unit = units[other] if METRICS[name][0] == NEWTON else METRICS[name][0]
            rows.append(Row(other, name, unit))
    pathways = map(str, results.pathway.values) if PATHWAY in results else ()
    rows += [Row(pathway, PATHWAY, PERCENT) for pathway in pathways]
    has_bands = "covered" in results
    return [row for row in rows if has_bands or row.measure not in OF_BANDS]


def _cells(draws: xr.Dataset, resampled: bool) -> dict[str, Cell]:
    """Return the cells of the quantities that are estimated, of the torque, and of pathways."""
    cells = {name: Cell.of(draws, name, resampled) for name in map(str, draws.quantity.values)}
    main = cells[MAIN]
    cells = {name: cell for name, cell in cells.items() if np.isfinite(cell.estimate).any()}
    for name in map(str, draws.pathway.values) if PATHWAY in draws else ():
        shares = draws[PATHWAY].sel(pathway=name).isel(statistic=0, missing_dims="ignore")
        cells[name] = attrs.evolve(main, vaf=shares.values)
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
