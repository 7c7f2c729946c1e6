"""Which method suits an ensemble: the table of rules, and what is measured for it."""

import math
from types import SimpleNamespace

import attrs
import numpy as np
import pytest
from tests.conftest import ensemble_of

import tvsysid as tv
from tvsysid.recommendation.recommendation import shape_over_level
from tvsysid.recommendation.rules import RULES, rule_of

SOUND = {"realizations": 20, "information": 200, "slow noise": 0, "switches": 0}
SOUND |= {"mean stiffness": 100, "noise bias": 1, "constant": 0, "evidence of few harmonics": -3}
BY_VARIABLE = {"scheduling variable": 1, "realizations": 1, "reflex held out": 0.2}
LPVKBI = "lpvkbi:variable={scheduling}"
BY_REFERENCE = "birf:reference={reference},tuned=true"
WEIGHTED = "kbr:weighting=residual,tuned=true"
CASES = [
    ({}, "adaptive"),
    ({"switches": 2}, "adaptive"),
    ({"switches": 2, "slow noise": 14, "evidence of few harmonics": 9}, "adaptive"),
    (BY_VARIABLE, LPVKBI),
    (BY_VARIABLE | {"reflex held out": 0.05}, f"{LPVKBI},reflex=false"),
    (BY_VARIABLE | {"reflex held out": math.nan}, LPVKBI),
    ({"wrong period": 47, "evidence of few harmonics": 9}, None),
    ({"information": 1}, None),
    ({"feedback": 30}, None),
    ({"feedback": 30, "reference": 1}, "kbr:reference={reference},weighting=residual"),
    ({"mean stiffness": -60}, None),
    ({"slow noise": 14, "noise bias": 45}, None),
    ({"slow noise": 14, "noise bias": 17, "switches": 2}, "kbr:weighting=residual"),
    ({"noise bias": 17}, "adaptive"),
    ({"loop bias": 24}, BY_REFERENCE),
    ({"loop bias": 24, "mean stiffness": -60}, BY_REFERENCE),
    (
        {"loop bias": 24, "slow noise": 14},
        "kbr:reference={reference},weighting=residual,tuned=true",
    ),
    ({"loop bias": 24, "feedback": 30}, BY_REFERENCE),
    ({"loop bias": 9, "switches": 2, "shape over level": 0.5}, BY_REFERENCE),
    ({"loop bias": 9, "switches": 2, "shape over level": 1.5}, "adaptive"),
    ({"loop bias": math.nan}, "adaptive"),
    ({"reflex": 20, "slow noise": 14}, "adaptive"),
    (
        {"reflex": 3, "slow noise": 17, "noise bias": 12},
        "adaptive",
    ),  # a reflex, too, is seen at some frequencies only
    ({"slow noise": 14}, WEIGHTED),
    ({"slow noise": 14, "evidence of few harmonics": 9}, WEIGHTED),
    ({"slow noise": 14, "realizations": 3}, "cascade"),
    ({"evidence of few harmonics": 9}, "birf:tuned=true"),
    ({"evidence of few harmonics": 9, "switches": 2}, "adaptive"),
    ({"evidence of few harmonics": 9, "switches": 2, "realizations": 4}, "birf:tuned=true"),
    ({"evidence of few harmonics": 9, "realizations": 2}, "birf:tuned=true"),
    ({"constant": 90}, "birf:tuned=true"),
    ({"realizations": 3}, "cascade"),
    ({"realizations": 4}, "adaptive"),
]


def measured_as(differs):
    return {name: (value, "") for name, value in (SOUND | differs).items()}


@pytest.mark.parametrize(("differs", "suited"), CASES)
def test_rules(differs, suited):
    assert next(iter(rule_of(measured_as(differs)).methods), None) == suited


def test_each_rule_decides_in_one_of_these_cases_at_least():
    assert {rule_of(measured_as(differs)) for differs, _ in CASES} == set(RULES)


def test_every_rule_can_be_read():
    for rule in RULES:
        for typed in rule.methods:
            tv.methods.parse(typed.format(reference="command", scheduling="emg"))
        assert all(condition.split()[-2] in "<>" for condition in rule.conditions)


@pytest.mark.slow
def test_few_realizations_and_what_leads_then():
    ensemble = ensemble_of().select([0, 1])  # of a sine
    found = tv.recommend(ensemble)
    assert found.suited == ("birf:tuned=true", "kbr")  # adaptive does not apply
    assert "at least 4 realizations" in found.against["adaptive"]
    assert tv.compare(ensemble, ["eirf", "birf", "kbr"]).leading == "kbr"
    assert "at most 3 harmonics of the period, which the evidence prefers" in repr(found)
    assert "are worth no more than " in found.against["eirf"]


def test_adaptive_by_its_own_posterior_and_units_of_all_that_is_measured():
    found = tv.recommend(ensemble_of())
    assert found.suited == ("birf:tuned=true", "adaptive", "kbr")  # a sine
    assert found.measured["evidence of few harmonics"][0] > 10
    assert found.against["adaptive"].startswith(
        "It does not know of harmonics, which the evidence prefers by "
    )
    assert abs(found.measured["noise bias"][0]) < 2
    assert found.measured["angle RMS"][1] == "rad"
    assert {"switches", "stiffness changes by", "constant", "slow noise", "information"} <= set(
        found.measured
    )


