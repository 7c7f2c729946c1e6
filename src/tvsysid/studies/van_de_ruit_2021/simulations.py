"""Claims of van de Ruit et al. (2021) about their simulations.

The paper gives few thresholds. Those here are ours, and part of the sentences.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import pairwise, product
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from tvsysid.figures import Illustration
from tvsysid.methods import PAPER_METHODS as FIVE
from tvsysid.report import CLAIMS as ABOUT
from tvsysid.studies.claims import (
    HIGHER,
    HIGHER_RATIO,
    Claim,
    Evidence,
    Margin,
    ratio,
    simulation_evidence,
)
from tvsysid.studies.published_study import PublishedStudy
from tvsysid.studies.van_de_ruit_2021.figures import example_responses, study_figures
from tvsysid.study.scenarios import PERIOD, RATE, VISCOSITIES, Scenario

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

FEW_HUNDRED_S = 300.0  # seconds of "a few hundred realizations" of 2 s: 150 at least
ALIKE = 1.25  # ratio up to which an error counts as little changed
DIP = 1.0  # percentage points that a time-varying VAF is lower at the switches if it dips
BIAS, RANDOM, TOTAL, RISE = "debiased_bias_error", "random_error", "total_error", "rise_time"
VARIES = "time_varying_vaf_sd"
OF_FIVE = "and all five methods with their own settings"
SQUARE, SINE = f"a square wave at 10 dB, {OF_FIVE}", f"a sine at 10 dB, {OF_FIVE}"
FEW_HUNDRED = f"a square wave at 10 dB of {FEW_HUNDRED_S:g} s or more, {OF_FIVE}"
HARDLY = ratio(1 / ALIKE, ALIKE)
A_QUARTER = f"less than {100 * (ALIKE - 1):g} %"
VAF_OF_A_TRIAL = (
    "The paper does not say over what it is taken: here, the mean over the realizations of a trial."
)
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

PRESETS: dict[str, dict[str, object]] = {
    "quick": {},
    "paper": {
        "methods": FIVE,
        "duration_s": (40.0, 80.0, 150.0, 300.0, 600.0),
        "also": ({"stiffness": ("sine",), "duration_s": (150.0,)},),
        "trials": 100,
    },
    "snr": {"snr_db": (0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0), "trials": 100},
    "viscosity": {"viscosity": VISCOSITIES, "trials": 100},
}
"""The default study; that of the paper with its Appendix A; and two that it leaves open."""


def paper_evidence(scores: xr.Dataset) -> Evidence:
    """Return the evidence for the paper's claims: all five methods, its joint, rate and period."""
    evidence = simulation_evidence(scores)
    study = json.loads(scores.attrs["study"])
    is_of_paper = (study["rate"], study["period"]) == (RATE, PERIOD)
    is_complete = set(FIVE) <= set(scores.method_key.values)
    return evidence if is_of_paper and is_complete else attrs.evolve(evidence, scenarios={})


def scenarios(
    change: Callable[[Scenario], Scenario] | None = None,
    min_duration_s: float = 0.0,
    **settings: object,
) -> Callable[[Evidence], list[Any]]:
    """Return a function that finds the labels of scenarios of the paper's joint.

    With a ``change`` it finds pairs, before and after it. A setting of None stands for any.
    """
    usual = {"system": "joint", "stiffness": "square", "viscosity": "constant", "snr_db": 10.0}
    wanted = usual | settings

    def find(evidence: Evidence) -> list[Any]:
        return [
            (label, change(each).label) if change else label
            for label, each in evidence.scenarios.items()
            if each.duration_s >= min_duration_s
            and all(value in (None, getattr(each, name)) for name, value in wanted.items())
        ]

    return find


SQUARES, SINES = scenarios(), scenarios(stiffness="sine")


def extremes(evidence: Evidence) -> list[tuple[str, ...]]:
    """Return the labels of the scenarios with the least and the most data."""
    each = (scenarios(perturbation=name)(evidence) for name in ("noise", "prbs"))
    amount = {label: each.duration_s for label, each in evidence.scenarios.items()}.__getitem__
    return [(min(labels, key=amount), max(labels, key=amount)) for labels in each if labels]


def ranked(
    sentence: str,
    metric: str,
    order: str,
    source: str = "3.4",
    where: Callable[[Evidence], list[Any]] = SQUARES,
    needs: str = SQUARE,
    disagreement: str = "",
) -> Claim:
    """Return the claim that a metric of the methods before ``>`` is above that of those after it.

    Errors are compared by their ratio: their uncertainty is in proportion to them.
    """
    groups = [group.split() for group in order.split(" > ")]
    pairs = [pair for high, low in pairwise(groups) for pair in product(high, low)]
    margin = HIGHER_RATIO if metric in (RANDOM, TOTAL) else HIGHER
    return Claim(sentence, source, needs, [(margin, metric, pairs, where)], disagreement)


