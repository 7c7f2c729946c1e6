"""From the trials of a simulation study to its metrics, and how sure they are."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Iterator, Mapping
from functools import cache, cached_property, reduce
from typing import TYPE_CHECKING

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid import metrics
from tvsysid.metrics import weighted_mean
from tvsysid.metrics.errors import Value
from tvsysid.numerics import Array
from tvsysid.simulate import SquareWave

if TYPE_CHECKING:
    import xarray as xr

Weights = Array | None

DRAWS = 1000  # bootstrap draws
WEIGHTS = 2_000_000
"""Maximum number of draw-trial weights kept in memory. Very many trials get fewer draws."""
AT_SWITCH = 0.05  # seconds to either side of a switch that are at it
AWAY = 0.3  # seconds from a switch beyond which no window or lag of the paper's methods reaches it
MAIN = "stiffness"  # the quantity whose metrics go by their plain names
PATHWAY = "pathway_vaf"  # metric of each pathway, whose name stands in the quantity's place
SCORED = (
    *("estimate", "covered", "time_varying_vaf", "vaf", "bandpassed_vaf", "seconds"),
    "truth",
    "trial_truth",
    PATHWAY,
)
"""Variables of a study that metrics are made from."""


@attrs.frozen
class Cell:
    """What the trials of one method in one scenario gave of one quantity.

    Attributes are named as metrics' arguments.

    ``time`` and ``truth`` have shape (time,); estimates, whether their bands hold the truth, and
    time-varying VAF (``over_time``) (trial, time); the trials' mean VAFs and the seconds that
    the identifications took (trial,). Where the truth differs from trial to trial, the
    estimate's error is added to the truth of the study. ``weights`` of the trials, shape (draw,
    trial), are for replicates.
    """

    time: Array
    truth: Array
    estimates: Array
    covered: Array
    over_time: Array
    realization_vaf: Array
    bandpassed: Array
    durations: Array
    weights: Weights = None

    @cached_property
    def wave(self) -> SquareWave | None:
        """Wave that the truth is, if it has two levels and switches."""
        return wave_of(self.time, self.truth)

    @cached_property
    def from_switch(self) -> Array:
        """Seconds from the nearest switch, shape (time,)."""
        assert self.wave is not None
        return from_switch(self.time, self.wave)

    @cached_property
    def at(self) -> NDArray[np.bool_]:
        """Times at a switch."""
        return np.asarray(self.from_switch <= AT_SWITCH + 1e-9)

    @cached_property
    def away(self) -> NDArray[np.bool_]:
        """Times far from any."""
        return np.asarray(self.from_switch >= AWAY)

    @cached_property
    def mean_over_time(self) -> Array:
        """Time-varying VAF, mean over trials; shape (..., time)."""
        return weighted_mean(self.over_time, self.weights)

    @cached_property
    def deviation(self) -> Array:
        """Standard deviation over trials of the time-varying VAF; shape (..., time)."""
        own = self.over_time - self.over_time.mean(axis=0)
        variance = weighted_mean(np.square(own), self.weights) - np.square(
            weighted_mean(own, self.weights)
        )
        return np.asarray(np.sqrt(np.maximum(0.0, variance)))

    def measured(self, name: str) -> Value:
        """Return a metric of the catalogue or the study, one value for each set of weights."""
        if name in OWN:
            return OWN[name][1](self)
        given = {each: getattr(self, each) for each in _arguments(name) if hasattr(self, each)}
        return metrics.CATALOGUE[name].function(**given)


@cache
def _arguments(name: str) -> tuple[str, ...]:
    return tuple(inspect.signature(metrics.CATALOGUE[name].function).parameters)


def wave_of(time: Array, truth: Array) -> SquareWave | None:
    """Return the square wave that a truth is over one realization, if it is one."""
    levels = np.unique(truth)
    if len(levels) != 2 or not np.isfinite(levels).all():
        return None
    low, high = map(float, levels)
    upward = np.flatnonzero((truth == high) & (np.roll(truth, 1) == low))
    whole = len(time) * float(time[1] - time[0])
    wave = SquareWave(low, high, whole / len(upward), float(time[upward[0]]))
    beside = from_switch(time, wave) < 1.5 * float(
        time[1] - time[0]
    )  # where a switch between two samples is rounded
    return wave if (beside | (wave(time) == truth)).all() else None


def from_switch(time: Array, wave: SquareWave) -> Array:
    """Return the seconds from the nearest switch."""
    half = wave.period / 2
    return np.asarray(np.abs((time - wave.offset + half / 2) % half - half / 2))


def _rise(cell: Cell) -> Value:
    """Return the time from 10 to 90 % of the step."""
    assert cell.wave is not None
    step = cell.wave.high - cell.wave.low
    low, high = cell.wave.low + 0.1 * step, cell.wave.high - (1 - 0.9) * step
    return metrics.rise_time(
        cell.time, cell.estimates, low, high, cell.wave.offset, weights=cell.weights
    )


def _dip(cell: Cell) -> Value:
    """Return the mean away from the switches less that at the switches."""
    over_time = cell.mean_over_time
    known = np.isfinite(over_time).reshape(-1, len(cell.time)).all(axis=0)
    at, away = known & cell.at, known & cell.away
    if not (at.any() and away.any()):
        return np.full(over_time.shape[:-1], np.nan)
    return over_time[..., away].mean(axis=-1) - over_time[..., at].mean(axis=-1)


def _lowest(cell: Cell) -> Value:
    values = cell.mean_over_time
    known = np.isfinite(values)
    return np.where(known.any(axis=-1), np.min(values, axis=-1, where=known, initial=100.0), np.nan)


def _spread(cell: Cell, side: int) -> Value:
    """Return the mean SD over trials at all times (0), or for a low (-1) or high (1) truth."""
    deviation = cell.deviation
    known = np.isfinite(deviation).reshape(-1, len(cell.time)).all(axis=0)
    chosen = deviation[
        ..., known & ((side == 0) | (np.sign(cell.truth - cell.truth.mean()) == side))
    ]
    return chosen.mean(axis=-1) if chosen.shape[-1] else np.full(deviation.shape[:-1], np.nan)


POINTS = "percentage points"
OWN: dict[str, tuple[str, Callable[[Cell], Value]]] = {
    "rise_time": ("s", _rise),
    "vaf": ("%", lambda cell: weighted_mean(cell.realization_vaf, cell.weights)),
    "bandpassed_vaf": ("%", lambda cell: weighted_mean(cell.bandpassed, cell.weights)),
    "coverage": ("%", lambda cell: metrics.share_covered(cell.covered, cell.weights)),
    "lowest_vaf": (
        "%",
        lambda cell: cell.realization_vaf.min() if cell.weights is None else np.nan,
    ),
    "lowest_time_varying_vaf": ("%", _lowest),
    "switch_dip": (POINTS, _dip),
    "time_varying_vaf_sd": (POINTS, lambda cell: _spread(cell, 0)),
    "time_varying_vaf_sd_soft": (POINTS, lambda cell: _spread(cell, -1)),
    "time_varying_vaf_sd_stiff": (POINTS, lambda cell: _spread(cell, 1)),
    "coverage_at_switch": (
        "%",
        lambda cell: metrics.share_covered(cell.covered[:, cell.at], cell.weights),
    ),
    "coverage_away": (
        "%",
        lambda cell: metrics.share_covered(cell.covered[:, cell.away], cell.weights),
    ),
    "without_band": (
        "%",
        lambda cell: 100 * weighted_mean(np.isnan(cell.covered).mean(axis=1), cell.weights),
    ),
    "left_out": (
        "samples",
        lambda cell: metrics.left_out(cell.estimates) if cell.weights is None else np.nan,
    ),
    "failed": ("trials", lambda cell: np.nan),
    "seconds": ("s", lambda cell: weighted_mean(cell.durations, cell.weights)),
}
"""Unit and function of further metrics: those beside the catalogue, and of a single trial."""
UNITS = {
    name: metric.unit for name, metric in metrics.CATALOGUE.items() if name != "time_varying_vaf"
} | {name: unit for name, (unit, _) in OWN.items()}  # fmt: skip
"""Of every metric that is computed."""
OF_SWITCHES = (
    "rise_time",
    "switch_dip",
    "coverage_at_switch",
    "coverage_away",
)  # metrics of a stiffness that switches
ERRORS = ("bias_error", "debiased_bias_error", "mean_bias", "random_error", "total_error")
OF_QUANTITY = (*ERRORS, "coverage", "without_band", "left_out")
"""Metrics of each quantity that is both estimated and known."""


def score(results: xr.Dataset) -> xr.Dataset:
    """Return every metric of every scenario and method, with bootstrap replicates.

    A replicate is the metric of trials drawn with replacement. The same draws serve all methods and
    scenarios, so that the uncertainty of a difference between methods, which see the same data, is
    that of the difference of their replicates.

    The results are those of :func:`tvsysid.study.run` of a simulation study, finished or not.
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

    count = results.sizes["trial"]
    draws = min(DRAWS, max(DRAWS // 10, WEIGHTS // count))
    chosen = np.random.default_rng(0).multinomial(count, np.full(count, 1 / count), size=draws)
    time, truths = results.time.values, results.truth.sel(quantity=MAIN).values
    known, units = [str(name) for name in results.quantity.values], units_of(results)
    every = [(MAIN if name in (*OF_QUANTITY, "rise_time") else "", name) for name in UNITS]
    every += [(quantity, name) for quantity in known if quantity != MAIN for name in OF_QUANTITY]
    pathways = [str(name) for name in results.pathway.values] if PATHWAY in results else []
    every += [(name, PATHWAY) for name in pathways]
    place_of = {each: number for number, each in enumerate(every)}
    shape = (results.sizes["scenario"], results.sizes["method_key"], len(every))
    value, replicates = np.full(shape, np.nan), np.full((*shape, draws), np.nan)
    failed = np.asarray(results.failure.values != "")
    value[..., place_of["", "failed"]] = failed.sum(axis=1)
    used = asked(results)[:, None] & ~failed
    for row in range(shape[0]):
        here = {name: results[name].isel(scenario=row).values for name in SCORED if name in results}
        for column in np.flatnonzero(used[row].any(axis=0)).tolist():
            mine = used[row, :, column]
            weights = chosen[:, mine].astype(np.float64)
            drawn = weights.any(axis=1)
            for number, quantity in enumerate(known):
                cell = _cell(time, here, column, number, mine)
                for name, measured, drawings in _measured(cell, quantity == MAIN, weights[drawn]):
                    at = place_of.get((quantity, name), place_of.get(("", name), 0))
                    value[row, column, at] = measured
                    if len(cell.estimates) > 1:
                        replicates[row, column, at, drawn] = drawings
            for number, name in enumerate(pathways):
                values, at = here[PATHWAY][mine, column, number, 0], place_of[name, PATHWAY]
                value[row, column, at] = weighted_mean(values, None)
                if len(values) > 1:
                    replicates[row, column, at, drawn] = weighted_mean(values, weights[drawn])
    dims = ("scenario", "method_key", "metric")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # no replicates, no error
        spread = np.nanstd(replicates, axis=-1)
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
            "metric": [
                name if quantity in ("", MAIN) else f"{quantity} {name}" for quantity, name in every
            ],
            "measure": ("metric", [name for _, name in every]),
            "quantity": ("metric", [quantity for quantity, _ in every]),
            "unit": (
                "metric",
                [
                    units[quantity]
                    if quantity not in ("", MAIN) and name in ERRORS
                    else (UNITS | {PATHWAY: "%"})[name]
                    for quantity, name in every
                ],
            ),
            "switches": ("scenario", [wave_of(time, each) is not None for each in truths]),
        },
        attrs=results.attrs,
    )


