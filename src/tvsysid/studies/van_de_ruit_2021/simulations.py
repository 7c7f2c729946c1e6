"""Claims of van de Ruit et al. (2021) about their simulations.

The paper gives few thresholds. Those here are ours, and part of the sentences.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise, product
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import beta

from tvsysid.methods import PAPER_METHODS as FIVE
from tvsysid.numerics import Array
from tvsysid.studies.claims import (
    FAILS,
    HOLDS,
    MIN_TRIALS,
    NOT_STUDIED,
    RATIO,
    UNDECIDED,
    Claim,
    Comparison,
    Comparisons,
    Rows,
    Scores,
    compare,
    judge_claims,
    log_ratio,
)
from tvsysid.study.scenarios import Scenario

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

PERTURBATIONS = {"noise": "noise", "prbs": "PRBS"}
FEW_HUNDRED_S = 300.0  # seconds of "a few hundred realizations" of 2 s: 150 at least
ALIKE = 0.25  # relative difference below which an error counts as little changed
DIP = 1.0  # percentage points that a time-varying VAF is lower at the switches if it dips

BIAS, RANDOM, TOTAL, RISE = "debiased_bias_error", "random_error", "total_error", "rise_time"
VARIES, SOFT, STIFF = "time_varying_vaf_sd", "time_varying_vaf_sd_soft", "time_varying_vaf_sd_stiff"
NAMES = {
    BIAS: "bias (freed of random error)",
    RANDOM: "random error",
    TOTAL: "total error",
    RISE: "rise time",
    "vaf": "VAF",
}
AMOUNTS = {RISE: ".2f} s", "vaf": ".1f} %", "switch_dip": ".1f}"}
AMOUNTS |= dict.fromkeys((VARIES, SOFT, STIFF), ".2f}")
"""Formats of metrics that are not in N·m/rad."""
SQUARES: dict[str, Any] = {"stiffness": "square", "viscosity": "constant", "snr_db": 10.0}
SINES = SQUARES | {"stiffness": "sine"}


class PaperScores(Scores):
    """Scores of a study; claims need all five methods."""

    also = "all five methods with their own settings"

    def where(self, least_s: float = 0.0, **settings: object) -> list[Scenario]:
        """Return scenarios with these settings, if all five methods identify them."""
        methods = set(map(str, self.scores.method_key.values))
        return super().where(least_s, **settings) if set(FIVE) <= methods else []


def judge_simulations(scores: xr.Dataset) -> pd.DataFrame:
    """Hold every claim of the paper's simulation study against the scores of a study."""
    evidence = PaperScores(scores)
    rows = [_all_above(evidence, *floor) for floor in FLOORS]
    return judge_claims(CLAIMS, evidence, rows)


def _all_above(
    evidence: PaperScores, where: dict[str, Any], name: str, floor: float, source: str
) -> tuple[object, ...]:
    """Return the row for the claim that every VAF exceeds a floor in nearly all trials."""
    places = list(product(evidence.where(**where), FIVE))
    values = [evidence.of(*place, "lowest_vaf") for place in places]
    lowest = [np.nan if each is None else float(each[0]) for each in values]
    labels = [scenario.label for scenario in evidence.where(**where)]
    trials = (
        int(evidence.scores.trials.sel(scenario=labels, method_key=list(FIVE)).min())
        if labels
        else 0
    )
    verdict, finding, estimate = UNDECIDED, "", np.nan
    remark = "A method gave no results."
    if not places:
        verdict, remark = NOT_STUDIED, f"Needs a {name} at 10 dB and {evidence.also}."
    elif trials and not np.isnan(lowest).any():
        worst, (scenario, method) = min(zip(lowest, places, strict=True), key=lambda item: item[0])
        estimate = worst - floor
        finding = f"lowest mean VAF of a trial: {worst:.1f} % ({method}, {_brief(scenario)})"
        if worst > floor:
            # With none of n below, the share of such trials is under this with 95 % confidence
            # (Clopper and Pearson).
            share = 100 * float(beta.ppf(0.95, 1, trials))
            finding += (
                f"; none is below, so in each scenario fewer than {share:.2g} % are (95 % "
                "confidence)"
            )
        verdict = FAILS if worst <= floor else HOLDS if trials >= MIN_TRIALS else UNDECIDED
        remark = VAF_OF_A_TRIAL
    sentence = f"Every VAF is above {floor:g} % ({name})"
    return (sentence, source, finding, estimate, np.nan, np.nan, POINTS, verdict, remark)


