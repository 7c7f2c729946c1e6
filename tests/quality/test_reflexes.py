"""Whether a reflex shows; how often it does by chance is counted by benchmarks/reflex_test.py."""

import attrs
import numpy as np
import pytest

import tvsysid as tv
from tvsysid.methods.cascade.reflex_test import changes, reflex_test_of

REFLEX = tv.simulate.StretchReflex


def judged(recording, period=2.0, context=0.5):
    """Test of a recording at 1 kHz, decimated and cut."""
    ensemble = tv.preprocess.segment(tv.preprocess.decimate(recording, 100), period, context)
    return reflex_test_of(tv.preprocess.subtract_mean(ensemble))


def recorded(gain, duration=40.0, perturbation="noise", direction=1, seed=1, profile=None):
    system = tv.simulate.ReflexJoint(
        profile or tv.simulate.SineWave(), reflex_gain=gain, reflex=REFLEX(direction=direction)
    )
    kind = tv.simulate.PERTURBATIONS[perturbation]
    return system.simulate(duration, perturbation=kind, snr_db=10, seed=seed).recording


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
    test = judged(recorded(gain, duration, perturbation, direction))
    assert test.shown == (gain > 0)
    if gain:
        assert test.direction == direction
        assert test.stiffness[0] > 100 + 2 * gain
        assert test.stiffness[1] == pytest.approx(100, abs=3 if duration == 150 else 8)


def test_a_linear_late_answer_is_no_reflex():
    stretched = recorded(8.0)
    released = REFLEX(direction=-1).torque(np.gradient(stretched.angle, 1e-3), 8.0, 1000.0)
    test = judged(attrs.evolve(stretched, torque=stretched.torque + released))
    assert test.over_none < 1e-6
    assert not test.shown


@pytest.mark.parametrize(
    ("record", "low", "high"),  # intrinsic stiffness of other separations: 50-73, 72-81, 49-54
    [("plantarflexor", 55, 75), ("dorsiflexor", 72, 83), ("dorsiflexor_2", 47, 55)],
)
@pytest.mark.parametrize("context", [0.0, 0.5])
def test_real_ankles_in_contraction_have_a_reflex(recordings, record, low, high, context):
    test = judged(*recordings[record], context)
    assert (test.shown, test.direction) == (True, 1)
    assert low < test.stiffness[1] < high < test.stiffness[0]


@pytest.mark.parametrize("gain", [0.0, 4.0])
@pytest.mark.parametrize("profile", [tv.simulate.SineWave(), tv.simulate.Constant(100.0)])
def test_a_joint_that_changes_is_told_from_one_that_does_not(gain, profile):
    recording = recorded(gain, perturbation="prbs", profile=profile)
    ensemble = tv.preprocess.segment(tv.preprocess.decimate(recording, 100), 2.0)
    assert changes(ensemble) == isinstance(profile, tv.simulate.SineWave)


def test_a_reflex_is_found_under_slow_voluntary_torque():
    recording = recorded(8.0, 60.0, seed=3)
    slow = np.sin(2 * np.pi * 0.21 * np.arange(len(recording.torque)) / 1000)
    torque = recording.torque + 3 * recording.torque.std() * slow
    test = judged(attrs.evolve(recording, torque=torque))
    assert (test.shown, test.direction) == (True, 1)
