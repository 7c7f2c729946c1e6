"""Trust in a stiffness: reasons to withdraw it, and to doubt it."""

import math
from types import SimpleNamespace

import attrs
import pytest
from tests.conftest import ensemble_of

import tvsysid as tv
from tvsysid.quality import FAULTS, Finding
from tvsysid.recommendation import Recommendation, trust_in
from tvsysid.recommendation.trust import DOUBTFUL, LOOP, WRONG

SUITS = Recommendation(("adaptive",), "the behaviour repeats", {}, {})
NONE_SUITS = attrs.evolve(SUITS, suited=(), why="the torque is too weak: perturb more")
BY_REFERENCE = tv.BasisIRF(reference="cmd")


@pytest.fixture(scope="module")
def model():
    return tv.BasisIRF().identify(tv.preprocess.subtract_mean(ensemble_of(20.0)))


@pytest.fixture(scope="module")
def negative(model):
    stiffness = model.estimates["stiffness"]
    turned = attrs.evolve(stiffness, values=-stiffness.values)
    return attrs.evolve(model, estimates={**model.estimates, "stiffness": turned})


def found(*names, value=-math.inf):
    """Diagnosis with these findings."""
    findings = [Finding(name, value, True, f"{name} was seen") for name in names]
    return SimpleNamespace(findings=findings, remarks=())


def judged(
    model, diagnosis=None, method=None, known=SUITS, suited=True, held_out_vaf=80.0, unnamed=()
):
    known = attrs.evolve(known, diagnosis=diagnosis, unnamed_references=unnamed)
    return trust_in(model, method or tv.BasisIRF(), known, suited, held_out_vaf)


def test_sound_data_are_trusted(model):
    for diagnosis in (None, found("few-realizations", "coarse-angle")):
        assert judged(model, diagnosis) == ("good", ())


@pytest.mark.parametrize("name", [*WRONG, *LOOP])
def test_a_fault_that_makes_every_method_wrong_withdraws_the_stiffness(model, name):
    level, (reason,) = judged(model, found(name), suited=False)
    assert level == "none"
    assert "--" in reason or f"{name} was seen" in reason
    assert reason.count(". ") <= 2


def test_swapped_channels_are_said_in_one_reason(model):
    faults = found("angle-unit", "torque-unit", "reversed-torque", "feedback")
    level, (reason,) = judged(model, faults)
    assert level == "none"
    assert reason.startswith("Angle and torque are probably swapped: ")


def test_a_negative_stiffness_is_withdrawn_without_a_diagnosis(negative):
    level, (reason,) = judged(negative)
    assert level == "none"
    assert "--torque-sign -1" in reason
    assert judged(negative, found("reversed-torque")) == (level, (reason,))


def test_an_unnamed_reference_takes_the_place_of_the_loop(model):
    unnamed = ("'cmd' moves.",)
    assert judged(model, found("feedback"), suited=False, unnamed=unnamed) == ("none", unnamed)
    # With a wrong period, any channel seems to move the joint.
    (reason,) = judged(model, found("wrong-period"), unnamed=unnamed).reasons
    assert "does not repeat" in reason


def test_a_reference_mends_a_loop_and_nothing_else(model):
    loop = found("feedback", "loop-bias")
    assert judged(model, loop, BY_REFERENCE, NONE_SUITS, False, 0.0) == ("good", ())
    assert judged(model, found("angle-unit"), BY_REFERENCE).level == "none"


def test_a_bias_that_the_rules_prefer_to_a_reference_is_a_doubt(model):
    doubt = "The torque moves the angle (a closed loop): loop-bias was seen."
    assert judged(model, found("loop-bias")) == ("doubtful", (doubt,))


def test_no_method_and_no_prediction_withdraw_the_stiffness(model):
    reasons = ("The torque is too weak: perturb more.",)
    assert judged(model, known=NONE_SUITS) == ("none", reasons)
    assert judged(model, held_out_vaf=0.0).level == "none"
    assert judged(model, held_out_vaf=math.nan).level == "good"


@pytest.mark.parametrize("name", DOUBTFUL)
def test_a_fault_that_may_make_it_wrong_makes_it_doubtful(model, name):
    level, (reason,) = judged(model, found(name))
    assert level == "doubtful"
    assert reason.startswith(f"{FAULTS[name].title}: {name} was seen. ")


def test_a_short_delay_is_no_doubt(model):
    assert judged(model, found("delay", value=2.3)).level == "good"
    assert judged(model, found("delay", value=-7.0)).level == "doubtful"


def test_a_reflex_is_a_doubt_of_one_pathway_alone(model):
    level, (reason,) = judged(model, found("reflex"))
    assert level == "doubtful"
    assert reason.startswith("Part of this stiffness is a stretch reflex: reflex was seen. ")
    assert judged(model, found("reflex"), tv.JointCascade()).level == "good"


def test_a_bias_that_another_method_lacks_is_a_doubt(model):
    measured = {"slow noise": (12.0, "dB"), "noise bias": (26.0, "%")}
    other = Recommendation(("kbr:weighting=residual",), "stiffness is 26 % lower", measured, {})
    doubt = "Stiffness is 26 % lower. Identify by --method kbr:weighting=residual."
    assert judged(model, known=other, suited=False) == ("doubtful", (doubt,))
    assert judged(model, known=other).level == "good"


def test_noise_that_may_move_the_angle_asks_for_caution_without_a_reference(model):
    slow = attrs.evolve(SUITS, measured={"slow noise": (12.0, "dB")})
    level, (reason,) = judged(model, known=slow)
    assert level == "good"
    assert reason.startswith("The torque's noise is slow or strong. If the actuator is compliant")
    assert judged(model, method=BY_REFERENCE, known=slow) == ("good", ())
