"""What van de Ruit et al. (2021) say their simulations show, held against the scores of a study.

There is a margin for each scenario and rival (:mod:`tvsysid.studies.verdicts`), with limits from
drawing trials.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import attrs
import numpy as np
import pandas as pd
from scipy.stats import beta

from tvsysid.methods import PAPER_METHODS
from tvsysid.numerics import Array
from tvsysid.studies.verdicts import (
    COLUMNS,
    FAILS,
    HOLDS,
    NOT_STUDIED,
    RATIO,
    UNDECIDED,
    Claim,
    judged,
    log_ratio,
)
from tvsysid.study.scenarios import PERIOD, RATE

if TYPE_CHECKING:
    import xarray as xr


FIVE = PAPER_METHODS
THE_FIVE = "all five methods with their own settings"
PERTURBATIONS = ("noise", "prbs")
FEWEST = 10  # trials below which limits from drawing among them are too narrow to decide by
FEW_HUNDRED_S = (
    300.0  # seconds from which there are "a few hundred realizations" of 2 s: 150 in the shortest
)
ALIKE = 0.25  # relative difference below which an error counts as little changed
# percentage points that a time-varying VAF is lower at the switches than away from them if it dips
DIP = 1.0

BIAS, RANDOM, TOTAL, RISE = "debiased_bias_error", "random_error", "total_error", "rise_time"
VARIES, SOFT, STIFF = "time_varying_vaf_sd", "time_varying_vaf_sd_soft", "time_varying_vaf_sd_stiff"
NAMES = {
    BIAS: "bias (freed of random error)",
    RANDOM: "random error",
    TOTAL: "total error",
    RISE: "rise time",
}
NAMES |= {"vaf": "VAF"}
AMOUNTS = {RISE: "{:.2f} s", "vaf": "{:.1f} %", "switch_dip": "{:.1f}"} | dict.fromkeys(
    (VARIES, SOFT, STIFF), "{:.2f}"
)
"""How the values of metrics are printed that are not in N·m/rad."""


class Scenario(NamedTuple):
    """Settings in which scenarios differ."""

    profile: str
    perturbation: str
    duration_s: float
    snr_db: float
    viscosity: str

    def __str__(self) -> str:
        return f"{'PRBS' if self.perturbation == 'prbs' else 'noise'}, {self.duration_s:g} s"


Where = dict[str, tuple[object, ...]]  # values that the settings of a scenario may have
SQUARES: Where = {"profile": ("square",), "viscosity": ("constant",), "snr_db": (10.0,)}
SINES: Where = SQUARES | {"profile": ("sine",)}


class Scores:
    """Scores of a study's scenarios that have the paper's joint, rate and period."""

    def __init__(self, scores: xr.Dataset) -> None:
        settings = (scores[name].values.tolist() for name in Scenario._fields)
        usual = {"rate": RATE, "period": PERIOD}
        as_there = usual.items() <= (usual | json.loads(scores.attrs.get("study", "{}"))).items()
        self.scenarios = {
            Scenario(*each): place
            for place, each in enumerate(zip(*settings, strict=True))
            if as_there and scores.system.values[place] == "joint"
        }
        self.all_there = set(FIVE) <= set(map(str, scores.method_key.values))
        self._trials = scores.trials.transpose("scenario", "method_key", ...).values
        self._methods, self._metrics = (scores.indexes[name] for name in ("method_key", "metric"))
        self._values, self._replicates = scores.value.values, scores.replicates.values

    def where(self, where: Where, least_s: float = 0.0) -> list[Scenario]:
        """Return the scenarios with these settings and so many seconds of data."""
        return [
            scenario
            for scenario in self.scenarios
            if scenario.duration_s >= least_s
            and all(getattr(scenario, name) in where[name] for name in where)
        ]

    def of(self, scenario: Scenario, method: str, metric: str) -> Array:
        """Return a metric followed by its bootstrap replicates."""
        place = (
            self.scenarios[scenario],
            self._methods.get_loc(method),
            self._metrics.get_loc(metric),
        )
        return np.append(self._values[place], self._replicates[place])

    def trials(self, scenario: Scenario, method: str) -> int:
        """Return the trials that count."""
        return int(self._trials[self.scenarios[scenario], self._methods.get_loc(method)])


@attrs.frozen
class Replicated:
    """A margin with its bootstrap replicates, shape (draw,)."""

    words: str
    estimate: float
    replicates: Array

    def limits(self, tail: float) -> tuple[float, float]:
        """Return percentiles of the replicates; NaN if there are none."""
        known = self.replicates[~np.isnan(self.replicates)]
        if not len(known):
            return np.nan, np.nan
        low, high = np.quantile(known, [tail, 1 - tail], method="nearest")
        return float(low), float(high)


Margins = Callable[[Scores], Iterator[Replicated]]
Place = tuple[Scenario, str, str]  # scenario, method and metric
Pairs = Callable[[Scores], Iterator[tuple[Place, Place]]]


def judge_simulations(scores: xr.Dataset) -> pd.DataFrame:
    """Hold every claim of the paper's simulation study against the scores of a study."""
    known = Scores(scores)
    too_few = f"Needs at least {FEWEST} trials." if int(scores.trials.max()) < FEWEST else ""
    # A draw of few trials may be of one alone, which has no spread to take the logarithm of.
    with np.errstate(divide="ignore", invalid="ignore"):
        rows = [
            judged(
                claim,
                list(claim.margins(known)) if known.all_there else [],
                also=THE_FIVE,
                too_few=too_few,
                more="trials",
            )
            for claim in CLAIMS
        ]
    rows += [_all_above(known, *floor) for floor in FLOORS]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _all_above(
    scores: Scores, where: Where, name: str, floor: float, source: str
) -> tuple[object, ...]:
    """Return the row for the claim that every VAF exceeds a floor in nearly all trials."""
    sentence, unit = f"Every VAF is above {floor:g} % ({name})", "percentage points"
    nothing = (np.nan, np.nan, np.nan, unit)
    lowest = {
        (scenario, method): float(scores.of(scenario, method, "lowest_vaf")[0])
        for scenario in scores.where(where)
        for method in FIVE
        if scores.all_there
    }
    if not lowest:
        return (
            sentence,
            source,
            "",
            *nothing,
            NOT_STUDIED,
            f"Needs a {name} at 10 dB and {THE_FIVE}.",
        )
    trials = min(scores.trials(*place) for place in lowest)
    if not trials or np.isnan(list(lowest.values())).any():
        return (sentence, source, "", *nothing, UNDECIDED, "A method gave no results.")
    (scenario, method), worst = min(lowest.items(), key=lambda item: item[1])
    found = f"lowest mean VAF of a trial: {worst:.1f} % ({method}, {scenario})"
    if worst > floor:
        # With none of n below, the share of such trials is under this with 95 % confidence (Clopper
        # and Pearson).
        share = float(beta.ppf(0.95, 1, trials))
        found += (
            f"; none is below, so in each scenario fewer than {100 * share:.2g} % are (95 % "
            "confidence)"
        )
    remark = (
        "The paper does not say over what it is taken: here, the mean over the realizations "
        "of a trial."
    )
    verdict = FAILS if worst <= floor else HOLDS if trials >= FEWEST else UNDECIDED
    return (sentence, source, found, worst - floor, np.nan, np.nan, unit, verdict, remark)


