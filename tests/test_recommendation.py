"""Which method suits an ensemble: the table of rules, and what is measured for it."""

import dataclasses
import math

import numpy as np
import pytest
from tests.conftest import ensemble_of

import tvsysid as tv
from tvsysid.recommendation import RULES, rule_of

SOUND = {"realizations": 20, "scheduling variable": 0, "information": 200, "slow noise": 0, "switches": 0}


@pytest.mark.parametrize(
    ("differs", "suited"),
    [
        ({}, "adaptive"),
        ({"switches": 2}, "adaptive"),
        ({"realizations": 3}, "cascade"),
        ({"scheduling variable": 1, "realizations": 1}, "lpvkbi:variable={scheduling}"),
        ({"information": 1}, None),
        ({"feedback": 30}, None),
        ({"loop bias": 24}, "birf:reference={reference},tuned=true"),
        ({"loop bias": 24, "slow noise": 14}, "kbr:reference={reference},weighting=residual,tuned=true"),
        ({"loop bias": 24, "feedback": 30}, "birf:reference={reference},tuned=true"),
        ({"loop bias": math.nan}, "adaptive"),
        ({"reflex": 20, "slow noise": 14}, "adaptive"),
        ({"slow noise": 14}, "kbr:weighting=residual,tuned=true"),
        ({"slow noise": 14, "switches": 1}, "adaptive"),
        ({"harmonics": 2}, "birf:tuned=true"),
        ({"harmonics": 2, "slow noise": 14}, "kbr:weighting=residual,tuned=true"),
        ({"harmonics": 2, "switches": 1}, "adaptive"),
        ({"harmonics": 6}, "adaptive"),
    ],
)
def test_rules(differs, suited):
    rule = rule_of({name: (value, "") for name, value in (SOUND | differs).items()})
    assert next(iter(rule.methods), None) == suited


def test_every_rule_can_be_read():
    for rule in RULES:
        for typed in rule.methods:
            tv.methods.parse(typed.format(reference="command", scheduling="emg"))
        assert all(condition.split()[-2] in "<>" for condition in rule.conditions)


def test_few_realizations_and_what_leads_then():
    ensemble = ensemble_of().select([0, 1])
    found = tv.recommend(ensemble)
    assert found.suited == ("cascade", "kbr:tuned=true", "kbr")  # adaptive does not apply
    assert isinstance(found.method, tv.JointCascade)
    assert "at least 4 realizations" in found.against["adaptive"]
    assert tv.compare(ensemble, ["eirf", "birf", "kbr"]).leading == "kbr"
    assert "cascade: realizations are too few" in repr(found)
    assert "<b>Recommendation</b>: cascade" in found._repr_html_()


def test_adaptive_by_its_own_posterior_and_units_of_all_that_is_measured():
    found = tv.recommend(ensemble_of())
    assert found.suited == ("birf:tuned=true", "adaptive")  # a sine
    assert found.measured["harmonics"] == (1.0, "of the period")
    assert found.measured["angle RMS"][1] == "rad"
    assert {"switches", "stiffness changes by", "slow noise", "information"} <= set(found.measured)
    assert "<td style='text-align:left'>angle RMS</td>" in found._repr_html_()


def test_a_loop_by_its_reference(closed_loop):
    named = tv.recommend(closed_loop, "disturbance")
    assert named.suited[0] == "kbr:reference=disturbance,weighting=residual,tuned=true"
    assert named.measured["loop bias"][0] == pytest.approx(25, abs=10)
    assert named.against["sds"] == "It takes the angle as imposed."
    unnamed = tv.recommend(closed_loop)
    assert math.isnan(unnamed.measured.get("loop bias", (math.nan,))[0])
    assert "by the actuator's command alone" in unnamed.caveats[-2]
    assert "'disturbance' moves before the angle: if it is the perturbation, name it" in unnamed.caveats[-1]
    # What is the method but for settings that are chosen from the data leads; another reference is another method.
    methods = {"sds": tv.ShortDataSegments(), "a": tv.KernelRegression(reference="disturbance", weighting="residual")}
    assert named.leading(methods) == "a"
    assert named.leading({"b": tv.KernelRegression(reference="other", weighting="residual")}) is None


def test_only_what_was_applied_is_taken_for_a_reference(closed_loop):
    late = np.roll(closed_loop.signal("disturbance"), 5, axis=1)  # as what answers the angle
    noise = np.random.default_rng(1).normal(size=late.shape)
    others = {"late": late, "noise": noise, "sensor": closed_loop.angle + 1e-4 * noise, "still": 0 * noise}
    others["torque sensor"] = closed_loop.torque + 0.01 * noise
    ensemble = dataclasses.replace(closed_loop, channels=others)
    assert {name: tv.quality.find_reference(ensemble, name).found for name in others} == dict.fromkeys(others, False)


def test_bad_input():
    with pytest.raises(tv.InputError, match="expected an Ensemble, got int"):
        tv.recommend(1)
    with pytest.raises(tv.InputError, match="command"):
        tv.recommend(ensemble_of(), "command")


@pytest.fixture(scope="module")
def closed_loop():
    joint = tv.simulate.CompliantActuator(tv.simulate.SineWave(), noise_bandwidth=5.0, disturbance="torque")
    recording = joint.simulate(40, perturbation=tv.simulate.FilteredNoise(20.0), snr_db=5, seed=1).recording
    ensemble = tv.preprocess.segment(tv.preprocess.decimate(recording, 100), 2.0)
    return tv.preprocess.subtract_mean(ensemble, ["disturbance"])