def _brief(scenario: Scenario) -> str:
    name = PERTURBATIONS.get(scenario.perturbation, scenario.perturbation)
    return f"{name}, {scenario.duration_s:g} s"


def _amount(metric: str, place: int) -> str:
    """Return the format of a value of a metric."""
    return f"{{{place}:{AMOUNTS.get(metric, '.1f} N·m/rad')}"


def _ranked(
    metric: str, order: str, where: dict[str, Any] = SQUARES, least_s: float = 0.0
) -> Comparisons:
    """Compare a metric of methods: those before ``>`` must be above those after it.

    Errors are compared by their ratio: their uncertainty is in proportion to them.
    """
    groups = [group.split() for group in order.split(" > ")]
    pairs = [pair for above, below in pairwise(groups) for pair in product(above, below)]

    def rows(evidence: Scores) -> Rows:
        for scenario, (high, low) in product(evidence.where(least_s, **where), pairs):
            words = f"{NAMES[metric]} of {high} {_amount(metric, 0)}, of {low} {_amount(metric, 1)}"
            places = ((scenario, method, metric) for method in (high, low))
            yield f"{words} ({_brief(scenario)})", *places

    return compare(rows, log_ratio if metric in (RANDOM, TOTAL) else np.subtract)


def _beside(
    words: str,
    margin: Callable[[Array, Array], Array],
    metric: str,
    where: dict[str, Any] = SQUARES,
    other: str = "",
    methods: Sequence[str] = FIVE,
) -> Comparisons:
    """Compare a metric of each method with another metric, or with itself."""

    def rows(evidence: Scores) -> Rows:
        for one, method in product(evidence.where(**where), methods):
            said = _said(words, metric, method, one, one)
            yield said, (one, method, metric), (one, method, other or metric)

    return compare(rows, margin)


def _changed(
    words: str,
    margin: Callable[[Array, Array], Array],
    change: Callable[[Scenario], Scenario],
    where: dict[str, Any],
    metrics: Sequence[str],
    methods: Sequence[str] = FIVE,
) -> Comparisons:
    """Compare metrics of each method between scenarios that differ by one change."""

    def rows(evidence: Scores) -> Rows:
        for one, method, metric in product(evidence.where(**where), methods, metrics):
            other = change(one)  # inf dB + 10 dB is the same
            if other != one and other in evidence.scenarios:
                said = _said(words, metric, method, one, other)
                yield said, (one, method, metric), (other, method, metric)

    return compare(rows, margin)


def _said(words: str, metric: str, method: str, one: Scenario, other: Scenario) -> str:
    """Return a format of two values and their ratio."""
    return words.format(
        metric=NAMES.get(metric),
        method=method,
        first=_amount(metric, 0),
        last=_amount(metric, 1),
        one=_brief(one),
        other=_brief(other),
        loud=one.snr_db,
        quiet=other.snr_db,
    )


def _to_prbs(scenario: Scenario) -> Scenario:
    return scenario._replace(perturbation="prbs")


def _alike(logarithms: Array) -> Array:
    """Return the margins of a ratio that is one to within a quarter."""
    return np.asarray(np.log1p(ALIKE) - np.stack([logarithms, -logarithms]))


def _mostly_alike(metric: str) -> Comparisons:
    """Test that a metric differs little between perturbations in most conditions."""

    def comparisons(evidence: Scores) -> Iterator[Comparison]:
        where = SQUARES | {"perturbation": "noise"}
        ratios = _changed("", log_ratio, _to_prbs, where, [metric])(evidence)
        sizes = [np.abs(each.values) for each in ratios]
        if not sizes or np.isnan([each[0] for each in sizes]).any():
            return
        little = np.array(sizes) < np.log1p(ALIKE)
        words = (
            f"{NAMES[metric]} differs by less than {100 * ALIKE:g} % in {int(little[:, 0].sum())} "
            f"of {len(sizes)} conditions"
        )
        yield Comparison(words, little.mean(axis=0) - 0.5)

    return comparisons


def _falls_most(evidence: Scores) -> Iterator[Comparison]:
    """Test that eirf's random error falls by the largest factor with more data."""
    for perturbation in PERTURBATIONS:
        scenarios = evidence.where(**SQUARES, perturbation=perturbation)
        scenarios.sort(key=lambda scenario: scenario.duration_s)
        if len(scenarios) < 2:
            continue
        ends = scenarios[0], scenarios[-1]
        rows = [(method, *((scenario, method, RANDOM) for scenario in ends)) for method in FIVE]
        (_, own), *others = compare(rows, log_ratio)(evidence)
        for method, fall in others:
            words = (
                f"from {_brief(ends[0])} to {_brief(ends[1])} the random error of eirf falls "
                f"{np.exp(own[0]):.1f}-fold, of {method} {np.exp(fall[0]):.1f}-fold"
            )
            yield Comparison(words, own - fall)