def asked(results: xr.Dataset) -> NDArray[np.bool_]:
    """Return which methods identify each scenario, (scenario, method_key).

    All of them unless the study says otherwise.
    """
    shape = results.sizes["scenario"], results.sizes["method_key"]
    return (
        np.asarray(results.asked.values)
        if "asked" in results.coords
        else np.ones(shape, dtype=bool)
    )


def units_of(results: xr.Dataset) -> dict[str, str]:
    """Return the unit of each quantity for tables; empty if unknown."""
    found = zip(results.quantity.values, results.unit.values, strict=True)
    changes = {"N m s": "N·m·s", "N m": "N·m", "kg m2": "kg·m²"}
    return {
        str(name): reduce(lambda unit, each: unit.replace(*each), changes.items(), str(unit))
        for name, unit in found
    }


def _cell(
    time: Array, here: Mapping[str, Array], column: int, quantity: int, used: NDArray[np.bool_]
) -> Cell:
    """Return one method's results in the used trials of a scenario."""
    truth = here["truth"][quantity]
    estimates = here["estimate"][used, column, quantity]
    if "trial_truth" in here:
        estimates = estimates - (here["trial_truth"][used, quantity] - truth)
    return Cell(
        time=time,
        truth=truth,
        estimates=estimates,
        covered=here["covered"][used, column, quantity],
        over_time=here["time_varying_vaf"][used, column],
        realization_vaf=here["vaf"][used, column, 0],
        bandpassed=here["bandpassed_vaf"][used, column, 0],
        durations=here["seconds"][used, column],
    )


