"""Claims about reflexes against invented numbers; and a study of joints with a reflex, drawn."""

import numpy as np
import pytest
from tests.contracts.toys import Cascade
from tests.synthetic import scores_of

from tvsysid import studies
from tvsysid.studies.reflex import CONSTANT, GAIN, LOUD, SINE, STUDY
from tvsysid.study import Study, by_full_name, run, score, summarize

METHODS = ("eirf", "sds", "birf", "kbr", "cascade", "bpc", "tvpc", "pc", "sdss", "tvpc:window=0")
METRICS = ("mean_bias", "total_error", GAIN)
MANY = [SINE._replace(duration_s=seconds) for seconds in (200.0, 600.0, 1200.0)]
SCENARIOS = [SINE, *CONSTANT.values(), LOUD, *MANY]


def as_claimed(scenario, method, metric):
    """Numbers that fulfil every claim."""
    gain = dict(zip(CONSTANT.values(), CONSTANT, strict=True)).get(scenario, 8.0)
    if metric == "mean_bias":
        return 2.0 * gain + 0.5 if method in METHODS[:4] else 0.1
    if metric == "total_error":
        return {"sdss": 5.0, "pc": 9.0}.get(method, 6.0)
    if scenario in MANY:
        return {200.0: 4.0, 600.0: 3.0, 1200.0: 1.0}[scenario.duration_s]
    return {"sdss": 1.0, "pc": 2.0, "cascade": 0.1}.get(method, 1.5)


def verdicts(numbers=as_claimed, scenarios=SCENARIOS, trials=10):
    table = STUDY.judge(scores_of(numbers, scenarios, METHODS, METRICS, 0.02, trials))
    return table.set_index("claim").verdict


def test_claims_hold_where_numbers_are_as_claimed():
    assert set(verdicts()) == {"holds"}
    assert set(verdicts(trials=5)) == {"undecided"}
    assert set(verdicts(scenarios=[SINE._replace(perturbation="other")])) == {"not studied"}


@pytest.mark.parametrize(
    ("method", "metric", "value", "where", "claim"),
    [
        ("birf", "mean_bias", -7.5, [CONSTANT[4.0]], "Methods of one pathway take a reflex"),
        ("kbr", "mean_bias", 60.0, [CONSTANT[16.0]], "They do so in proportion"),
        ("bpc", "mean_bias", 9.0, SCENARIOS, "Methods of two pathways are free of it"),
        ("cascade", GAIN, 0.9, [CONSTANT[0.0]], "Without a reflex cascade finds none"),
        ("tvpc:window=0", GAIN, 1.0, MANY[:1], "tvpc needs 500 to 800 realizations"),
        ("bpc", GAIN, 3.0, [SINE], "Forty cycles suffice for bpc: reflex gain"),
        ("bpc", "total_error", 30.0, [SINE], "Forty cycles suffice for bpc: stiffness"),
        ("sdss", "total_error", 30.0, [LOUD], "With much noise (0 dB) sdss is more robust"),
    ],
)
def test_one_number_against_a_claim_is_enough(method, metric, value, where, claim):
    def numbers(scenario, *what):
        is_changed = what == (method, metric) and scenario in where
        return value if is_changed else as_claimed(scenario, *what)

    table = verdicts(numbers)
    (wrong,) = table.index[table == "does not hold"]
    assert wrong.startswith(claim)


def results_of(systems, methods, **settings):
    preset = STUDY.presets["reflex"]
    given = {name: preset[name] for name in ("stiffness", "perturbation", "subtract_mean")}
    return run(Study(**given, system=systems, methods=methods, **settings), workers=1)


@pytest.fixture(scope="module")
def results():
    systems = ["reflex-sine", "reflex-sine:noise_bandwidth=1"]
    systems += [CONSTANT[gain].system for gain in (0.0, 4.0, 16.0)]
    return results_of(systems, ["birf", Cascade()], duration_s=20, trials=2)


@pytest.mark.slow
def test_a_study_is_held_against_what_was_published_of_it(results):
    assert studies.published(results) is STUDY
    one_path = results.sel(method_key=["birf"])
    joint = results.sel(quantity=["stiffness", "viscosity"])
    assert studies.published(one_path) is studies.published(joint) is not STUDY


@pytest.mark.slow
def test_both_pathways_are_drawn_with_their_truth(results):
    scores = score(results)
    # One of the 5 scenarios has no reflex
    assert np.isfinite(scores.value.isel(method_key=1).sel(metric="reflex pathway_vaf")).sum() == 4
    shown = STUDY.figures(results, by_full_name(summarize(scores)))
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


@pytest.mark.slow
def test_the_error_of_the_gain_is_drawn_against_the_amount_of_data():
    found = results_of("reflex-sine", [Cascade()], duration_s=[8, 10, 14], trials=1)
    summary = by_full_name(summarize(score(found)))
    axes = STUDY.figures(found, summary)["amount-reflex-sine-sine"].draw().axes[0]
    expected = summary[summary.metric == GAIN].value
    drawn = axes.containers[0].lines[0].get_xydata()
    np.testing.assert_array_equal(drawn, np.c_[[8, 10, 14], expected])
