"""Trust in a stiffness: reasons to withdraw it, and to doubt it."""

import math
from types import SimpleNamespace

import attrs
import numpy as np
import pytest
from tests.conftest import ensemble_of

import tvsysid as tv
from tvsysid.quality import FAULTS, Finding
from tvsysid.recommendation import Recommendation, trust_in
from tvsysid.recommendation.trust import DOUBTFUL, LOOP, WRONG

SUITS = Recommendation(("adaptive",), "the behaviour repeats", {})
NONE_SUITS = attrs.evolve(SUITS, suited=(), why="the torque is too weak. Perturb more")
SLOW = attrs.evolve(SUITS, measured={"slow noise": (12.0, "dB")})
BIASED = attrs.evolve(SLOW, measured={**SLOW.measured, "noise bias": (26.0, "%")})
BY_REFERENCE = tv.BasisIRF(reference="cmd")


@pytest.fixture(scope="module")
def model():
    return tv.BasisIRF().identify(tv.preprocess.subtract_mean(ensemble_of(20.0)))


@pytest.fixture
def judged(model):
    def judge(
        *faults,
        size=-math.inf,
        method=None,
        known=SUITS,
        suited=True,
        held_out_vaf=80.0,
        unnamed=(),
        sign=1,
    ):
        findings = [Finding(name, size, f"{name} was seen") for name in faults]
        diagnosis = SimpleNamespace(findings=findings, remarks=()) if faults else None
        known = attrs.evolve(known, diagnosis=diagnosis, unnamed_references=unnamed)
        stiffness = model.estimates["stiffness"]
        turned = attrs.evolve(stiffness, values=sign * stiffness.values)
        own = attrs.evolve(model, estimates={**model.estimates, "stiffness": turned})
        held_out = np.full(3, held_out_vaf)
        return trust_in(own, method or tv.BasisIRF(), known, suited, held_out)

    return judge


@pytest.mark.parametrize("name", [*WRONG, *LOOP])
def test_a_fault_that_makes_every_method_wrong_withdraws_the_stiffness(judged, name):
    level, (reason,) = judged(name, suited=False)
    assert level == "none"
    assert "--" in reason or f"{name} was seen" in reason


@pytest.mark.parametrize("name", DOUBTFUL)
def test_a_fault_that_may_make_it_wrong_makes_it_doubtful(judged, name):
    level, (reason,) = judged(name)
    assert level == "doubtful"
    assert reason.startswith(f"{FAULTS[name].title}: {name} was seen. ")


@pytest.mark.parametrize(
    ("faults", "words", "level", "start"),
    [
        (["torque-unit", "feedback"], {}, "none", "Stiffer or softer than any joint: torque-unit "),
        ([], {"sign": -1}, "none", "The torque has the opposite sign: "),
        # A reference that was not named is the remedy for a loop. With a wrong period, any channel
        # seems to move the joint.
        (["feedback"], {"suited": False, "unnamed": ("'cmd' moves.",)}, "none", "'cmd' moves."),
        (["wrong-period"], {"unnamed": ("'cmd' moves.",)}, "none", "The movement does not repeat"),
        ([], {"known": NONE_SUITS}, "none", "The torque is too weak. Perturb more."),
        ([], {"held_out_vaf": 0.0}, "none", "The model predicts none of the torque of held-out"),
        # A method that the rules prefer to one with the reference
        (["loop-bias"], {}, "doubtful", "Closed loop: the reference changes the stiffness"),
        (["delay"], {"size": -7.0}, "doubtful", "Angle and torque are not recorded"),
        (["reflex"], {}, "doubtful", "Part of this stiffness is a stretch reflex: reflex was seen"),
        ([], {"known": BIASED, "suited": False}, "doubtful", "The behaviour repeats. Identify by"),
        ([], {"known": SLOW}, "good", "The torque's noise is slow or strong. If the actuator is"),
    ],
)
def test_levels_and_their_reason(judged, faults, words, level, start):
    trust = judged(*faults, **words)
    (reason,) = trust.reasons
    assert trust.level == level
    assert reason.startswith(start)


@pytest.mark.parametrize(
    ("faults", "words"),
    [
        ([], {}),
        (["delay"], {"size": 2.3}),
        (["reflex"], {"method": tv.JointCascade()}),
        ([], {"known": SLOW, "method": BY_REFERENCE}),
        # A reference mends a loop, in which the right impedance may predict nothing.
        (
            ["feedback", "loop-bias"],
            {"method": BY_REFERENCE, "known": NONE_SUITS, "suited": False, "held_out_vaf": 0.0},
        ),
    ],
)
def test_sound_results_are_trusted(judged, faults, words):
    assert judged(*faults, **words) == ("good", ())