def _compared(pairs: Pairs, words: str, margin: Callable[[Array, Array], Array]) -> Margins:
    """Return margins of pairs of values, shape (margin, value and replicates).

    The words may name ``one`` and the ``other`` scenario, the ``metric``, the ``method`` and its
    ``rival``, and say the ``first`` and the ``last`` amount and their ``ratio``.
    """

    def margins(scores: Scores) -> Iterator[Replicated]:
        for (one, method, metric), (other, rival, compared) in pairs(scores):
            first, last = scores.of(one, method, metric), scores.of(other, rival, compared)
            amount = AMOUNTS.get(metric, "{:.1f} N·m/rad").format
            said = {
                "one": one,
                "other": other,
                "method": method,
                "rival": rival,
                "metric": NAMES.get(metric),
            }
            said |= {
                "first": amount(first[0]),
                "last": amount(last[0]),
                "ratio": first[0] / last[0],
            }
            for each in np.atleast_2d(margin(first, last)):
                yield Replicated(words.format(**said), float(each[0]), each[1:])

    return margins


def _ranked(
    metric: str, order: Sequence[tuple[str, str]], where: Where = SQUARES, least_s: float = 0.0
) -> Margins:
    """Test that a metric of one method is above that of another, for pairs of methods.

    Errors are compared by their ratio: their uncertainty is in proportion to them.
    """

    def pairs(scores: Scores) -> Iterator[tuple[Place, Place]]:
        for scenario in scores.where(where, least_s):
            yield from (((scenario, high, metric), (scenario, low, metric)) for high, low in order)

    words = "{metric} of {method} {first}, of {rival} {last} ({one})"
    return _compared(pairs, words, log_ratio if metric in (RANDOM, TOTAL) else np.subtract)


