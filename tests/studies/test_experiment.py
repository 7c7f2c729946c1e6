"""Claims of the paper's experiment against made-up figures."""

import attrs
import numpy as np
import pytest
import xarray as xr
from scipy.stats import ttest_1samp

import tvsysid as tv
from tvsysid.studies.claims import COLUMNS
from tvsysid.studies.van_de_ruit_2021 import folder, judge
from tvsysid.studies.van_de_ruit_2021.experiment import CLAIMS, EXCLUDED, FIVE
from tvsysid.study import Experiment

VAF = {"noise": {"eirf": 62, "sds": 52, "birf": 51, "esm": 50, "kbr": 67},
       "prbs": {"eirf": 87, "sds": 76, "birf": 75, "esm": 75, "kbr": 50}}  # fmt: skip
BAND = {"noise": 60.0, "prbs": 50.0}
SPREAD = {"eirf": 20.0, "sds": 10.0, "birf": 5.0, "esm": 9.0, "kbr": 12.0}


def results_like_the_papers(people=6, amounts=2, perturbations=("noise", "prbs"), draws=40):
    """As the paper tells them; each participant differs a little."""
    random = np.random.default_rng(0)
    time = np.arange(256) / 128
    analyses = [
        (method, (20, 40)[k] if method == "kbr" else (75, 150)[k])
        for method in FIVE
        for k in range(amounts)
    ]
    recordings = [(f"P{number}", name) for number in range(people) for name in perturbations]
    shape = len(recordings), len(analyses)
    stiffness, vaf, band = (
        np.empty((*shape, draws, 256)),
        np.empty((*shape, draws)),
        np.empty((*shape, draws)),
    )
    for row, (_, name) in enumerate(recordings):
        for column, (method, count) in enumerate(analyses):
            more = count in (40, 150)
            spread = (
                SPREAD[method]
                / np.sqrt(1 + more)
                * (1.3 if method == "kbr" and name == "prbs" else 1.0)
            )
            mean = 100 + 40 * np.sin(np.pi * time)
            stiffness[row, column] = mean + spread * random.standard_normal((draws, 256))
            vaf[row, column] = (
                VAF[name][method] + random.normal(0, 0.1) + random.normal(0, 0.5, draws)
            )
            band[row, column] = BAND[name] + random.normal(0, 0.1) + random.normal(0, 0.5, draws)
    dip = 10 * np.cos(2 * np.pi * time)
    torque = np.tile(10 + 5 * np.sin(np.pi * time), (len(recordings), 1))
    middle = {
        f"excluded_{step}": (
            "recording",
            [int(np.mean(EXCLUDED[name][step])) for _, name in recordings],
        )
        for step in ("alignment", "task", "residual")
    }
    kept = [{"noise": 260, "prbs": 255}[name] + random.integers(-5, 6) for _, name in recordings]
    dims = ("recording", "analysis")
    return xr.Dataset(
        {
            "estimate": ((*dims, "bootstrap", "quantity", "time"), stiffness[..., None, :]),
            "time_varying_vaf": ((*dims, "bootstrap", "time"), vaf[..., None] - dip),
            "vaf": ((*dims, "bootstrap"), vaf), "bandpassed_vaf": ((*dims, "bootstrap"), band),
            "seconds": (dims, np.ones(shape)), "mean_torque": (("recording", "time"), torque),
            "truth": (("recording", "quantity", "time"), torque[:, None] * np.nan),
            "recorded": ("recording", [300] * len(recordings)), "survivors": ("recording", kept),
            **middle,
        },
        coords={
            "participant": ("recording", [who for who, _ in recordings]),
            "perturbation": ("recording", [name for _, name in recordings]),
            "method_key": ("analysis", [method for method, _ in analyses]),
            "realizations": ("analysis", [count for _, count in analyses]), "time": time,
            "quantity": ["stiffness"],
        },
    )  # fmt: skip


def verdicts(results):
    return judge(results).set_index("claim").verdict


def test_results_like_the_papers_fulfil_every_claim():
    table = judge(results_like_the_papers())
    assert list(table.columns) == list(COLUMNS)
    assert len(table) == len(CLAIMS)
    assert (table.verdict == "holds").all(), table[table.verdict != "holds"][
        ["claim", "finding", "verdict"]
    ]
    assert table.finding.str.len().min() > 10


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


