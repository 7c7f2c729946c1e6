"""What van de Ruit et al. (2021) say their simulations show, held against the figures of a study.

There is a margin for each scenario and rival (:mod:`tvsysid.studies.verdicts`), with limits from drawing trials.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import beta

from tvsysid.studies.verdicts import COLUMNS, FAILS, HOLDS, NOT_STUDIED, RATIO, UNDECIDED, Claim, judged

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[np.float64]

FIVE = ("eirf", "sds", "birf", "esm", "kbr")
THE_FIVE = "all five methods with their own settings"
RATIOS = ("random_error", "total_error")
"""Metrics that are compared by their ratio: their uncertainty is in proportion to them."""
NAMES = {
    "debiased_bias_error": "bias (freed of random error)",
    "random_error": "random error",
    "total_error": "total error",
    "rise_time": "rise time",
    "vaf": "VAF",
    "switch_dip": "dip",
    "time_varying_vaf_sd": "spread of the time-varying VAF",
}
FEWEST = 10
"""Trials below which limits from drawing among them are too narrow to decide by."""
FEW_HUNDRED_S = 300.0
"""Seconds of data from which there are "a few hundred realizations" of 2 s: 150 in the shortest."""
ALIKE = 0.25
"""Relative difference below which an error counts as little changed."""
DIP = 1.0
"""Percentage points that a time-varying VAF is lower at the switches than away from them if it dips."""


@dataclass(frozen=True)
class Replicated:
    """A margin with its bootstrap replicates, shape (draw,)."""

    words: str
    estimate: float
    replicates: Array

    def limits(self, tail: float) -> tuple[float, float]:
        """Percentiles of the replicates; NaN where there are none."""
        known = self.replicates[~np.isnan(self.replicates)]
        if not len(known):
            return np.nan, np.nan
        low, high = np.quantile(known, [tail, 1 - tail], method="nearest")
        return float(low), float(high)


def judge_simulations(scores: xr.Dataset) -> pd.DataFrame:
    """Hold every claim of the paper's simulation study against the scores of a study."""
    trials = int(scores.trials.max())
    # A draw of few trials may be of one alone, which has no spread to take the logarithm of.
    with np.errstate(divide="ignore", invalid="ignore"):
        found = [list(claim.margins(scores)) if _all_there(scores) else [] for claim in CLAIMS]
    too_few = f"Takes at least {FEWEST} trials." if trials < FEWEST else ""
    rows = [
        judged(claim, margins, also=THE_FIVE, too_few=too_few, more="trials")
        for claim, margins in zip(CLAIMS, found, strict=True)
    ]
    rows += [_all_above(scores, *floor) for floor in FLOORS]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _all_above(scores: Any, stiffness: str, floor: float, source: str) -> tuple[Any, ...]:
    """Row for the claim that every VAF is above a floor, with a limit on the share of trials that are not."""
    name = {"square": "square wave", "sine": "sine"}[stiffness]
    sentence = f"Every VAF is above {floor:g} % ({name})"
    unit = "percentage points"
    nothing = (np.nan, np.nan, np.nan, unit)
    cells = _cells(scores, stiffness=stiffness)
    if not cells or not _all_there(scores):
        return (sentence, source, "", *nothing, NOT_STUDIED, f"Needs a {name} at 10 dB and {THE_FIVE}.")
    here = scores.sel(scenario=cells, method_key=list(FIVE))
    trials = int(here.trials.min())
    if not trials or here.value.sel(metric="lowest_vaf").isnull().any():
        return (sentence, source, "", *nothing, UNDECIDED, "A method gave no results.")
    lowest = here.value.sel(metric="lowest_vaf")
    worst = lowest.isel(lowest.argmin(...))
    margin = float(worst) - floor
    place = f"{worst.method_key.item()}, {_where(scores, worst.scenario.item())}"
    found = f"lowest mean VAF of a trial: {float(worst):.1f} % ({place})"
    if margin > 0:
        # With none of n below, the share of such trials is under this with 95 % confidence (Clopper and Pearson).
        share = float(beta.ppf(0.95, 1, trials))
        found += f"; none is below, so in each scenario fewer than {100 * share:.2g} % are (95 % confidence)"
    remark = "The paper does not say over what it is taken: here, the mean over the realizations of a trial."
    verdict = FAILS if margin <= 0 else HOLDS if trials >= FEWEST else UNDECIDED
    return (sentence, source, found, margin, np.nan, np.nan, unit, verdict, remark)


