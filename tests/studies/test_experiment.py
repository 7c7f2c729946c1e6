"""Claims of the paper's experiment against invented numbers."""

import numpy as np
import pytest
from scipy.stats import ttest_1samp
from tests.experimental import results_of

from tvsysid.studies.claims import COLUMNS
from tvsysid.studies.van_de_ruit_2021.experiment import (
    CLAIMS,
    EXCLUDED,
    FIVE,
    SURVIVED,
    judge_experiment,
)
from tvsysid.study import score

VAF = {"noise": {"eirf": 62, "sds": 52, "birf": 51, "esm": 50, "kbr": 67},
       "prbs": {"eirf": 87, "sds": 76, "birf": 75, "esm": 75, "kbr": 50}}  # fmt: skip
BAND = {"noise": 60.0, "prbs": 50.0}
SPREAD = {"eirf": 20.0, "sds": 10.0, "birf": 5.0, "esm": 9.0, "kbr": 12.0}
PRBS_GIVES_MORE = "PRBS gives 20 to 30 % more VAF than noise for all but kbr"


def results_like_the_papers(people=4, draws=40):
    """Return results that fulfil every claim; each participant differs a little."""
    random = np.random.default_rng(0)
    results = results_of([f"P{number}" for number in range(people)], bootstraps=draws)
    time = results.time.values
    names, methods = (results[name].values for name in ("perturbation", "method_key"))
    sizes = len(names), len(methods)

    def table(number):
        return np.array([[[number(name, method)] for method in methods] for name in names])

    def drawn(mean):
        return mean + random.normal(0, 0.1, (*sizes, 1)) + random.normal(0, 0.5, (*sizes, draws))

    def like(name, values):
        return results[name].copy(data=values)

    vaf = drawn(table(lambda name, method: VAF[name][method]))
    spread = table(lambda name, method: SPREAD[method])
    spread[names == "prbs", methods.tolist().index("kbr") :] *= 1.3
    spread[:, 1::2] /= np.sqrt(2)  # of twice as much data
    noise = spread[..., None, None] * random.standard_normal((*sizes, draws, 1, len(time)))
    return results.assign(
        estimate=like("estimate", 100 + 40 * np.sin(np.pi * time) + noise),
        time_varying_vaf=like("time_varying_vaf", vaf[..., None] - 10 * np.cos(2 * np.pi * time)),
        vaf=like("vaf", vaf),
        bandpassed_vaf=like("bandpassed_vaf", drawn(table(lambda name, _: BAND[name]))),
        mean_torque=like("mean_torque", np.tile(10 + 5 * np.sin(np.pi * time), (sizes[0], 1))),
        survivors=like("survivors", [SURVIVED[name][0] + random.integers(-5, 6) for name in names]),
        **{
            f"excluded_{step}": like(
                f"excluded_{step}", [int(np.mean(EXCLUDED[name][step])) for name in names]
            )
            for step in EXCLUDED["noise"]
        },
    )


@pytest.fixture(scope="module")
def results():
    return results_like_the_papers()


def judged(results):
    return judge_experiment(results, score(results))


def verdicts(results):
    return judged(results).set_index("claim").verdict


@pytest.mark.slow
def test_results_like_the_papers_fulfil_every_claim(results):
    table = judged(results)
    assert list(table.columns) == list(COLUMNS)
    assert len(table) == len(CLAIMS)
    assert set(table.verdict) == {"holds"}
    assert table.finding.str.len().min() > 10
    assert set(verdicts(results.isel(recording=slice(1, None)))) == {"holds"}


def of_prbs(name, change):
    return lambda r: r.assign({name: r[name].where(r.perturbation == "noise", change(r[name]))})


def of_more(name, change):
    return lambda r: r.assign(
        {name: r[name].where(~r.realizations.isin([40, 150]), change(r[name]))}
    )


def spread_of(method, times):
    return lambda r: r.assign(
        estimate=r.estimate.where(r.method_key != method, 100 + times * (r.estimate - 100))
    )


# Claims of different quantities are judged together.
@pytest.mark.parametrize(
    "changes",
    [
        {
            "Some 255 to 260 of 300": lambda r: r.assign(survivors=r.survivors - 60),
            "Each step excludes as many": lambda r: r.assign(excluded_task=r.excluded_task + 30),
            "PRBS gives 20 to 30 %": of_prbs("vaf", lambda vaf: vaf - 15),
            "Between 1 and 10 Hz, PRBS gives less": of_prbs("bandpassed_vaf", lambda x: x + 20),
            "The random error falls": of_more("estimate", lambda k: 100 + 3 * (k - 100)),
            "Stiffness rises with torque": lambda r: r.assign(mean_torque=-r.mean_torque),
            "The time-varying VAF": lambda r: r.assign(time_varying_vaf=100 - r.time_varying_vaf),
        },
        {
            "PRBS gives more VAF than noise": of_prbs("vaf", lambda vaf: 40 + 0 * vaf),
            "Between 1 and 10 Hz, PRBS gives about": of_prbs("bandpassed_vaf", lambda x: x + 9),
            "The mean stiffness stays": of_more("estimate", lambda k: 1.2 * k),
        },
        {
            "VAFs lie near the paper": lambda r: r.assign(vaf=r.vaf - 20),
            "The random error is largest for eirf": spread_of("sds", 4),
        },
        {
            "kbr has more VAF with noise": of_prbs("vaf", lambda vaf: vaf + 30),
            "The random error is smallest for birf": spread_of("birf", 8),
        },
        {
            "More data do not raise the VAF": of_more("vaf", lambda vaf: vaf + 5),
            "The random error of kbr": of_prbs("estimate", lambda k: 100 + (k - 100) / 2),
        },
    ],
)
def test_claims_that_are_not_so_do_not_hold(results, changes):
    for change in changes.values():
        results = change(results)
    table = verdicts(results)
    for claim in changes:
        assert table[table.index.str.startswith(claim)].tolist() == ["does not hold"], claim


def test_what_was_not_recorded_is_not_studied(results):
    noise = results.isel(recording=(results.perturbation == "noise").values)
    table = verdicts(noise.isel(analysis=slice(0, None, 2)))
    assert table[PRBS_GIVES_MORE] == "not studied"
    assert set(table[table.index.str.startswith("The random error falls")]) == {"not studied"}
    assert table["The random error is largest for eirf"] == "holds"
    four = verdicts(noise.isel(analysis=(noise.method_key != "kbr").values))
    assert four["The random error is largest for eirf"] == "not studied"
    walking = noise.assign_coords(perturbation=("recording", ["walking"] * 4))
    assert len(verdicts(walking)) == 0


def test_two_participants_decide_nothing(results):
    assert set(verdicts(results_like_the_papers(people=2))) == {"undecided"}
    of_two = (results.perturbation == "noise") | results.participant.isin(["P0", "P1"])
    assert verdicts(results.isel(recording=of_two.values))[PRBS_GIVES_MORE] == "undecided"


def test_limits_are_those_of_a_t_distribution_over_participants(results):
    row = judged(results).set_index("claim").loc["kbr has more VAF with noise than with PRBS"]
    kbr = results.vaf.isel(analysis=FIVE.index("kbr") * 2).mean("bootstrap").values
    difference = kbr[::2] - kbr[1::2]
    limits = ttest_1samp(difference, 0).confidence_interval(0.95)
    expected = [difference.mean(), *limits]
    np.testing.assert_allclose([row.estimate, row.low, row.high], expected, rtol=1e-9)
