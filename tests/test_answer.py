"""The answer: what is stated of a stiffness, why it is withdrawn, and how far methods differ."""

import math

import attrs
import numpy as np
import pytest
from tests.conftest import ensemble_of, realizations

import tvsysid as tv
from tvsysid.quality import FAULTS, Finding
from tvsysid.quality.diagnosis import Diagnosis
from tvsysid.recommendation import Recommendation
from tvsysid.recommendation.answer import judge_trust, model_spread
from tvsysid.recommendation.method import DataProperties

SUITS = Recommendation(("adaptive",), "the movement repeats")
NONE_SUITS = attrs.evolve(SUITS, suited=(), why="the torque is too weak. Perturb more")
LOOPED = attrs.evolve(SUITS, measured=DataProperties(feedback=0.4))
BIASED = attrs.evolve(SUITS, measured=DataProperties(slow_noise=12.0, noise_bias=26.0))
BY_REFERENCE = tv.BasisIRF(reference="cmd")


def of_severity(*severities):
    return [name for name, fault in FAULTS.items() if fault.severity in severities]


@pytest.fixture(scope="module")
def ensemble():
    return tv.preprocess.subtract_mean(ensemble_of(20.0))


@pytest.fixture(scope="module")
def model(ensemble):
    return tv.BasisIRF().identify(ensemble)


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
        ordered = [name for name in FAULTS if name in faults]
        checks = tuple(Finding(name, size, f"{name} was seen") for name in ordered)
        diagnosis = Diagnosis(checks, {}, None, "")
        known = attrs.evolve(known, diagnosis=diagnosis, unnamed_references=unnamed)
        stiffness = model.estimates["stiffness"]
        turned = attrs.evolve(stiffness, values=sign * stiffness.values)
        own = attrs.evolve(model, estimates={**model.estimates, "stiffness": turned})
        return judge_trust(own, method or tv.BasisIRF(), known, suited, held_out_vaf)

    return judge


@pytest.mark.parametrize("name", of_severity("invalid", "closed loop"))
def test_a_fault_that_makes_every_method_wrong_withdraws_the_stiffness(judged, name):
    level, (reason,) = judged(name, suited=False)
    assert level == "none"
    assert "--" in reason or f"{name} was seen" in reason


@pytest.mark.parametrize("name", of_severity("serious", "doubtful"))
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
        ([], {"known": BIASED, "suited": False}, "doubtful", "The movement repeats. Identify by"),
        ([], {"known": LOOPED}, "good", "Movement after the torque predicts 0.4 % of it. This is"),
    ],
)
def test_levels_and_their_reason(judged, faults, words, level, start):
    trust, (reason,) = judged(*faults, **words)
    assert trust == level
    assert reason.startswith(start)


@pytest.mark.parametrize(
    ("faults", "words"),
    [
        ([], {}),
        (["delay"], {"size": 2.3}),
        (["reflex"], {"method": tv.JointCascade()}),
        ([], {"known": LOOPED, "method": BY_REFERENCE}),
        # A reference mends a loop, in which the right impedance may predict nothing.
        (
            ["feedback", "loop-bias"],
            {"method": BY_REFERENCE, "known": NONE_SUITS, "suited": False, "held_out_vaf": 0.0},
        ),
    ],
)
def test_sound_results_are_trusted(judged, faults, words):
    assert judged(*faults, **words) == ("good", ())


def test_at_most_three_reasons_the_worst_first(judged):
    trust, reasons = judged("drift", "mains", "gaps", "clipped-angle")
    assert trust == "doubtful"
    assert [reason.partition(" was seen")[0].split(": ")[1] for reason in reasons] == [
        "clipped-angle",
        "drift",
        "gaps",
    ]


def with_stiffness(model, values):
    estimates = {"stiffness": tv.Estimate(np.full(len(model.time), values), "N m/rad")}
    return attrs.evolve(model, estimates=estimates)


def test_the_spread_weighs_methods_by_the_torque_that_they_leave_unpredicted(ensemble, model):
    methods = {name: tv.BasisIRF() for name in ("own", "near", "far", "unknown")}
    values = {"own": 100.0, "near": 102.0, "far": 120.0, "unknown": 500.0}
    models = {name: with_stiffness(model, value) for name, value in values.items()}
    vaf = {"own": 90.0, "near": 90.0, "far": 60.0, "unknown": math.nan}
    spread = model_spread(ensemble, methods, models, "own", vaf)
    np.testing.assert_allclose(spread, 1.96 * math.sqrt(1 / 5) * 20.0)
    alone = model_spread(ensemble, methods, {"own": models["own"]}, "own", vaf)
    assert np.isnan(alone).all()


@pytest.mark.slow
def test_methods_with_one_pathway_differ_by_what_they_say_without_the_reflex():
    joint = tv.simulate.ReflexJoint(stiffness=tv.simulate.Constant(100.0), reflex_gain=8.0)
    perturbed = {"perturbation": tv.simulate.FilteredNoise(), "snr_db": 20, "seed": 1}
    recording = joint.simulate(60, **perturbed).recording
    ensemble = realizations(recording)
    found = tv.compare(tv.preprocess.subtract_mean(ensemble), ["cascade", "kbr"])
    assert found.answer.label == "cascade"
    as_it_is = abs(found.models["kbr"].stiffness - found.answer.stiffness).mean()
    assert found.answer.difference < 0.3 * as_it_is
    first, *_ = str(found).splitlines()
    assert first.startswith("recommended (cascade): stiffness ")
    assert first.endswith(f"; methods differ by ± {found.answer.difference:.1f}")