def _all_there(scores: Any) -> bool:
    return set(FIVE) <= {str(label) for label in scores.method_key.values}


def _cells(scores: Any, stiffness: str = "square", viscosity: str = "constant", least_s: float = 0.0) -> list[str]:
    """Scenarios like the paper's, 10 dB."""
    chosen = (
        (scores.profile == stiffness)
        & (scores.viscosity == viscosity)
        & (scores.snr_db == 10)
        & (scores.duration_s >= least_s)
    )
    return [str(label) for label in scores.scenario.values[chosen.values]]


def _where(scores: Any, cell: str) -> str:
    place = scores.indexes["scenario"].get_loc(cell)
    perturbation = "PRBS" if scores.perturbation.values[place] == "prbs" else "noise"
    return f"{perturbation}, {scores.duration_s.values[place]:g} s"


def _figures(scores: Any, cell: str, method: str, metric: str) -> Array:
    """A metric and its replicates behind it, so that what is done with the one is done with the others."""
    labels = {"scenario": cell, "method_key": method, "metric": metric}
    place = tuple(scores.indexes[name].get_loc(label) for name, label in labels.items())
    return np.append(scores.value.values[place], scores.replicates.values[place])


def _margin(words: str, figures: Array) -> Replicated:
    return Replicated(words, float(figures[0]), figures[1:])


def _within(words: str, logarithms: Array) -> Iterator[Replicated]:
    """That a ratio is one to within a quarter: a margin on each side."""
    for sign in (1, -1):
        yield _margin(words, np.log1p(ALIKE) - sign * logarithms)


def _amount(metric: str, value: float) -> str:
    if metric == "rise_time":
        return f"{value:.2f} s"
    return f"{value:.1f} {'%' if metric == 'vaf' else 'points' if 'vaf' in metric or 'dip' in metric else 'N·m/rad'}"


def _more(scores: Any, cell: str, metric: str, high: str, low: str) -> Replicated:
    """That a metric of one method is above that of another."""
    above, below = (_figures(scores, cell, method, metric) for method in (high, low))
    figures = f"{high} {_amount(metric, above[0])}, of {low} {_amount(metric, below[0])}"
    words = f"{NAMES[metric]} of {figures} ({_where(scores, cell)})"
    return _margin(words, np.log(above / below) if metric in RATIOS else above - below)


def _extreme(metric: str, method: str, highest: bool, **where: Any) -> Callable[[Any], Iterator[Replicated]]:
    """That one method has the highest or the lowest of all."""

    def margins(scores: Any) -> Iterator[Replicated]:
        for cell in _cells(scores, **where):
            for other in FIVE:
                if other != method:
                    pair = (method, other) if highest else (other, method)
                    yield _more(scores, cell, metric, *pair)

    return margins


def _between(metric: str, low: str, high: str) -> Callable[[Any], Iterator[Replicated]]:
    """That sds, esm and kbr lie between two methods."""

    def margins(scores: Any) -> Iterator[Replicated]:
        for cell in _cells(scores):
            for method in ("sds", "esm", "kbr"):
                yield _more(scores, cell, metric, method, low)
                yield _more(scores, cell, metric, high, method)

    return margins


def _lowest_two(metric: str, pair: tuple[str, str]) -> Callable[[Any], Iterator[Replicated]]:
    """That two methods have the lowest of all, with the sine."""

    def margins(scores: Any) -> Iterator[Replicated]:
        for cell in _cells(scores, stiffness="sine"):
            for method in pair:
                for other in FIVE:
                    if other not in pair:
                        yield _more(scores, cell, metric, other, method)

    return margins


def _durations(scores: Any) -> Iterator[list[str]]:
    """The cells of each perturbation, shortest first, where there are several."""
    for perturbation in ("noise", "prbs"):
        cells = [cell for cell in _cells(scores) if str(scores.perturbation.sel(scenario=cell).values) == perturbation]
        cells.sort(key=lambda cell: float(scores.duration_s.sel(scenario=cell)))
        if len(cells) > 1:
            yield cells