VAF_OF_A_TRIAL = (
    "The paper does not say over what it is taken: here, the mean over the realizations of a trial."
)
STIFFNESS, POINTS, SHARE = "N·m/rad", "percentage points", "share of conditions beyond half"
SQUARE, SINE = "a square wave at 10 dB", "a sine at 10 dB"
BOTH = "with both perturbations"
DURATIONS = "several durations of a square wave"
FEW_HUNDRED = f"{SQUARE} of {FEW_HUNDRED_S:g} s or more"
A_QUARTER = f"less than {100 * ALIKE:g} %"
DECIMATION = (
    "The low-pass before decimation smears every switch over some 30 ms, and noise does the rest: "
    "eirf errs there too, only far less than the others."
)
SINE_BIAS = (
    "Ten cubic B-splines represent a sine of the period almost exactly, so that little of birf's "
    "bias is left; esm's window of 0.3 s averages a curve that bends, and its estimate at 0 Hz "
    "leaks. An independent implementation finds the same."
)
VAF_RANKING = (
    "eirf estimates 25 numbers at each of 200 times and predicts with all their noise, so that "
    "against noiseless torque sds and kbr do better. Measured against noisy torque, as with "
    "people, the VAF rewards fitting the noise, and eirf has the highest; the paper's statement "
    "may come from there."
)
PERTURBATION = (
    "The noise is scaled to the torque, of which inertia takes a larger part with PRBS, and the "
    "two perturbations excite different bands: with PRBS the random error of esm is lower, that of "
    "sds and kbr higher."
)
RESIDUE = (
    "With little noise the random error no longer falls: what is left comes from the perturbation, "
    "which differs from trial to trial, where a method's model does not fit (switches within a "
    "window, leakage of esm). So the amounts of data tell what noise does only while it prevails, "
    "up to some 10 dB at 150 s."
)
AVERAGED = (
    "{metric} of {method} {first} ({one}), {last} ({other}): {{ratio:.1f}}-fold, where averaging "
    "alone gives 1.4-fold"
)
DIPS = "time-varying VAF of {method} dips by {first} points ({one})"
LESS_NOISE = "{metric} of {method} {first} at {loud:g} dB, {last} at {quiet:g} dB ({one})"
COVARYING = "{metric} of {method} {first} ({one}), {last} ({other}, viscosity covarying)"
VARIES_BY = (
    "spread of the time-varying VAF of {method}: {last} points with PRBS, {first} with noise"
)
WHERE_SOFT = (
    "spread of the time-varying VAF of {method}: {first} points below the mean stiffness, {last} "
    "above ({one})"
)
LOWEST_EIRF, HIGHEST_EIRF = "sds birf esm kbr > eirf", "eirf > sds birf esm kbr"
LOWEST_BIRF, HIGHEST_BIRF = "eirf sds esm kbr > birf", "birf > eirf sds esm kbr"
BETWEEN, BETWEEN_ERRORS = "birf > sds esm kbr > eirf", "eirf > sds esm kbr > birf"

