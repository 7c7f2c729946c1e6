"""Recommendation of a method: the table of rules, and the properties that it holds against data."""

import pytest
from tests.conftest import ensemble_of, realizations

import tvsysid as tv
from tvsysid.recommendation.method import RULES, DataProperties

SOUND = {"realizations": 20, "information": 200.0}
LPVKBI = "lpvkbi:variable={scheduling}"
WEIGHTED = "kbr:weighting=residual"
BY_REFERENCE = "kbr:reference={reference},weighting=residual,tuned=true"
SLOW = {"slow_noise": 14.0}
CASES = [
    ({}, "adaptive"),
    ({"scheduling": "emg", "realizations": 1}, LPVKBI),
    ({"faults": {"wrong-period"}}, None),
    ({"information": 1.0}, None),
    ({"faults": {"feedback"}}, None),
    ({"faults": {"feedback"}, "reference": "command"}, BY_REFERENCE),
    (SLOW | {"noise_bias": 45.0}, None),
    (SLOW | {"noise_bias": 17.0}, WEIGHTED),
    (SLOW | {"loop_bias": 24.0}, BY_REFERENCE),
    ({"loop_bias": 9.0}, "birf:reference={reference},tuned=true"),
    # A reflex, too, answers at some frequencies only.
    (SLOW | {"faults": {"reflex"}, "noise_bias": 12.0}, "adaptive"),
    (SLOW, "adaptive"),
    ({"realizations": 3}, "cascade"),
]


def rule_for(differences):
    measured = DataProperties(**SOUND | differences)
    return next(rule for rule in RULES if rule.holds(measured))


@pytest.mark.parametrize(("differences", "suited"), CASES)
def test_rules(differences, suited):
    assert next(iter(rule_for(differences).methods), None) == suited


def test_every_rule_decides_a_case_and_names_methods():
    assert {rule_for(differences) for differences, _ in CASES} == set(RULES)
    for rule in RULES:
        for typed in rule.methods:
            tv.methods.parse(typed.format(reference="command", scheduling="emg"))


@pytest.mark.filterwarnings("ignore::tvsysid.DataQualityWarning")
def test_few_realizations_and_the_method_that_leads_then():
    ensemble = ensemble_of().select([0, 1])
    assert tv.recommend(ensemble).suited == ("cascade", "kbr")
    assert tv.compare(ensemble, ["eirf", "birf", "kbr"]).answer.label == "kbr"


def identifiable(joint, duration, perturbation, snr_db, channels=()):
    recording = joint.simulate(duration, perturbation=perturbation, snr_db=snr_db, seed=1).recording
    ensemble = realizations(recording)
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
    assert found.measured.loop_bias == pytest.approx(25, abs=10)
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
    assert "frequencies with noise make stiffness 1" in repr(found)
    assert found.measured.noise_bias == pytest.approx(17, abs=5)
    (unnamed,) = found.unnamed_references
    assert "'disturbance' moves the angle, and was not named as the reference" in unnamed


def test_bad_input():
    with pytest.raises(tv.InputError, match="expected an Ensemble, got int"):
        tv.recommend(1)
    with pytest.raises(tv.InputError, match="command"):
        tv.recommend(ensemble_of(), "command")