def _falls_most(scores: Any) -> Iterator[Replicated]:
    """That eirf's random error falls by the largest factor from the least to the most data."""
    for cells in _durations(scores):
        ends = cells[0], cells[-1]
        falls = {}
        for method in FIVE:
            first, last = (_figures(scores, cell, method, "random_error") for cell in ends)
            falls[method] = np.log(first / last)
        own = falls.pop("eirf")
        for method, fall in falls.items():
            words = (
                f"from {_where(scores, ends[0])} to {_where(scores, ends[1])} the random error of eirf falls "
                f"{np.exp(own[0]):.1f}-fold, of {method} {np.exp(fall[0]):.1f}-fold"
            )
            yield _margin(words, own - fall)


def _improves_above_40(scores: Any) -> Iterator[Replicated]:
    """That doubling 40 s does more to eirf's random error than the root of two that any average gives."""
    for cells in _durations(scores):
        pair = [cell for cell in cells if float(scores.duration_s.sel(scenario=cell)) in (40.0, 80.0)]
        if len(pair) == 2:
            first, last = (_figures(scores, cell, "eirf", "random_error") for cell in pair)
            words = (
                f"random error of eirf {first[0]:.1f} N·m/rad ({_where(scores, pair[0])}), {last[0]:.1f} N·m/rad "
                f"({_where(scores, pair[1])}): {first[0] / last[0]:.1f}-fold, where averaging alone gives 1.4-fold"
            )
            yield _margin(words, np.log(first / last) - np.log(2) / 2)


def _dips(methods: tuple[str, ...], sign: int) -> Callable[[Any], Iterator[Replicated]]:
    """That the time-varying VAF of methods dips near the switches (sign 1), or does not (-1)."""

    def margins(scores: Any) -> Iterator[Replicated]:
        for cell in _cells(scores):
            for method in methods:
                dip = _figures(scores, cell, method, "switch_dip")
                words = f"time-varying VAF of {method} dips by {dip[0]:.1f} points ({_where(scores, cell)})"
                yield _margin(words, sign * (dip - DIP))

    return margins


def _alike(scores: Any, pairs: Iterator[tuple[str, str]], metrics: tuple[str, ...]) -> Iterator[Replicated]:
    """That metrics differ by less than a quarter between two scenarios; two margins each, one a side."""
    for one, other in pairs:
        for method in FIVE:
            for metric in metrics:
                first, last = (_figures(scores, cell, method, metric) for cell in (one, other))
                words = (
                    f"{NAMES[metric]} of {method} {first[0]:.1f} N·m/rad ({_where(scores, one)}), {last[0]:.1f} "
                    f"N·m/rad ({_where(scores, other)}{_viscosity(scores, other)})"
                )
                yield from _within(words, np.log(last / first))


def _viscosity(scores: Any, cell: str) -> str:
    return ", viscosity covarying" if str(scores.viscosity.sel(scenario=cell).values) == "covarying" else ""


def _mostly_alike(metric: str) -> Callable[[Any], Iterator[Replicated]]:
    """That a metric differs little between perturbations in most conditions: methods and durations."""

    def margins(scores: Any) -> Iterator[Replicated]:
        sizes = []
        for pair in _pairs(scores, "perturbation", "noise", "prbs", _cells(scores)):
            for method in FIVE:
                first, last = (_figures(scores, cell, method, metric) for cell in pair)
                sizes.append(np.abs(np.log(last / first)))
        if not sizes or np.isnan([size[0] for size in sizes]).any():
            return
        little = np.array(sizes) < np.log1p(ALIKE)
        count = int(little[:, 0].sum())
        words = f"{NAMES[metric]} differs by less than {100 * ALIKE:g} % in {count} of {len(sizes)} conditions"
        yield _margin(words, little.mean(axis=0) - 0.5)

    return margins


def _viscosities_alike(scores: Any) -> Iterator[Replicated]:
    cells = [*_cells(scores), *_cells(scores, viscosity="covarying")]
    pairs = _pairs(scores, "viscosity", "constant", "covarying", cells)
    yield from _alike(scores, pairs, ("total_error", "random_error"))


def _pairs(scores: Any, setting: str, one: str, other: str, cells: list[str]) -> Iterator[tuple[str, str]]:
    """Scenarios that differ in one setting only."""
    names = ("profile", "perturbation", "duration_s", "snr_db", "viscosity")
    at = {tuple(scores[name].sel(scenario=cell).item() for name in names): cell for cell in cells}
    for settings, cell in at.items():
        changed = tuple(other if name == setting else value for name, value in zip(names, settings, strict=True))
        if settings[names.index(setting)] == one and changed in at:
            yield cell, at[changed]