def _above(*high: str) -> list[tuple[str, str]]:
    """Return pairs of these methods above all others."""
    return [(each, other) for each in high for other in FIVE if other not in high]


def _below(*low: str) -> list[tuple[str, str]]:
    """Return pairs of these methods below all others."""
    return [(other, each) for each, other in _above(*low)]


def _between(low: str, high: str) -> list[tuple[str, str]]:
    """Return pairs with sds, esm and kbr between two methods."""
    return [pair for method in ("sds", "esm", "kbr") for pair in ((method, low), (high, method))]


def _beside(
    metric: str, where: Where = SQUARES, other: str = "", methods: Sequence[str] = FIVE
) -> Pairs:
    """Return a metric of methods in each scenario, beside another one or itself."""
    return lambda scores: (
        ((scenario, method, metric), (scenario, method, other or metric))
        for scenario in scores.where(where)
        for method in methods
    )


def _changed(
    change: Callable[[Scenario], Scenario],
    where: Where,
    metrics: Sequence[str],
    methods: Sequence[str] = FIVE,
) -> Pairs:
    """Return metrics of methods in pairs of scenarios that differ by one change."""
    return lambda scores: (
        ((scenario, method, metric), (change(scenario), method, metric))
        for scenario in scores.where(where)
        if change(scenario) != scenario
        and change(scenario) in scores.scenarios  # inf dB + 10 dB is the same
        for method in methods
        for metric in metrics
    )


def _to_prbs(where: Where, metric: str) -> Pairs:
    return _changed(
        lambda noise: noise._replace(perturbation="prbs"),
        where | {"perturbation": ("noise",)},
        [metric],
    )


def _alike(logarithms: Array) -> Array:
    """Test that a ratio is one to within a quarter: a margin on each side."""
    return np.asarray(np.log1p(ALIKE) - np.stack([logarithms, -logarithms]))


def _mostly_alike(metric: str) -> Margins:
    """Test that a metric differs little between perturbations in most conditions."""

    def margins(scores: Scores) -> Iterator[Replicated]:
        pairs = list(_to_prbs(SQUARES, metric)(scores))
        sizes = np.array(
            [np.abs(log_ratio(scores.of(*last), scores.of(*first))) for first, last in pairs]
        )
        if not len(sizes) or np.isnan(sizes[:, 0]).any():
            return
        little = sizes < np.log1p(ALIKE)
        count = int(little[:, 0].sum())
        words = (
            f"{NAMES[metric]} differs by less than {100 * ALIKE:g} % in {count} of "
            f"{len(sizes)} conditions"
        )
        share = little.mean(axis=0) - 0.5
        yield Replicated(words, float(share[0]), share[1:])

    return margins


def _falls_most(scores: Scores) -> Iterator[Replicated]:
    """Test that eirf's random error falls by the largest factor with more data."""
    for perturbation in PERTURBATIONS:
        scenarios = scores.where(SQUARES | {"perturbation": (perturbation,)})
        least, most = (
            choose(scenarios, key=lambda each: each.duration_s, default=None)
            for choose in (min, max)
        )
        if least is None or most is None or least == most:
            continue
        falls = {
            method: log_ratio(scores.of(least, method, RANDOM), scores.of(most, method, RANDOM))
            for method in FIVE
        }
        own = falls.pop("eirf")
        for method, fall in falls.items():
            words = (
                f"from {least} to {most} the random error of eirf falls "
                f"{np.exp(own[0]):.1f}-fold, of {method} "
                f"{np.exp(fall[0]):.1f}-fold"
            )
            yield Replicated(words, float((own - fall)[0]), (own - fall)[1:])