LOWEST_EIRF, HIGHEST_EIRF = "sds birf esm kbr > eirf", "eirf > sds birf esm kbr"
LOWEST_BIRF, HIGHEST_BIRF = "eirf sds esm kbr > birf", "birf > eirf sds esm kbr"
BETWEEN, REVERSED = "birf > sds esm kbr > eirf", "eirf > sds esm kbr > birf"
LONG = "5", scenarios(min_duration_s=FEW_HUNDRED_S), FEW_HUNDRED
CLAIMS: tuple[Claim, ...] = (
    ranked("eirf has the lowest bias", BIAS, LOWEST_EIRF),
    ranked("eirf has the highest random error", RANDOM, HIGHEST_EIRF),
    ranked("eirf has the shortest rise time", RISE, LOWEST_EIRF),
    ranked("birf has the largest bias", BIAS, HIGHEST_BIRF),
    ranked("birf has the smallest random error", RANDOM, LOWEST_BIRF),
    ranked("sds, esm, kbr lie between eirf and birf in bias", BIAS, BETWEEN),
    ranked("sds, esm, kbr lie between birf and eirf in random error", RANDOM, REVERSED),
    ranked("sds, esm, kbr lie between eirf and birf in rise time", RISE, BETWEEN),
    Claim(
        "eirf is most sensitive to the amount of data", "3.4",
        f"several durations of a square wave, {OF_FIVE}",
        [(HIGHER_RATIO, RANDOM, [("eirf", each) for each in FIVE[1:]], extremes)],
    ),
    Claim(
        "eirf improves strongly above 40 s", "3.4",
        f"a square wave of 40 and of 80 s at 10 dB, {OF_FIVE}",
        [(
            ratio(np.sqrt(2)), RANDOM, "eirf",  # averaging alone gives the square root of two
            scenarios(lambda short: short._replace(duration_s=80.0), duration_s=40.0),
        )],
    ),
    ranked(
        "Given a few hundred realizations, eirf has the smallest total error",
        TOTAL, LOWEST_EIRF, *LONG,
    ),
    ranked(
        "Given a few hundred realizations, eirf has the highest VAF",
        "vaf", HIGHEST_EIRF, *LONG, VAF_RANKING,
    ),
    Claim(
        "The time-varying VAF dips at the switches for sds, birf, esm and kbr (by more than "
        f"{DIP:g} point)", "3.4", SQUARE, [(Margin(DIP), "switch_dip", FIVE[1:], SQUARES)],
    ),
    Claim(
        f"The time-varying VAF of eirf does not dip at the switches (by less than {DIP:g} "
        "point)", "3.4", SQUARE, [(Margin(high=DIP), "switch_dip", "eirf", SQUARES)], DECIMATION,
    ),
    *(
        Claim(
            f"Under most conditions the {metric.replace('_', ' ')} hardly depends on the "
            f"perturbation ({A_QUARTER})", "3.4",
            f"a square wave at 10 dB with both perturbations, {OF_FIVE}",
            [(
                HARDLY, metric, FIVE,
                scenarios(lambda noise: noise._replace(perturbation="prbs"), perturbation="noise"),
            )],
            PERTURBATION, most=True,
        )
        for metric in (TOTAL, RANDOM)
    ),
    ranked(
        "With a sine, birf has the largest bias", BIAS, HIGHEST_BIRF, "A", SINES, SINE, SINE_BIAS
    ),
    ranked("With a sine, eirf varies most", RANDOM, HIGHEST_EIRF, "A", SINES, SINE),
    ranked(
        "With a sine, sds and kbr have the lowest bias",
        BIAS, "eirf birf esm > sds kbr", "A", SINES, SINE, SINE_BIAS,
    ),
    ranked(
        "With a sine, birf and kbr have the lowest random error",
        RANDOM, "eirf sds esm > birf kbr", "A", SINES, SINE,
    ),
    Claim(
        "With a sine, the time-varying VAF varies more with PRBS than with noise", "A",
        f"a sine at 10 dB with both perturbations, {OF_FIVE}",
        [(
            HIGHER, VARIES, FIVE,
            scenarios(
                lambda prbs: prbs._replace(perturbation="noise"),
                stiffness="sine", perturbation="prbs",
            ),
        )],
    ),
    Claim(
        "With a sine, the time-varying VAF varies more where the stiffness is low", "A", SINE,
        [(HIGHER, [(f"{VARIES}_soft", f"{VARIES}_stiff")], FIVE, SINES)],
    ),
    Claim(
        "What noise does can be inferred from the amounts of data: 10 dB less lower the random "
        f"error 3.2-fold, as ten times the data do (to within {100 * (ALIKE - 1):g} %)", "5",
        f"noise of 10 dB more and less (the preset snr), {OF_FIVE}",
        [(
            ratio(np.sqrt(10) / ALIKE, np.sqrt(10) * ALIKE), RANDOM, FIVE,
            scenarios(lambda loud: loud._replace(snr_db=loud.snr_db + 10), snr_db=None),
        )],
        RESIDUE,
    ),
    Claim(
        "Viscosity that covaries from 1 to 3 N·m·s/rad changes nothing (errors differ by "
        f"{A_QUARTER})", "5", f"constant and covarying viscosity (the preset viscosity), {OF_FIVE}",
        [(
            HARDLY, [TOTAL, RANDOM], FIVE,
            scenarios(lambda constant: constant._replace(viscosity="covarying")),
        )],
    ),
    *(
        Claim(
            f"Every VAF is above {floor} % ({name})", source, needs,
            [(Margin(floor), "lowest_vaf", FIVE, where)], VAF_OF_A_TRIAL,
        )
        for floor, name, source, needs, where in (
            (85, "square wave", "3.4", SQUARE, SQUARES), (90, "sine", "A", SINE, SINES),
        )
    ),
)  # fmt: skip


def paper_figures(results: xr.Dataset, summary: pd.DataFrame) -> dict[str, Illustration]:
    """Return all figures of a study, with impulse responses if it has a square wave."""
    seed, has_square = json.loads(results.attrs["study"])["seed"], "square" in results.profile
    return study_figures(results, summary, example_responses(seed) if has_square else None)


STUDY = PublishedStudy(PRESETS, CLAIMS, ABOUT, paper_figures, lambda results: True, paper_evidence)