def _noise_is_like_data(scores: Any) -> Iterator[Replicated]:
    """That 10 dB less noise lower the random error by the root of ten, as ten times the data do."""
    here = (scores.profile == "square") & (scores.viscosity == "constant")
    levels = {
        (str(cell.perturbation.values), float(cell.duration_s), float(cell.snr_db)): str(cell.scenario.values)
        for cell in (scores.isel(scenario=place) for place in np.flatnonzero(here.values))
    }
    for (perturbation, duration, snr), cell in levels.items():
        better = levels.get((perturbation, duration, snr + 10))
        if better is None:
            continue
        for method in FIVE:
            first, last = (_figures(scores, place, method, "random_error") for place in (cell, better))
            words = (
                f"random error of {method} {first[0]:.1f} N·m/rad at {snr:g} dB, {last[0]:.1f} N·m/rad at "
                f"{snr + 10:g} dB ({_where(scores, cell)})"
            )
            yield from _within(words, np.log(first / last) - np.log(10) / 2)


def _more_spread_when_soft(scores: Any) -> Iterator[Replicated]:
    for cell in _cells(scores, stiffness="sine"):
        for method in FIVE:
            soft, stiff = (
                _figures(scores, cell, method, f"time_varying_vaf_sd_{which}") for which in ("soft", "stiff")
            )
            words = (
                f"spread of the time-varying VAF of {method}: {soft[0]:.2f} points below the mean stiffness, "
                f"{stiff[0]:.2f} above ({_where(scores, cell)})"
            )
            yield _margin(words, soft - stiff)


def _more_spread_with_prbs(scores: Any) -> Iterator[Replicated]:
    for cell, other in _pairs(scores, "perturbation", "noise", "prbs", _cells(scores, stiffness="sine")):
        for method in FIVE:
            noise, prbs = (_figures(scores, place, method, "time_varying_vaf_sd") for place in (cell, other))
            words = (
                f"spread of the time-varying VAF of {method}: {prbs[0]:.2f} points with PRBS, {noise[0]:.2f} with noise"
            )
            yield _margin(words, prbs - noise)


STIFFNESS, POINTS, SHARE = "N·m/rad", "percentage points", "share of conditions beyond half"
SQUARE, SINE = "a square wave at 10 dB", "a sine at 10 dB"
DECIMATION = (
    "The low-pass before decimation smears every switch over some 30 ms, and noise does the rest: eirf errs there too, "
    "only far less than the others."
)
SINE_BIAS = (
    "Ten cubic B-splines represent a sine of the period almost exactly, so that little of birf's bias is left; esm's "
    "window of 0.3 s averages a curve that bends, and its estimate at 0 Hz leaks. An independent implementation finds "
    "the same."
)
VAF_RANKING = (
    "eirf estimates 25 numbers at each of 200 times and predicts with all their noise, so that against noiseless "
    "torque sds and kbr do better. Measured against noisy torque, as with people, the VAF rewards fitting the noise, "
    "and eirf has the highest; the paper's statement may come from there."
)
PERTURBATION = (
    "The noise is scaled to the torque, of which inertia takes a larger part with PRBS, and the two perturbations "
    "excite different bands: with PRBS the random error of esm is lower, that of sds and kbr higher."
)

RESIDUE = (
    "With little noise the random error no longer falls: what is left comes from the perturbation, which differs from "
    "trial to trial, where a method's model does not fit (switches within a window, leakage of esm). So the amounts of "
    "data tell what noise does only while it prevails, up to some 10 dB at 150 s."
)