STIFFNESS, POINTS, SHARE = "N·m/rad", "percentage points", "share of conditions beyond half"
SQUARE, SINE = "a square wave at 10 dB", "a sine at 10 dB"
BOTH = "with both perturbations"
FEW_HUNDRED = f"{SQUARE} of {FEW_HUNDRED_S:g} s or more"
A_QUARTER = f"less than {100 * ALIKE:g} %"
DECIMATION = (
    "The low-pass before decimation smears every switch over some 30 ms, and noise does the rest: "
    "eirf errs there too, "
    "only far less than the others."
)
SINE_BIAS = (
    "Ten cubic B-splines represent a sine of the period almost exactly, so that little of birf's "
    "bias is left; esm's "
    "window of 0.3 s averages a curve that bends, and its estimate at 0 Hz leaks. An independent "
    "implementation finds "
    "the same."
)
VAF_RANKING = (
    "eirf estimates 25 numbers at each of 200 times and predicts with all their noise, so that "
    "against noiseless "
    "torque sds and kbr do better. Measured against noisy torque, as with people, the VAF rewards "
    "fitting the noise, "
    "and eirf has the highest; the paper's statement may come from there."
)
PERTURBATION = (
    "The noise is scaled to the torque, of which inertia takes a larger part with PRBS, and the "
    "two perturbations "
    "excite different bands: with PRBS the random error of esm is lower, that of sds and kbr "
    "higher."
)
RESIDUE = (
    "With little noise the random error no longer falls: what is left comes from the "
    "perturbation, which differs from "
    "trial to trial, where a method's model does not fit (switches within a window, leakage of "
    "esm). So the amounts of "
    "data tell what noise does only while it prevails, up to some 10 dB at 150 s."
)
AVERAGED = (
    "{metric} of {method} {first} ({one}), {last} ({other}): {ratio:.1f}-fold, where "
    "averaging alone gives 1.4-fold"
)
DIPS = "time-varying VAF of {method} dips by {first} points ({one})"
LESS_NOISE = (
    "{metric} of {method} {first} at {one.snr_db:g} dB, {last} at {other.snr_db:g} dB ({one})"
)
COVARYING = "{metric} of {method} {first} ({one}), {last} ({other}, viscosity covarying)"
VARIATION = "spread of the time-varying VAF of {method}: "