@pytest.mark.parametrize(
    ("claim", "change"),
    [
        ("Some 255 to 260 of 300", lambda r: r.assign(survivors=r.survivors - 60)),
        ("Each step excludes as many", lambda r: r.assign(excluded_task=r.excluded_task + 30)),
        ("PRBS gives 20 to 30 %", of_prbs("vaf", lambda vaf: vaf - 15)),
        ("PRBS gives more VAF than noise", of_prbs("vaf", lambda vaf: 40 + 0 * vaf)),
        ("VAFs from 150 s lie near", lambda r: r.assign(vaf=r.vaf - 20)),
        ("kbr has more VAF with noise", of_prbs("vaf", lambda vaf: vaf + 30)),
        ("Between 1 and 10 Hz, PRBS gives less", of_prbs("bandpassed_vaf", lambda vaf: vaf + 20)),
        (
            "Between 1 and 10 Hz, PRBS gives about 10 %",
            of_prbs("bandpassed_vaf", lambda vaf: vaf + 9),
        ),
        ("The random error falls", of_more("estimate", lambda k: 100 + 3 * (k - 100))),
        ("The mean stiffness stays", of_more("estimate", lambda k: 1.2 * k)),
        ("The random error is largest for eirf", spread_of("sds", 4)),
        ("The random error is smallest for birf", spread_of("birf", 8)),
        (
            "The random error of kbr is larger with PRBS",
            of_prbs("estimate", lambda k: 100 + (k - 100) / 2),
        ),
        ("More data do not raise the VAF", of_more("vaf", lambda vaf: vaf + 5)),
        ("Stiffness rises with torque", lambda r: r.assign(mean_torque=-r.mean_torque)),
        (
            "The time-varying VAF is lower",
            lambda r: r.assign(time_varying_vaf=100 - r.time_varying_vaf),
        ),
    ],
)
def test_a_claim_that_is_not_so_does_not_hold(claim, change):
    told = verdicts(change(results_like_the_papers()))
    (verdict,) = told[[text for text in told.index if text.startswith(claim)]]
    assert verdict == "does not hold"


def test_what_was_not_recorded_is_not_studied():
    told = verdicts(results_like_the_papers(perturbations=("noise",), amounts=1))
    assert told["PRBS gives 20 to 30 % more VAF than noise for all but kbr"] == "not studied"
    assert (
        told["The random error falls with more data (in the paper from 150 s to 300 s)"]
        == "not studied"
    )
    assert told["The random error is largest for eirf"] == "holds"
    named = results_like_the_papers(perturbations=("noise",))
    named["perturbation"] = ("recording", ["walking"] * named.sizes["recording"])
    assert set(verdicts(named)) == {"not studied"}


def test_two_participants_decide_nothing():
    told = verdicts(results_like_the_papers(people=2))
    assert set(told) == {"undecided"}


def test_two_participants_with_both_perturbations_decide_nothing_between_them():
    results = results_like_the_papers()
    few = results.isel(
        recording=(
            (results.perturbation == "noise") | results.participant.isin(["P0", "P1"])
        ).values
    )
    told = verdicts(few)
    assert told["PRBS gives 20 to 30 % more VAF than noise for all but kbr"] == "undecided"
    assert (
        told["More data do not raise the VAF, which noisy torque limits (by less than 1 point)"]
        == "undecided"
    )
    nobody = results.isel(
        recording=(
            (results.perturbation == "noise") == results.participant.isin(["P0", "P1"])
        ).values
    )
    assert (
        verdicts(nobody)["PRBS gives 20 to 30 % more VAF than noise for all but kbr"] == "undecided"
    )


def test_a_participant_who_lacks_one_perturbation_counts_for_the_other():
    results = results_like_the_papers().isel(recording=slice(1, None))
    assert set(verdicts(results)) == {"holds"}


def test_limits_are_those_of_a_t_distribution_over_participants():
    results = results_like_the_papers()
    row = judge(results).set_index("claim").loc["kbr has more VAF with noise than with PRBS"]
    kbr = (
        results.vaf.isel(analysis=(results.method_key == "kbr").values)
        .isel(analysis=0)
        .mean("bootstrap")
    )
    difference = kbr.values[::2] - kbr.values[1::2]
    low, high = ttest_1samp(difference, 0).confidence_interval(0.95)
    assert (row.estimate, row.low, row.high) == (
        pytest.approx(difference.mean()),
        pytest.approx(low),
        pytest.approx(high),
    )


def test_a_recording_with_a_reference_is_diagnosed_with_it():
    methods = ["sds", "kbr:reference=disturbance", "kbr:reference=other"]
    experiment = Experiment(virtual=[1], methods=methods)
    values = np.arange(18.0).reshape(2, 9)
    recorded = tv.Ensemble(values, values, 100.0)
    assert folder._reference(experiment, recorded) is None
    assert (
        folder._reference(experiment, attrs.evolve(recorded, channels={"disturbance": values}))
        == "disturbance"
    )
