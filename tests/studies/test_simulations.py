"""Claims of the paper's simulations against invented numbers, and how a claim is judged."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.synthetic import scores_of

from tvsysid.studies import preset
from tvsysid.studies.claims import (
    COLUMNS,
    Evidence,
    Margin,
    claim,
    judge_claims,
    replicate_interval,
)
from tvsysid.studies.van_de_ruit_2021.simulations import FIVE, STUDY
from tvsysid.study import Study, run, score
from tvsysid.study.scores import METRICS

DEBIASED = "debiased_bias_error"
BIAS = {(method, DEBIASED): size for method, size in zip(FIVE, (4, 9, 15, 11, 10), strict=True)}
LOWEST, LARGEST = "eirf has the lowest bias", "birf has the largest bias"
BETWEEN = "sds, esm, kbr lie between eirf and birf in bias"


def paper_scores(values=None, spread=0.01, study=None, methods=FIVE):
    """Scores by (method, metric), numbers or functions of the scenario; 1 where not given."""

    def numbers(scenario, method, metric):
        number = (values or {}).get((method, metric), 1.0)
        return number(scenario) if callable(number) else number

    study = study or preset("paper", trials=10)
    scores = scores_of(numbers, study.scenarios, methods, list(METRICS), spread, 10)
    scores.replicates.loc[{"metric": "lowest_vaf"}] = np.nan  # that of the worst trial has none
    return scores


def judged(*given, **settings):
    return STUDY.judge(paper_scores(*given, **settings)).set_index("claim")


def verdicts(*given, **settings):
    return judged(*given, **settings).verdict


def of_all(metric, number):
    return {(method, metric): number for method in FIVE}


def averaging(scenario):
    return 10 * np.sqrt(40 / scenario.duration_s)


def exploding(scenario):
    return averaging(scenario) * (4 if scenario.duration_s == 40 else 1)


def total_errors(ratio, **where):
    """Return total errors that are larger by a ratio in some scenarios, for three methods."""

    def number(scenario):
        return ratio if where.items() <= scenario._asdict().items() else 1.0

    return {(method, "total_error"): number for method in ("eirf", "esm", "kbr")}


HARDLY = "Under most conditions the total error hardly depends"
SENSITIVE, IMPROVES = "eirf is most sensitive", "eirf improves strongly"
SQUARE_FLOOR, SINE_FLOOR = "Every VAF is above 85 %", "Every VAF is above 90 %"
EVEN, VAFS = of_all("random_error", averaging), of_all("lowest_vaf", 95.0)
YES, NO, OPEN, NOT = "holds", "does not hold", "undecided", "not studied"


@pytest.mark.parametrize(
    ("values", "study", "expected"),
    [
        (BIAS, "paper", {LOWEST: YES, LARGEST: YES, BETWEEN: YES}),
        (BIAS | {("eirf", DEBIASED): 12.0}, "paper", {LOWEST: NO, LARGEST: YES, BETWEEN: NO}),
        (BIAS | {("eirf", DEBIASED): 9.0}, "paper", {LOWEST: OPEN, LARGEST: YES, BETWEEN: OPEN}),
        (EVEN, "paper", {SENSITIVE: OPEN, IMPROVES: OPEN}),
        (EVEN | {("eirf", "random_error"): exploding}, "paper", {SENSITIVE: YES, IMPROVES: YES}),
        (total_errors(1.1, perturbation="prbs"), "paper", {HARDLY: YES, "Viscosity": NOT}),
        (total_errors(1.5, perturbation="prbs"), "paper", {HARDLY: NO}),
        (total_errors(0.6, perturbation="prbs"), "paper", {HARDLY: NO}),
        (total_errors(1.0, viscosity="covarying"), "viscosity", {"Viscosity": YES}),
        (total_errors(2.0, viscosity="covarying"), "viscosity", {"Viscosity": NO}),
        (total_errors(1.25, viscosity="covarying"), "viscosity", {"Viscosity": OPEN}),
        (VAFS, "paper", {SQUARE_FLOOR: YES, SINE_FLOOR: YES}),
        (VAFS | {("esm", "lowest_vaf"): 88.0}, "paper", {SQUARE_FLOOR: YES, SINE_FLOOR: NO}),
    ],
)
def test_a_claim_holds_fails_or_is_undecided_as_the_numbers_say(values, study, expected):
    table = verdicts(values, study=preset(study, trials=10))
    found = {claim: set(table[table.index.str.startswith(claim)]) for claim in expected}
    assert found == {claim: {verdict} for claim, verdict in expected.items()}


def test_much_uncertainty_decides_nothing():
    assert set(verdicts(BIAS, 0.8)[[LOWEST, LARGEST, BETWEEN]]) == {OPEN}


def test_only_the_paper_s_joint_rate_and_period_are_judged():
    study = Study(system=["joint", "reflex"], duration_s=[40, 150], trials=10)
    bias = {
        key: lambda s, size=size: size if s.system == "joint" else 20 - size
        for key, size in BIAS.items()
    }
    assert verdicts(bias, study=study)[LOWEST] == YES
    other = paper_scores(bias, study=study).assign_attrs(study=Study(period=1.0).to_json())
    assert set(STUDY.judge(other).verdict) == {NOT}
    # Without noise, no scenario has 10 dB less
    found = verdicts(study=Study(snr_db=math.inf, trials=10))
    assert found[found.index.str.contains("10 dB less")].tolist() == [NOT]


def test_one_cell_against_a_claim_is_enough():
    def exception(scenario):
        return 20.0 if scenario.duration_s == 300 and scenario.perturbation == "prbs" else 4.0

    row = judged(BIAS | {("eirf", DEBIASED): exception}).loc[LOWEST]
    assert row.verdict == "does not hold"
    assert row.finding == (
        "4 of 40: debiased bias error 9 N·m/rad (sds, square-prbs-300s-10dB); "
        "debiased bias error 20 N·m/rad (eirf, square-prbs-300s-10dB)"
    )
    assert row.estimate == -11
    assert row.low < -11 < row.high < 0


def test_what_is_not_there_is_not_studied():
    table = verdicts(study=Study(duration_s=40.0, trials=10))
    assert table["With a sine, eirf varies most"] == NOT
    found = verdicts(BIAS, methods=FIVE[:4])
    assert set(found[[LOWEST, LARGEST, BETWEEN]]) == {NOT}
    assert tuple(STUDY.judge(paper_scores()).columns) == COLUMNS


def test_methods_without_results_leave_a_claim_undecided():
    assert verdicts(BIAS | {("kbr", DEBIASED): np.nan})[LOWEST] == OPEN
    everything = {(method, metric): np.nan for method in FIVE for metric in METRICS}
    assert YES not in set(verdicts(everything))


@given(st.floats(-3, 3), st.integers(1, 60))
def test_limits_that_exclude_zero_decide_a_single_comparison(estimate, count):
    samples = np.append(estimate, estimate + np.linspace(-1, 1, 401))
    names = [f"method {number}" for number in range(count)]
    evidence = Evidence(
        {("error", name): samples for name in names}, {"error": "N·m/rad"}, replicate_interval
    )
    (verdict,) = judge_claims([claim("c", "s", Margin(0), "error", names)], evidence).verdict
    low, high = estimate - 0.95, estimate + 0.95
    if low > 1e-9:
        assert verdict == "holds"
    elif high > 1e-9:
        assert verdict == "undecided"
    if estimate < -1:
        assert verdict == "does not hold"


@pytest.mark.parametrize("trials", [1, pytest.param(9, marks=pytest.mark.slow)])
def test_few_trials_decide_nothing(trials):
    table = STUDY.judge(score(run(Study(methods=FIVE, trials=trials, duration_s=40.0), workers=1)))
    assert set(table.verdict) == {"undecided", "not studied"}