def _measured(cell: Cell, main: bool, weights: Array) -> Iterator[tuple[str, Value, Value]]:
    """Yield each metric with its value and its replicates for weights (draw, trial)."""
    if not main and not (np.isfinite(cell.truth).any() and np.isfinite(cell.estimates).any()):
        return
    names = [name for name in (UNITS if main else OF_QUANTITY) if name != "failed"]
    names = [name for name in names if cell.wave is not None or name not in OF_SWITCHES]
    values = {name: cell.measured(name) for name in names}
    if len(cell.estimates) < 2:
        values["random_error"] = np.nan  # one trial has no spread that could be told
        yield from ((name, value, np.nan) for name, value in values.items())
        return
    drawn = attrs.evolve(cell, weights=weights)
    found = {name: drawn.measured(name) for name in names if name != "debiased_bias_error"}
    _undraw(found, len(cell.estimates))
    yield from ((name, value, found[name]) for name, value in values.items())


def _undraw(found: dict[str, Value], count: int) -> None:
    """Centre the replicates on the measured value.

    A draw varies less than what it is drawn from, by (M - 1) / M. Its bias holds the random
    error's part twice, the sample's and that of drawing from it, so that of the random error, as
    the draw has it, (2M - 1) / (M - 1)² is taken from the square of the bias instead of 1 / (M -
    1).
    """
    part = np.square(found["random_error"]) * (2 * count - 1) / (count - 1) ** 2
    found["debiased_bias_error"] = np.sqrt(np.maximum(0.0, np.square(found["bias_error"]) - part))
    spreads = {
        "random_error",
        *(f"time_varying_vaf_sd{ending}" for ending in ("", "_soft", "_stiff")),
    }
    for name in spreads & found.keys():
        found[name] *= np.sqrt(count / (count - 1))


def time_spent(results: xr.Dataset) -> dict[str, float]:
    """Return the seconds of each stage and each method over all workers, in order of the work."""
    stages = results.stage_seconds.sum(["scenario", "trial"])
    methods = results.seconds.sum(["scenario", "trial"])
    before, after = (
        {name: float(stages.sel(stage=name)) for name in names}
        for names in (("simulation", "preprocessing"), ("scoring",))
    )
    identified = {
        str(name): float(methods.sel(method_key=name)) for name in results.method_key.values
    }
    return before | identified | after