CLAIMS: tuple[Claim, ...] = (
    Claim("eirf has the lowest bias", "3.4", _ranked(BIAS, _below("eirf")), STIFFNESS, SQUARE),
    Claim("eirf has the highest random "
          "error", "3.4", _ranked(RANDOM, _above("eirf")), RATIO, SQUARE),
    Claim("eirf has the shortest rise time", "3.4", _ranked(RISE, _below("eirf")), "s", SQUARE),
    Claim("birf has the largest bias", "3.4", _ranked(BIAS, _above("birf")), STIFFNESS, SQUARE),
    Claim("birf has the smallest random "
          "error", "3.4", _ranked(RANDOM, _below("birf")), RATIO, SQUARE),
    Claim("sds, esm, kbr lie between eirf and birf in bias", "3.4",
          _ranked(BIAS, _between("eirf", "birf")), STIFFNESS, SQUARE),
    Claim("sds, esm, kbr lie between birf and eirf in random error", "3.4",
          _ranked(RANDOM, _between("birf", "eirf")), RATIO, SQUARE),
    Claim("sds, esm, kbr lie between eirf and birf in rise time", "3.4",
          _ranked(RISE, _between("eirf", "birf")), "s", SQUARE),
    Claim("eirf is most sensitive to the amount of data", "3.4", _falls_most, RATIO,
          "several durations of a square wave"),
    Claim("eirf improves strongly above 40 s", "3.4",
          _compared(_changed(lambda short: short._replace(duration_s=80.0),
                             SQUARES | {"duration_s": (40.0,), "perturbation": PERTURBATIONS},
                             [RANDOM], ["eirf"]),
                    AVERAGED, lambda short, long: log_ratio(short, long) - np.log(2) / 2),
          RATIO, "a square wave of 40 and of 80 s at 10 dB"),
    Claim("Given a few hundred realizations, eirf has the smallest total error", "5",
          _ranked(TOTAL, _below("eirf"), least_s=FEW_HUNDRED_S), RATIO, FEW_HUNDRED),
    Claim("Given a few hundred realizations, eirf has the highest VAF", "5",
          _ranked("vaf", _above("eirf"), least_s=FEW_HUNDRED_S), POINTS, FEW_HUNDRED, VAF_RANKING),
    Claim(f"The time-varying VAF dips at the switches for sds, birf, esm and kbr (by more than "
          f"{DIP:g} point)", "3.4",
          _compared(_beside("switch_dip", methods=("sds", "birf", "esm", "kbr")), DIPS,
                    lambda dip, _: dip - DIP),
          POINTS, SQUARE),
    Claim(f"The time-varying VAF of eirf does not dip at the switches (by less than {DIP:g} "
          f"point)", "3.4",
          _compared(_beside("switch_dip", methods=("eirf",)), DIPS, lambda dip, _: DIP - dip),
          POINTS, SQUARE, DECIMATION),
    *(Claim(f"Under most conditions the {NAMES[metric]} hardly depends on the perturbation "
            f"({A_QUARTER})", "3.4",
            _mostly_alike(metric), SHARE, f"{SQUARE} "
                                          f"{BOTH}", PERTURBATION) for metric in (TOTAL, RANDOM)),
    Claim("With a sine, birf has the largest "
          "bias", "A", _ranked(BIAS, _above("birf"), SINES), STIFFNESS, SINE,
          SINE_BIAS),
    Claim("With a sine, eirf varies "
          "most", "A", _ranked(RANDOM, _above("eirf"), SINES), RATIO, SINE),
    Claim("With a sine, sds and kbr have the lowest "
          "bias", "A", _ranked(BIAS, _below("sds", "kbr"), SINES), STIFFNESS,
          SINE, SINE_BIAS),
    Claim("With a sine, birf and kbr have the lowest random error", "A",
          _ranked(RANDOM, _below("birf", "kbr"), SINES), RATIO, SINE),
    Claim("With a sine, the time-varying VAF varies more with PRBS than with noise", "A",
          _compared(_to_prbs(SINES, VARIES), VARIATION + "{last} points with PRBS, {first} with "
                                                         "noise",
                    lambda noise, prbs: prbs - noise),
          POINTS, f"{SINE} {BOTH}"),
    Claim("With a sine, the time-varying VAF varies more where the stiffness is low", "A",
          _compared(_beside(SOFT, SINES, STIFF),
                    VARIATION + "{first} points below the mean stiffness, {last} above "
                                "({one})", np.subtract),
          POINTS, SINE),
    Claim("What noise does can be inferred from the amounts of data: 10 dB less lower the random "
          "error 3.2-fold, as "
          f"ten times the data do (to within {100 * ALIKE:g} %)", "5",
          _compared(_changed(lambda loud: loud._replace(snr_db=loud.snr_db + 10),
                             {name: SQUARES[name] for name in ("profile", "viscosity")}, [RANDOM]),
                    LESS_NOISE,
                    lambda loud, quiet: _alike(log_ratio(loud, quiet) - np.log(10) / 2)),
          RATIO, "noise of 10 dB more and less (the preset snr)", RESIDUE),
    Claim(f"Viscosity that covaries from 1 to 3 N·m·s/rad changes nothing (errors differ by "
          f"{A_QUARTER})", "5",
          _compared(_changed(lambda constant: constant._replace(viscosity="covarying"), SQUARES,
                             [TOTAL, RANDOM]),
                    COVARYING, lambda constant, covarying: _alike(log_ratio(covarying, constant))),
          RATIO, "constant and covarying viscosity (the preset viscosity)"),
)  # fmt: skip
FLOORS = ((SQUARES, "square wave", 85.0, "3.4"), (SINES, "sine", 90.0, "A"))
"""Profile, floor of all VAFs in per cent, source."""
