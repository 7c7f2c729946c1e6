"""Claims about closed loops against invented numbers; and a study of them, drawn."""

import pytest
from tests.synthetic import scores_of

from tvsysid import studies
from tvsysid.studies.closed_loop import (
    ACTUATORS,
    CLOSED,
    IMPOSED,
    LONG,
    OPEN,
    SNR,
    STUDY,
    UNWEIGHTED,
    scenario,
)
from tvsysid.study import Study, by_full_name, run, score, summarize

METHODS = (*OPEN, *CLOSED, UNWEIGHTED)
METRICS = ("mean_bias", "random_error", "coverage")
SCENARIOS = [scenario(actuator, noise) for noise in SNR for actuator in (*ACTUATORS, IMPOSED)]
SCENARIOS.append(scenario(100.0, 5.0, LONG))
SOFT = [place for place in SCENARIOS if f"actuator_stiffness={IMPOSED:g}" not in place.system]
SLOW = [place for place in SOFT if "noise_bandwidth=5" in place.system and place.duration_s != LONG]
WIDE = [place for place in SOFT if "noise_bandwidth=40" in place.system]


def as_claimed(place, method, metric):
    """Numbers that fulfil every claim."""
    slow = "noise_bandwidth=40" not in place.system
    if metric == "mean_bias":
        return (-24.0 if slow else -2.0) if method in OPEN else 0.5
    if metric == "coverage":
        return 94.0
    return 5.0 if slow and "weighting" in method else 10.0


def verdicts(numbers=as_claimed, scenarios=SCENARIOS, trials=10):
    table = STUDY.judge(scores_of(numbers, scenarios, METHODS, METRICS, 0.002, trials))
    return table.set_index("claim").verdict


def test_claims_hold_where_numbers_are_as_claimed():
    assert set(verdicts()) == {"holds"}
    assert set(verdicts(trials=5)) == {"undecided"}
    other = SCENARIOS[0]._replace(perturbation="other")
    assert set(verdicts(scenarios=[other])) == {"not studied"}


@pytest.mark.parametrize(
    ("method", "metric", "value", "where", "claim"),
    [
        ("sds", "mean_bias", -9.0, SLOW[:1], "Without a reference slow noise"),
        ("birf", "mean_bias", -20.0, SCENARIOS[-1:], "A longer record does not mend it"),
        ("kbr", "mean_bias", -9.0, WIDE, "Noise up to 40 Hz at 10 dB"),
        (CLOSED[3], "mean_bias", -2.0, SLOW[:1], "kbr with a reference and weights is off"),
        (CLOSED[2], "mean_bias", -3.0, SLOW[:1], "esm and birf with a reference"),
        (CLOSED[3], "coverage", 70.0, SLOW[:1], "The bands of kbr with a reference"),
        (CLOSED[1], "coverage", 99.0, WIDE[:1], "Those of esm and birf"),
        (CLOSED[1], "random_error", 10.5, SCENARIOS, "Where the angle is imposed"),
        (UNWEIGHTED, "random_error", 6.0, SLOW[:1], "Weighting by the residual"),
        (CLOSED[3], "random_error", 11.0, WIDE[:1], "Weighting by the residual"),
    ],
)
def test_one_number_against_a_claim_is_enough(method, metric, value, where, claim):
    def numbers(place, *what):
        is_changed = what == (method, metric) and place in where
        return value if is_changed else as_claimed(place, *what)

    table = verdicts(numbers)
    (wrong,) = table.index[table == "does not hold"]
    assert wrong.startswith(claim)


@pytest.mark.slow
def test_a_study_of_loops_is_drawn_and_held_against_them():
    preset = STUDY.presets["closed-loop"]
    given = {name: preset[name] for name in ("stiffness", "perturbation", "subtract_mean")}
    systems = [each.system for each in WIDE[:2]]
    results = run(
        Study(**given, system=systems, duration_s=20, trials=2, methods=["birf", CLOSED[2]]),
        workers=1,
    )
    assert studies.published(results) is STUDY
    summary = by_full_name(summarize(score(results)))
    shown = STUDY.figures(results, summary)
    assert list(shown) == ["bias-40Hz", "comparison-40Hz", "coverage-40Hz"]
    axes = shown["bias-40Hz"].draw().axes[0]
    assert [float(tick.get_text()) for tick in axes.get_xticklabels()] == [30, 100]
    assert f"{CLOSED[2]}: " in shown["bias-40Hz"].description
    assert shown["comparison-40Hz"].draw().axes[0].lines
    assert shown["coverage-40Hz"].draw().axes[0].lines
    assert studies.preset("closed-loop", trials=2).trials == 2
