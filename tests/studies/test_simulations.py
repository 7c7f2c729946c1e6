import math

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from tvsysid.studies.claims import COLUMNS, Claim, Comparison, Scores, judge_claim
from tvsysid.studies.van_de_ruit_2021 import judge, preset
from tvsysid.studies.van_de_ruit_2021.simulations import CLAIMS, FIVE
from tvsysid.study import Study, run, score
from tvsysid.study.scores import METRICS

DRAWS = 200


def scores_of(values, errors=0.01, study=None):
    """Scores of the paper's study: values by (method, metric), or 1.

    Each with a normal uncertainty.
    """
    study = study or preset("paper", trials=10)
    random = np.random.default_rng(1)
    names = list(METRICS)
    shape = len(study.scenarios), len(FIVE), len(names)
    value = np.ones(shape)
    for (method, metric), number in values.items():
        value[:, FIVE.index(method), names.index(metric)] = [
            number(scenario) if callable(number) else number for scenario in study.scenarios
        ]
    replicates = value[..., None] * (1 + errors * random.standard_normal((*shape, DRAWS)))
    dims = ("scenario", "method_key", "metric")
    return xr.Dataset(
        {
            "value": (dims, value),
            "replicates": ((*dims, "draw"), replicates),
            "trials": (dims[:2], np.full(shape[:2], 10)),
        },
        coords={
            "scenario": [s.label for s in study.scenarios], "method_key": list(FIVE),
            "metric": names,
            "profile": ("scenario", [s.stiffness for s in study.scenarios]),
            "perturbation": ("scenario", [s.perturbation for s in study.scenarios]),
            "duration_s": ("scenario", [s.duration_s for s in study.scenarios]),
            "snr_db": ("scenario", [s.snr_db for s in study.scenarios]),
            "viscosity": ("scenario", [s.viscosity for s in study.scenarios]),
            "system": ("scenario", [s.system for s in study.scenarios]),
        },
    )  # fmt: skip


def verdicts(scores):
    return judge(scores).set_index("claim").verdict


BIAS = {
    (method, "debiased_bias_error"): level
    for method, level in zip(FIVE, (4, 9, 15, 11, 10), strict=True)
}


def test_only_the_paper_s_joint_rate_and_period_are_judged():
    study = Study(system=["joint", "reflex"], duration_s=[40, 150], trials=10)
    bias = {
        name: lambda s, low=low: low if s.system == "joint" else 20 - low
        for (name, _), low in BIAS.items()
    }
    scores = scores_of(
        {(name, "debiased_bias_error"): value for name, value in bias.items()}, study=study
    )
    assert verdicts(scores)["eirf has the lowest bias"] == "holds"
    assert set(verdicts(scores.assign_attrs(study=Study(period=1.0).to_json()))) == {"not studied"}


def test_a_claim_holds_fails_or_is_undecided_as_the_figures_say():
    told = verdicts(scores_of(BIAS))
    assert told["eirf has the lowest bias"] == told["birf has the largest bias"] == "holds"
    assert told["sds, esm, kbr lie between eirf and birf in bias"] == "holds"
    told = verdicts(scores_of(BIAS | {("eirf", "debiased_bias_error"): 12.0}))
    assert told["eirf has the lowest bias"] == "does not hold"
    assert told["birf has the largest bias"] == "holds"
    assert told["sds, esm, kbr lie between eirf and birf in bias"] == "does not hold"
    told = verdicts(scores_of(BIAS | {("eirf", "debiased_bias_error"): 9.0}))
    assert told["eirf has the lowest bias"] == "undecided"
    assert verdicts(scores_of(BIAS, errors=0.8))["eirf has the lowest bias"] == "undecided"


def test_one_cell_that_speaks_against_it_is_enough():
    def exception(scenario):
        return 20.0 if scenario.duration_s == 300 and scenario.perturbation == "prbs" else 4.0

    table = judge(scores_of(BIAS | {("eirf", "debiased_bias_error"): exception})).set_index("claim")
    row = table.loc["eirf has the lowest bias"]
    assert row.verdict == "does not hold"
    assert row.finding == (
        "4 of 40 comparisons speak against it; the clearest: bias (freed of random error) of sds "
        "9.0 N·m/rad, of eirf 20.0 N·m/rad (PRBS, 300 s)"
    )
    assert row.estimate == -11
    assert row.low < -11 < row.high < 0


def test_sensitivity_to_the_amount_of_data():
    def averaging(scenario):
        return 10 * np.sqrt(40 / scenario.duration_s)

    def exploding(scenario):
        return averaging(scenario) * (4 if scenario.duration_s == 40 else 1)

    even = {(method, "random_error"): averaging for method in FIVE}
    told = verdicts(scores_of(even))
    assert told["eirf is most sensitive to the amount of data"] == "undecided"
    assert told["eirf improves strongly above 40 s"] == "undecided"
    told = verdicts(scores_of(even | {("eirf", "random_error"): exploding}))
    assert told["eirf is most sensitive to the amount of data"] == "holds"
    assert told["eirf improves strongly above 40 s"] == "holds"