CLAIMS: tuple[Claim, ...] = (
    Claim("eirf has the lowest bias", "3.4", _extreme("debiased_bias_error", "eirf", False), STIFFNESS, SQUARE),
    Claim("eirf has the highest random error", "3.4", _extreme("random_error", "eirf", True), RATIO, SQUARE),
    Claim("eirf has the shortest rise time", "3.4", _extreme("rise_time", "eirf", False), "s", SQUARE),
    Claim("birf has the largest bias", "3.4", _extreme("debiased_bias_error", "birf", True), STIFFNESS, SQUARE),
    Claim("birf has the smallest random error", "3.4", _extreme("random_error", "birf", False), RATIO, SQUARE),
    Claim(
        "sds, esm, kbr lie between in bias", "3.4", _between("debiased_bias_error", "eirf", "birf"), STIFFNESS, SQUARE
    ),
    Claim("sds, esm, kbr lie between in random error", "3.4", _between("random_error", "birf", "eirf"), RATIO, SQUARE),
    Claim("sds, esm, kbr lie between in rise time", "3.4", _between("rise_time", "eirf", "birf"), "s", SQUARE),
    Claim(
        "eirf is most sensitive to the amount of data", "3.4", _falls_most, RATIO, "several durations of a square wave"
    ),
    Claim(
        "eirf improves strongly above 40 s",
        "3.4",
        _improves_above_40,
        RATIO,
        "a square wave of 40 and of 80 s at 10 dB",
    ),
    Claim(
        "Given a few hundred realizations, eirf has the smallest total error",
        "5",
        _extreme("total_error", "eirf", False, least_s=FEW_HUNDRED_S),
        RATIO,
        f"{SQUARE} of {FEW_HUNDRED_S:g} s or more",
    ),
    Claim(
        "Given a few hundred realizations, eirf has the highest VAF",
        "5",
        _extreme("vaf", "eirf", True, least_s=FEW_HUNDRED_S),
        POINTS,
        f"{SQUARE} of {FEW_HUNDRED_S:g} s or more",
        VAF_RANKING,
    ),
    Claim(
        f"The time-varying VAF dips at the switches for sds, birf, esm and kbr (by more than {DIP:g} point)",
        "3.4",
        _dips(("sds", "birf", "esm", "kbr"), 1),
        POINTS,
        SQUARE,
    ),
    Claim(
        f"The time-varying VAF of eirf does not dip at the switches (by less than {DIP:g} point)",
        "3.4",
        _dips(("eirf",), -1),
        POINTS,
        SQUARE,
        DECIMATION,
    ),
    Claim(
        f"Under most conditions the total error hardly depends on the perturbation (less than {100 * ALIKE:g} %)",
        "3.4",
        _mostly_alike("total_error"),
        SHARE,
        f"{SQUARE} with both perturbations",
        PERTURBATION,
    ),
    Claim(
        f"Under most conditions the random error hardly depends on the perturbation (less than {100 * ALIKE:g} %)",
        "3.4",
        _mostly_alike("random_error"),
        SHARE,
        f"{SQUARE} with both perturbations",
        PERTURBATION,
    ),
    Claim(
        "With a sine, birf has the largest bias",
        "A",
        _extreme("debiased_bias_error", "birf", True, stiffness="sine"),
        STIFFNESS,
        SINE,
        SINE_BIAS,
    ),
    Claim(
        "With a sine, eirf varies most",
        "A",
        _extreme("random_error", "eirf", True, stiffness="sine"),
        RATIO,
        SINE,
    ),
    Claim(
        "With a sine, sds and kbr have the lowest bias",
        "A",
        _lowest_two("debiased_bias_error", ("sds", "kbr")),
        STIFFNESS,
        SINE,
        SINE_BIAS,
    ),
    Claim(
        "With a sine, birf and kbr have the lowest random error",
        "A",
        _lowest_two("random_error", ("birf", "kbr")),
        RATIO,
        SINE,
    ),
    Claim(
        "With a sine, the time-varying VAF varies more with PRBS than with noise",
        "A",
        _more_spread_with_prbs,
        POINTS,
        f"{SINE} with both perturbations",
    ),
    Claim(
        "With a sine, the time-varying VAF varies more where the stiffness is low",
        "A",
        _more_spread_when_soft,
        POINTS,
        SINE,
    ),
    Claim(
        "What noise does can be inferred from the amounts of data: 10 dB less lower the random error 3.2-fold, as ten "
        f"times the data do (to within {100 * ALIKE:g} %)",
        "5",
        _noise_is_like_data,
        RATIO,
        "noise of 10 dB more and less (the preset snr)",
        RESIDUE,
    ),
    Claim(
        f"Viscosity that covaries from 1 to 3 N·m·s/rad changes nothing (errors differ by less than {100 * ALIKE:g} %)",
        "5",
        _viscosities_alike,
        RATIO,
        "constant and covarying viscosity (the preset viscosity)",
    ),
)  # fmt: skip
FLOORS = (("square", 85.0, "3.4"), ("sine", 90.0, "A"))
"""Profile, floor of all VAFs in per cent, source."""
