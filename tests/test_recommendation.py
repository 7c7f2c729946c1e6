"""Recommendation of a method: the table of rules, and the properties that it holds against data."""

import numpy as np
import pytest
from tests.conftest import ensemble_of

import tvsysid as tv
from tvsysid.recommendation.rules import RULES, rule_of

SOUND = {"realizations": 20, "information": 200, "slow noise": 0, "switches": 0}
SOUND |= {"mean stiffness": 100, "noise bias": 1, "constant": 0, "evidence of few harmonics": -3}
BY_VARIABLE = {"scheduling variable": 1, "realizations": 1}
LPVKBI = "lpvkbi:variable={scheduling}"
BY_REFERENCE = "birf:reference={reference},tuned=true"
WEIGHTED = "kbr:weighting=residual"
WEIGHTED_BY_REFERENCE = "kbr:reference={reference},weighting=residual"
FEW_HARMONICS = {"evidence of few harmonics": 9}
CASES = [
    ({}, "adaptive"),
    ({"switches": 2} | FEW_HARMONICS, "adaptive"),
    (BY_VARIABLE | {"reflex held out": 0.2}, LPVKBI),
    (BY_VARIABLE | {"reflex held out": 0.05}, f"{LPVKBI},reflex=false"),
    ({"wrong period": 47} | FEW_HARMONICS, None),
    ({"information": 1}, None),
    ({"feedback": 30}, None),
    ({"feedback": 30, "reference": 1}, WEIGHTED_BY_REFERENCE),
    ({"mean stiffness": -60}, None),
    ({"slow noise": 14, "noise bias": 45}, None),
    ({"slow noise": 14, "noise bias": 17, "switches": 2}, WEIGHTED),
    ({"loop bias": 24, "slow noise": 14}, f"{WEIGHTED_BY_REFERENCE},tuned=true"),
    ({"loop bias": 9, "switches": 2}, BY_REFERENCE),
    # A reflex, too, answers at some frequencies only.
    ({"reflex": 3, "slow noise": 17, "noise bias": 12}, "adaptive"),
    ({"slow noise": 14} | FEW_HARMONICS, f"{WEIGHTED},tuned=true"),
    (FEW_HARMONICS, "birf:tuned=true"),
    ({"constant": 90}, "birf:tuned=true"),
    ({"realizations": 3}, "cascade"),
]


def rule_for(differences):
    return rule_of({name: (value, "") for name, value in (SOUND | differences).items()})


@pytest.mark.parametrize(("differences", "suited"), CASES)
def test_rules(differences, suited):
    assert next(iter(rule_for(differences).methods), None) == suited


def test_every_rule_decides_a_case_and_names_methods():
    assert {rule_for(differences) for differences, _ in CASES} == set(RULES)
    for rule in RULES:
        for typed in rule.methods:
            tv.methods.parse(typed.format(reference="command", scheduling="emg"))


@pytest.mark.slow
def test_few_realizations_and_the_method_that_leads_then():
    ensemble = ensemble_of().select([0, 1])  # of a sine
    found = tv.recommend(ensemble)
    assert found.suited == ("birf:tuned=true", "kbr")  # adaptive does not apply
    assert "at most 3 harmonics of the period describe how" in repr(found)
    assert tv.compare(ensemble, ["eirf", "birf", "kbr"]).leading == "kbr"


def test_slow_changes_are_seen_by_the_evidence():
    found = tv.recommend(ensemble_of())
    assert found.suited == ("birf:tuned=true", "adaptive", "kbr")  # a sine
    assert found.measured["evidence of few harmonics"][0] > 10
    assert abs(found.measured["noise bias"][0]) < 2


@pytest.mark.parametrize(("gain", "suited"), [(0.0, ",reflex=false"), (8.0, "")])
def test_a_reflex_beside_a_measured_variable_by_held_out_folds(gain, suited):
    gains = np.polynomial.Polynomial([gain]) if gain else None
    joint = tv.simulate.ScheduledJoint(gain_relation=gains)
    ensemble = identifiable(joint, 30, tv.simulate.FilteredNoise(), 10)
    found = tv.recommend(ensemble, scheduling="emg")
    assert found.suited[0].startswith(f"lpvkbi:variable=emg{suited}")
    assert found.suited[-2:] == ("lpvkbi:variable=emg", "lpv:variable=emg")


def identifiable(joint, duration, perturbation, snr_db, channels=()):
    recording = joint.simulate(duration, perturbation=perturbation, snr_db=snr_db, seed=1).recording
    ensemble = tv.preprocess.segment(tv.preprocess.decimate(recording, 100), 2.0)
    return tv.preprocess.subtract_mean(ensemble, channels)


@pytest.fixture(scope="module")
def closed_loop():
    joint = tv.simulate.CompliantActuator(
        tv.simulate.SineWave(), noise_bandwidth=5.0, disturbance="torque"
    )
    return identifiable(joint, 40, tv.simulate.FilteredNoise(20.0), 5, ["disturbance"])


@pytest.mark.slow
def test_a_loop_with_a_named_reference(closed_loop):
    found = tv.recommend(closed_loop, "disturbance")
    assert found.suited[0] == "kbr:reference=disturbance,weighting=residual,tuned=true"
    assert found.measured["loop bias"][0] == pytest.approx(25, abs=10)
    assert not found.possible_loop
    # A method leads whatever its settings that are chosen from data; another reference is another.
    by = {
        name: tv.KernelRegression(reference=name, weighting="residual")
        for name in ("other", "disturbance")
    }
    assert found.select(by | {"sds": tv.ShortDataSegments()}) == ["disturbance"]


@pytest.mark.slow
def test_a_loop_with_an_unnamed_reference(closed_loop):
    found = tv.recommend(closed_loop, diagnosis=tv.diagnose(closed_loop))
    assert found.suited[0] == "kbr:weighting=residual"
    assert "frequencies with noise make stiffness 1" in found.why
    assert found.measured["noise bias"][0] == pytest.approx(17, abs=5)
    assert found.possible_loop
    assert "record the actuator's command" in found.caveats[-2]
    assert found.unnamed_references == found.caveats[-1:]
    assert "'disturbance' moves the angle, and was not named as the reference" in found.caveats[-1]


def test_bad_input():
    with pytest.raises(tv.InputError, match="expected an Ensemble, got int"):
        tv.recommend(1)
    with pytest.raises(tv.InputError, match="command"):
        tv.recommend(ensemble_of(), "command")