def test_what_hardly_depends_is_a_matter_of_its_size():
    claim = (
        "Under most conditions the total error hardly depends on the perturbation (less than 25 %)"
    )
    assert verdicts(scores_of({}))[claim] == "holds"

    def larger(by):
        return {
            (method, "total_error"): lambda scenario: by if scenario.perturbation == "prbs" else 1.0
            for method in ("eirf", "esm", "kbr")
        }

    assert verdicts(scores_of(larger(1.1)))[claim] == "holds"
    assert verdicts(scores_of(larger(1.5)))[claim] == "does not hold"
    assert verdicts(scores_of(larger(0.6)))[claim] == "does not hold"


def test_viscosity_is_judged_where_it_varies():
    claim = next(c.sentence for c in CLAIMS if "Viscosity" in c.sentence)
    assert verdicts(scores_of({}))[claim] == "not studied"
    study = preset("viscosity", trials=10)
    assert verdicts(scores_of({}, study=study))[claim] == "holds"
    other = {
        ("kbr", "total_error"): lambda scenario: 2.0 if scenario.viscosity == "covarying" else 1.0
    }
    assert verdicts(scores_of(other, study=study))[claim] == "does not hold"
    limit = {
        ("kbr", "total_error"): lambda scenario: 1.25 if scenario.viscosity == "covarying" else 1.0
    }
    assert verdicts(scores_of(limit, study=study))[claim] == "undecided"


def test_floors_of_the_vaf():
    high = {(method, "lowest_vaf"): 95.0 for method in FIVE}
    table = judge(scores_of(high)).set_index("claim")
    row = table.loc["Every VAF is above 85 % (square wave)"]
    assert row.verdict == "holds"
    # None of n: the upper limit is 1 - 0.05 ** (1 / n), here for 10 trials of each scenario.
    assert f"fewer than {100 * (1 - 0.05 ** (1 / 10)):.2g} %" in row.finding
    table = judge(scores_of(high | {("esm", "lowest_vaf"): 88.0})).set_index("claim")
    assert table.loc["Every VAF is above 85 % (square wave)"].verdict == "holds"
    assert table.loc["Every VAF is above 90 % (sine)"].verdict == "does not hold"


def test_what_is_not_studied_says_what_it_needs():
    table = judge(scores_of({}, study=Study(duration_s=40.0, trials=10))).set_index("claim")
    row = table.loc["With a sine, eirf varies most"]
    assert (row.verdict, row.remark) == (
        "not studied", "Needs a sine at 10 dB, and all five methods with their own settings."
    )  # fmt: skip
    four = scores_of(BIAS).sel(method_key=["eirf", "sds", "birf", "esm"])
    assert set(judge(four).verdict) == {"not studied"}
    assert tuple(judge(scores_of({})).columns) == COLUMNS


def test_methods_without_results_leave_a_claim_undecided():
    table = judge(scores_of(BIAS | {("kbr", "debiased_bias_error"): np.nan})).set_index("claim")
    row = table.loc["eirf has the lowest bias"]
    assert row.verdict == "undecided"
    assert "gave no results" in row.remark
    floor = "Every VAF is above 85 % (square wave)"
    lost = scores_of({(method, "lowest_vaf"): 95.0 for method in FIVE})
    lost["trials"] = lost.trials.where(lost.scenario != "square-noise-40s-10dB", 0)
    assert judge(lost).set_index("claim").verdict[floor] == "undecided"
    everything = {(method, metric): np.nan for method in FIVE for metric in METRICS}
    assert set(judge(scores_of(everything)).verdict) <= {"undecided", "not studied"}


@given(st.floats(-3, 3), st.integers(1, 60))
def test_limits_that_exclude_zero_decide_a_single_comparison(estimate, count):
    spread = np.linspace(-1, 1, 401)
    comparisons = [Comparison("m", np.append(estimate, estimate + spread))] * count
    claim = Claim("c", "s", lambda scores: iter(comparisons), "N·m/rad", "n")
    verdict = judge_claim(claim, Scores(scores_of({})))[7]
    low, high = estimate - 0.95, estimate + 0.95
    if low > 1e-9:
        assert verdict == "holds"
    elif high > 1e-9:
        assert verdict == "undecided"
    if estimate < -1:
        assert verdict == "does not hold"


@pytest.mark.parametrize(
    "trials", [1, *(pytest.param(some, marks=pytest.mark.slow) for some in (2, 9))]
)
def test_few_trials_decide_nothing(trials):
    table = judge(score(run(Study(methods=FIVE, trials=trials, duration_s=40.0), workers=1)))
    assert set(table.verdict) == {"undecided", "not studied"}


def test_without_noise_no_scenario_is_compared_with_itself():
    found = judge(scores_of({}, study=Study(snr_db=math.inf, trials=10)))
    (row,) = found[found.claim.str.contains("10 dB less")].itertuples()
    assert row.verdict == "not studied"