CLAIMS: tuple[Claim, ...] = (
    Claim("eirf has the lowest bias", "3.4", _ranked(BIAS, LOWEST_EIRF), STIFFNESS, SQUARE),
    Claim("eirf has the highest random error", "3.4", _ranked(RANDOM, HIGHEST_EIRF), RATIO, SQUARE),
    Claim("eirf has the shortest rise time", "3.4", _ranked(RISE, LOWEST_EIRF), "s", SQUARE),
    Claim("birf has the largest bias", "3.4", _ranked(BIAS, HIGHEST_BIRF), STIFFNESS, SQUARE),
    Claim("birf has the smallest random error", "3.4", _ranked(RANDOM, LOWEST_BIRF), RATIO, SQUARE),
    Claim(
        "sds, esm, kbr lie between eirf and birf in bias",
        "3.4", _ranked(BIAS, BETWEEN), STIFFNESS, SQUARE,
    ),
    Claim(
        "sds, esm, kbr lie between birf and eirf in random error",
        "3.4", _ranked(RANDOM, BETWEEN_ERRORS), RATIO, SQUARE,
    ),
    Claim(
        "sds, esm, kbr lie between eirf and birf in rise time",
        "3.4", _ranked(RISE, BETWEEN), "s", SQUARE,
    ),
    Claim("eirf is most sensitive to the amount of data", "3.4", _falls_most, RATIO, DURATIONS),
    Claim(
        "eirf improves strongly above 40 s", "3.4",
        _changed(
            AVERAGED, lambda short, long: log_ratio(short, long) - np.log(2) / 2,
            lambda short: short._replace(duration_s=80.0), SQUARES | {"duration_s": 40.0},
            [RANDOM], ["eirf"],
        ),
        RATIO, "a square wave of 40 and of 80 s at 10 dB",
    ),
    Claim(
        "Given a few hundred realizations, eirf has the smallest total error",
        "5", _ranked(TOTAL, LOWEST_EIRF, least_s=FEW_HUNDRED_S), RATIO, FEW_HUNDRED,
    ),
    Claim(
        "Given a few hundred realizations, eirf has the highest VAF",
        "5", _ranked("vaf", HIGHEST_EIRF, least_s=FEW_HUNDRED_S), POINTS, FEW_HUNDRED, VAF_RANKING,
    ),
    Claim(
        "The time-varying VAF dips at the switches for sds, birf, esm and kbr (by more than "
        f"{DIP:g} point)", "3.4",
        _beside(DIPS, lambda dip, _: dip - DIP, "switch_dip", methods=FIVE[1:]), POINTS, SQUARE,
    ),
    Claim(
        f"The time-varying VAF of eirf does not dip at the switches (by less than {DIP:g} "
        "point)", "3.4",
        _beside(DIPS, lambda dip, _: DIP - dip, "switch_dip", methods=("eirf",)),
        POINTS, SQUARE, DECIMATION,
    ),
    *(
        Claim(
            f"Under most conditions the {NAMES[metric]} hardly depends on the perturbation "
            f"({A_QUARTER})", "3.4", _mostly_alike(metric), SHARE, f"{SQUARE} {BOTH}", PERTURBATION,
        )
        for metric in (TOTAL, RANDOM)
    ),
    Claim(
        "With a sine, birf has the largest bias",
        "A", _ranked(BIAS, HIGHEST_BIRF, SINES), STIFFNESS, SINE, SINE_BIAS,
    ),
    Claim("With a sine, eirf varies most", "A", _ranked(RANDOM, HIGHEST_EIRF, SINES), RATIO, SINE),
    Claim(
        "With a sine, sds and kbr have the lowest bias", "A",
        _ranked(BIAS, "eirf birf esm > sds kbr", SINES), STIFFNESS, SINE, SINE_BIAS,
    ),
    Claim(
        "With a sine, birf and kbr have the lowest random error", "A",
        _ranked(RANDOM, "eirf sds esm > birf kbr", SINES), RATIO, SINE,
    ),
    Claim(
        "With a sine, the time-varying VAF varies more with PRBS than with noise", "A",
        _changed(
            VARIES_BY, lambda noise, prbs: prbs - noise, _to_prbs,
            SINES | {"perturbation": "noise"}, [VARIES],
        ),
        POINTS, f"{SINE} {BOTH}",
    ),
    Claim(
        "With a sine, the time-varying VAF varies more where the stiffness is low",
        "A", _beside(WHERE_SOFT, np.subtract, SOFT, SINES, STIFF), POINTS, SINE,
    ),
    Claim(
        "What noise does can be inferred from the amounts of data: 10 dB less lower the random "
        f"error 3.2-fold, as ten times the data do (to within {100 * ALIKE:g} %)", "5",
        _changed(
            LESS_NOISE, lambda loud, quiet: _alike(log_ratio(loud, quiet) - np.log(10) / 2),
            lambda loud: loud._replace(snr_db=loud.snr_db + 10),
            {"stiffness": "square", "viscosity": "constant"}, [RANDOM],
        ),
        RATIO, "noise of 10 dB more and less (the preset snr)", RESIDUE,
    ),
    Claim(
        "Viscosity that covaries from 1 to 3 N·m·s/rad changes nothing (errors differ by "
        f"{A_QUARTER})", "5",
        _changed(
            COVARYING, lambda constant, covarying: _alike(log_ratio(covarying, constant)),
            lambda constant: constant._replace(viscosity="covarying"), SQUARES, [TOTAL, RANDOM],
        ),
        RATIO, "constant and covarying viscosity (the preset viscosity)",
    ),
)  # fmt: skip
FLOORS = ((SQUARES, "square wave", 85.0, "3.4"), (SINES, "sine", 90.0, "A"))
"""Scenarios and their name, floor of all VAFs in per cent, source."""
