"""What the literature says of reflexes, against made-up figures.

And a study of joints with a reflex, drawn.
"""

import numpy as np
import pytest
from tests.contracts.toys import Cascade
from tests.synthetic import scores_of

from tvsysid.studies import reflex, van_de_ruit_2021
from tvsysid.studies.reflex import CONSTANT, LOUD, SINE
from tvsysid.study import Study, by_full_name, run, score, summarize

METHODS = ("eirf", "sds", "birf", "kbr", "cascade", "bpc", "tvpc", "pc", "sdss", "tvpc:window=0")
METRICS = ("mean_bias", "total_error", "reflex_gain total_error")
MANY = [SINE._replace(duration_s=seconds) for seconds in (200.0, 600.0, 1200.0)]
SCENARIOS = [SINE, *CONSTANT.values(), LOUD, *MANY]


def as_told(scenario, method, metric):
    """What would bear out every claim."""
    one_path = method in METHODS[:4]
    gain = dict(zip(CONSTANT.values(), CONSTANT, strict=True)).get(scenario, 8.0)
    if metric == "mean_bias":
        return 2.0 * gain + 0.5 if one_path else 0.1
    if metric == "total_error":
        return {"sdss": 5.0, "pc": 9.0}.get(method, 6.0)
    if scenario in MANY:
        return {200.0: 4.0, 600.0: 3.0, 1200.0: 1.0}[scenario.duration_s]
    return {"sdss": 1.0, "pc": 2.0, "cascade": 0.1}.get(method, 1.5)


def verdicts(told=as_told, scenarios=SCENARIOS, trials=10):
    return reflex.judge(scores_of(told, scenarios, METHODS, METRICS, 0.02, trials))


def changed(method, metric, value, where=SCENARIOS):
    def told(scenario, *place):
        return (
            value if place == (method, metric) and scenario in where else as_told(scenario, *place)
        )

    return told


def test_claims_hold_where_figures_are_as_told():
    table = verdicts()
    assert set(table.verdict) == {"holds"}, table[["claim", "verdict", "finding"]].to_string()
    assert set(verdicts(trials=5).verdict) == {"undecided"}
    assert set(verdicts(scenarios=[SINE._replace(perturbation="other")]).verdict) == {"not studied"}


@pytest.mark.parametrize(
    ("told", "claim"),
    [
        (
            changed("birf", "mean_bias", -3.0, [CONSTANT[4.0]]),
            "Methods of one pathway take a reflex for stiffness",
        ),
        (changed("kbr", "mean_bias", 60.0, [CONSTANT[16.0]]), "They do so in proportion"),
        (changed("bpc", "mean_bias", 9.0), "Methods of two pathways are free of it"),
        (
            changed("cascade", "reflex_gain total_error", 0.9, [CONSTANT[0.0]]),
            "Without a reflex cascade finds none",
        ),
        (
            changed("tvpc:window=0", "reflex_gain total_error", 1.0, MANY[:1]),
            "tvpc needs 500 to 800 realizations",
        ),
        (
            changed("bpc", "reflex_gain total_error", 3.0, [SINE]),
            "Forty cycles suffice for bpc: reflex gain",
        ),
        (changed("bpc", "total_error", 30.0, [SINE]), "Forty cycles suffice for bpc: stiffness"),
        (
            changed("sdss", "total_error", 30.0, [LOUD]),
            "With much noise (0 dB) sdss is more robust",
        ),
    ],
)
def test_one_figure_speaks_against_each_claim(told, claim):
    table = verdicts(told).set_index("claim").verdict
    wrong = table.index[table == "does not hold"]
    assert len(wrong) == 1
    assert wrong[0].startswith(claim)


SETTINGS = {
    name: reflex.PRESETS["reflex"][name] for name in ("stiffness", "perturbation", "subtract_mean")
}


@pytest.fixture(scope="module")
def results():
    systems = [
        "reflex-sine",
        "reflex-sine:noise_bandwidth=1",
        *(CONSTANT[gain].system for gain in (0.0, 4.0, 16.0)),
    ]
    return run(
        Study(**SETTINGS, system=systems, duration_s=20, trials=2, methods=["birf", Cascade()]),
        workers=1,
    )


@pytest.mark.slow
def test_a_study_is_held_against_what_was_published_of_it(results):
    assert reflex.published(results) is reflex.LITERATURE
    one_path = results.sel(method_key=["birf"])
    assert reflex.published(one_path) is not reflex.LITERATURE
    joint = results.sel(quantity=["stiffness", "viscosity"])
    assert reflex.published(joint) is not reflex.LITERATURE


@pytest.mark.slow
def test_both_pathways_are_drawn_with_their_truth(results):
    scores = score(results)
    # One of the 5 scenarios has no reflex
    assert np.isfinite(scores.value.isel(method_key=1).sel(metric="reflex pathway_vaf")).sum() == 4
    summary = by_full_name(summarize(scores))
    shown = reflex.reflex_figures(results, summary)
    assert list(shown) == ["pathways-reflex-sine-sine", "pathways-reflex-sine", "bias-reflex-sine"]
    figure = shown["pathways-reflex-sine-sine"].draw()
    rows = {axes.get_ylabel().partition("\n")[0]: axes for axes in figure.axes if axes.get_ylabel()}
    assert {"stiffness", "reflex gain", "error of gain", "VAF intrinsic", "VAF reflex"} <= set(rows)
    truth = rows["reflex gain"].lines[0].get_ydata()
    np.testing.assert_allclose(truth, results.truth.sel(quantity="reflex_gain")[0], atol=1e-9)
    labels = [label.get_text() for label in rows["VAF reflex"].get_xticklabels()]
    assert "noise bandwidth=1" in labels[1]
    bias = shown["bias-reflex-sine"].draw().axes[0]
    assert [float(tick.get_text()) for tick in bias.get_xticklabels()] == [0, 4, 16]
    assert "birf: " in shown["bias-reflex-sine"].description
    assert van_de_ruit_2021.preset("reflex", reflex.PRESETS, trials=2).trials == 2


@pytest.mark.slow
def test_the_error_of_the_gain_is_drawn_against_the_amount_of_data():
    study = Study(
        **SETTINGS, system="reflex-sine", duration_s=[8, 10, 14], trials=1, methods=[Cascade()]
    )
    found = run(study, workers=1)
    summary = by_full_name(summarize(score(found)))
    axes = reflex.reflex_figures(found, summary)["amount-reflex-sine-sine"].draw().axes[0]
    expected = summary[summary.metric == "reflex_gain total_error"].value
    np.testing.assert_array_equal(
        axes.containers[0].lines[0].get_xydata(), np.c_[[8, 10, 14], expected]
    )