@pytest.mark.parametrize(("gain", "suited"), [(0.0, ",reflex=false"), (8.0, "")])
def test_a_reflex_beside_a_measured_variable_by_what_is_held_out(gain, suited):
    joint = tv.simulate.ScheduledJoint(
        gain_relation=np.polynomial.Polynomial([gain]) if gain else None
    )
    recording = joint.simulate(
        30, perturbation=tv.simulate.FilteredNoise(), snr_db=10, seed=1
    ).recording
    ensemble = tv.preprocess.segment(tv.preprocess.decimate(recording, 100), 2.0)
    found = tv.recommend(tv.preprocess.subtract_mean(ensemble), scheduling="emg")
    assert found.suited[0].startswith(f"lpvkbi:variable=emg{suited}")
    assert found.suited[-2:] == ("lpvkbi:variable=emg", "lpv:variable=emg")
    assert (found.measured["reflex held out"][0] > 0.1) == bool(gain)
    assert found.against["sds"] == "It takes all realizations as alike; 'emg' differs between them."


def test_how_stiffness_by_a_reference_differs_in_shape_and_on_average(closed_loop):
    found = tv.BasisIRF(reference="disturbance").tuned(closed_loop).method.identify(closed_loop)
    waves = 5 + 10 * np.sin(2 * np.pi * found.time / 2.0)  # whole periods of unit power 1/2
    other = SimpleNamespace(time=found.time, stiffness=found.stiffness - waves)
    assert shape_over_level(closed_loop, "disturbance", other) == pytest.approx(
        np.sqrt(50) / 5, rel=0.02
    )


@pytest.mark.slow
def test_a_loop_by_its_reference(closed_loop):
    named = tv.recommend(closed_loop, "disturbance")
    assert named.suited[0] == "kbr:reference=disturbance,weighting=residual,tuned=true"
    assert named.measured["loop bias"][0] == pytest.approx(25, abs=10)
    assert named.against["sds"].startswith(
        "It takes the angle as imposed, which makes its stiffness 2"
    )
    together = [each for each in named.objections if "takes the angle as imposed" in each]
    assert len(together) == 1  # of the methods that share it, once
    assert ", sds, " in together[0]
    assert ": each takes the angle" in together[0]
    unnamed = tv.recommend(closed_loop, diagnosis=tv.diagnose(closed_loop))
    assert unnamed.suited[0] == "kbr:weighting=residual"
    assert "lower by all frequencies than by those of little noise" in unnamed.why
    assert unnamed.measured["noise bias"][0] == pytest.approx(17, abs=5)
    assert math.isnan(unnamed.measured.get("loop bias", (math.nan,))[0])
    assert "Only the actuator's command" in unnamed.caveats[-2]
    assert (
        "Channel 'disturbance' moves the angle, and was not named as the reference"
        in unnamed.caveats[-1]
    )
    assert unnamed.unnamed_references == unnamed.caveats[-1:]
    # What is the method but for settings that are chosen from the data leads; another reference is
    # another method.
    methods = {
        "sds": tv.ShortDataSegments(),
        "a": tv.KernelRegression(reference="disturbance", weighting="residual"),
    }
    assert named.leading(methods) == "a"
    assert (
        named.leading({"b": tv.KernelRegression(reference="other", weighting="residual")}) is None
    )


def test_only_what_was_applied_is_taken_for_a_reference(closed_loop):
    late = np.roll(closed_loop.signal("disturbance"), 5, axis=1)  # as what answers the angle
    noise = np.random.default_rng(1).normal(size=late.shape)
    others = {
        "late": late,
        "noise": noise,
        "sensor": closed_loop.angle + 1e-4 * noise,
        "still": 0 * noise,
    }
    others["torque sensor"] = closed_loop.torque + 0.01 * noise
    ensemble = attrs.evolve(closed_loop, channels=others)
    assert {
        name: tv.quality.find_reference(ensemble, name).found for name in others
    } == dict.fromkeys(others, False)


def test_bad_input():
    with pytest.raises(tv.InputError, match="expected an Ensemble, got int"):
        tv.recommend(1)
    with pytest.raises(tv.InputError, match="command"):
        tv.recommend(ensemble_of(), "command")


@pytest.fixture(scope="module")
def closed_loop():
    joint = tv.simulate.CompliantActuator(
        tv.simulate.SineWave(), noise_bandwidth=5.0, disturbance="torque"
    )
    recording = joint.simulate(
        40, perturbation=tv.simulate.FilteredNoise(20.0), snr_db=5, seed=1
    ).recording
    ensemble = tv.preprocess.segment(tv.preprocess.decimate(recording, 100), 2.0)
    return tv.preprocess.subtract_mean(ensemble, ["disturbance"])
