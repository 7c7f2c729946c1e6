"""Whether a reflex shows; how often it does by chance is counted by benchmarks/reflex_test.py."""

import attrs
import numpy as np
import pytest
from scipy.special import stdtr

import tvsysid as tv
from tvsysid.methods.cascade import reflex_test as reflex_testing
from tvsysid.methods.cascade.reflex_test import reflex_test, reflex_test_of

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
@pytest.mark.parametrize(
    ("profile", "changing"), [(tv.simulate.SineWave(), True), (tv.simulate.Constant(100.0), False)]
)
def test_a_joint_that_changes_is_told_from_one_that_does_not(gain, profile, changing):
    recording = recorded(gain, perturbation="prbs", profile=profile)
    ensemble = tv.preprocess.segment(tv.preprocess.decimate(recording, 100), 2.0)
    assert reflex_testing.changes(ensemble) == changing


def test_its_probabilities_are_those_of_plain_least_squares(monkeypatch, random):
    """12 realizations, each third predicted from the others."""
    monkeypatch.setattr(reflex_testing, "BLOCKS", 3)
    monkeypatch.setattr(reflex_testing, "HARMONICS", 1)
    signals = random.normal(size=(4, 12, 120))
    angle, torque, *drives = signals - signals.mean(axis=1, keepdims=True)
    found = reflex_test(angle, torque, np.stack(drives), slice(10, 110), 100.0)
    times, lags = np.arange(33, 110), np.arange(4, 34)
    turns, late = 2 * np.pi * (times - 10) / 100, np.linspace(4, 33, 8)
    usual = np.exp(-0.8 * 16 * (late - 4) / 100) * np.sin(0.6 * 16 * (late - 4) / 100)
    response = np.interp(lags, late, usual)
    answers = [np.einsum("l,rtl->rt", response, each[:, times[:, None] - lags]) for each in drives]
    joint = [angle[:, times - lag] for lag in range(-4, 5)]
    joint += [
        each[:, times] * wave(turns) for each in (angle, sum(drives)) for wave in (np.cos, np.sin)
    ]

    def predicted(*further):
        columns, out = np.stack([*joint, *further], axis=2), np.empty((12, len(times)))
        for block in np.split(np.arange(12), 3):
            others = np.setdiff1d(np.arange(12), block)
            design = columns[others].reshape(-1, columns.shape[2])
            target = torque[others][:, times].ravel()
            out[block] = columns[block] @ np.linalg.lstsq(design, target, rcond=None)[0]
        return out

    none, linear, both = predicted(), predicted(sum(answers)), predicted(*answers)
    directed = [predicted(each) for each in answers]
    errors = [np.sum((torque[:, times] - each) ** 2, axis=1) for each in directed]
    assert found.direction == np.sign(np.sum(np.log(errors[1] / errors[0])))

    def added(simple, further):
        left = torque[:, times] - simple
        scores = np.sum(left * (further - simple), axis=1) / np.sum(left**2, axis=1)
        return scores.mean(), scores.std(ddof=1) / np.sqrt(12)

    over_none, error = added(none, directed[found.direction < 0])
    over_linear, other_error = added(linear, both)
    assert found.over_none == pytest.approx(min(1, 2 * stdtr(11, -over_none / error)), rel=1e-5)
    assert found.over_linear == pytest.approx(stdtr(11, -over_linear / other_error), rel=1e-5)
    least = min(over_none - 1.79588 * error, over_linear - 1.79588 * other_error)
    assert found.share == pytest.approx(least, rel=1e-4)


def test_what_is_too_short_or_does_not_move_is_not_taken_for_a_reflex(random):
    angle, torque, positive, negative = random.normal(size=(4, 12, 50))
    with pytest.raises(
        tv.InputError, match=r"0.33 s before are known at 13 samples .*takes 20; give longer"
    ):
        reflex_test(angle, torque, np.stack([positive, negative]), slice(0, 50), 100.0)
    still = np.zeros((12, 120))
    for motion in (angle[:, :1] + still, still):
        assert not reflex_test(motion, motion, np.stack([still, still]), slice(0, 120), 100.0).shown
    few = random.normal(size=(4, 5, 120))
    assert reflex_test(few[0], few[1], few[2:], slice(0, 120), 100.0).over_none == 1.0


def test_a_reflex_is_found_under_slow_voluntary_torque():
    recording = recorded(8.0, 60.0, seed=3)
    slow = np.sin(2 * np.pi * 0.21 * np.arange(len(recording.torque)) / 1000)
    torque = recording.torque + 3 * recording.torque.std() * slow
    test = judged(attrs.evolve(recording, torque=torque))
    assert (test.shown, test.direction) == (True, 1)
