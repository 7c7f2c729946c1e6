"""Whether a reflex shows; how often it does by chance is counted by benchmarks/reflex_test.py."""

import attrs
import numpy as np
import pytest
from tests.conftest import realizations
from tests.reflexive import reflexive

import tvsysid as tv
from tvsysid.methods.cascade.reflex_test import is_time_varying, reflex_test_of
from tvsysid.methods.cascade.search import one_path_stiffness


def judged(ensemble):
    ensemble = tv.preprocess.subtract_mean(ensemble)
    two_paths = np.nanmean(tv.JointCascade(8).fit(ensemble).stiffness)
    return reflex_test_of(ensemble), (one_path_stiffness(ensemble), two_paths)


@pytest.mark.parametrize(
    ("gain", "duration", "perturbation", "direction"),
    [
        (1.0, 150.0, "noise", 1),
        (2.0, 40.0, "noise", -1),
        (8.0, 150.0, "noise", 1),
        (8.0, 150.0, "prbs", 1),
        (0.0, 40.0, "noise", 1),
        (0.0, 40.0, "prbs", 1),
    ],
)
def test_a_reflex_is_shown_with_its_direction_and_stiffness(
    gain, duration, perturbation, direction
):
    settings = {"gain": gain, "perturbation": perturbation, "direction": direction}
    test, stiffness = judged(reflexive(duration, seed=1, **settings)[0])
    assert test.shown == (gain > 0)
    if gain:
        assert test.direction == direction
        assert stiffness[0] > 100 + 2 * gain
        assert stiffness[1] == pytest.approx(100, abs=3 if duration == 150 else 8)


def test_a_linear_late_answer_is_no_reflex():
    stretched, released = (
        reflexive(40.0, gain=8.0, seed=1, direction=direction)[0] for direction in (1, -1)
    )
    torque = stretched.torque + released.channels["reflex"]
    test, _ = judged(attrs.evolve(stretched, torque=torque))
    assert test.over_none < 1e-6
    assert not test.shown


@pytest.mark.parametrize(
    ("record", "low", "high"),  # intrinsic stiffness of other separations
    [("plantarflexor", 50, 73), ("dorsiflexor", 72, 81), ("dorsiflexor_2", 49, 54)],
)
@pytest.mark.parametrize("context", [0.0, 0.5])
def test_real_ankles_in_contraction_have_a_reflex(recordings, record, low, high, context):
    recording, period = recordings[record]
    test, stiffness = judged(realizations(recording, period, context))
    assert (test.shown, test.direction) == (True, 1)
    assert low < stiffness[1] < high < stiffness[0]


@pytest.mark.parametrize("gain", [0.0, 4.0])
@pytest.mark.parametrize("stiffness", ["sine", "constant"])
def test_a_joint_that_changes_is_told_from_one_that_does_not(gain, stiffness):
    ensemble = reflexive(40.0, stiffness=stiffness, gain=gain, perturbation="prbs", seed=1)[0]
    assert is_time_varying(ensemble) == (stiffness == "sine")


def test_a_reflex_is_found_under_slow_voluntary_torque():
    ensemble = reflexive(60.0, gain=8.0, seed=3)[0]
    time = np.arange(ensemble.torque.size).reshape(ensemble.torque.shape) / 100
    slow = 3 * ensemble.torque.std() * np.sin(2 * np.pi * 0.21 * time)
    test, _ = judged(attrs.evolve(ensemble, torque=ensemble.torque + slow))
    assert (test.shown, test.direction) == (True, 1)
