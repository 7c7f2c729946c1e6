import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import tvsysid as tv


def recording_of(samples, **settings):
    values = np.arange(samples, dtype=float)
    return tv.Recording(values, values, 100.0, **settings)


def test_context_comes_from_the_record():
    ensemble = tv.preprocess.segment(recording_of(1000), period=2.0)
    assert (len(ensemble), ensemble.context, ensemble.left_out) == (3, 50, 2)
    np.testing.assert_array_equal(ensemble.onsets, [2.0, 4.0, 6.0])
    expected = 100 * ensemble.onsets[:, None] + np.arange(-50, 250)
    np.testing.assert_array_equal(ensemble.angle, expected)
    assert "2 left out: too near the ends" in repr(ensemble)


@pytest.mark.parametrize("start", [-1.0, -0.3, 0.7, 12.5])
def test_realizations_begin_at_multiples_of_the_period_from_time_zero(start):
    recording = recording_of(1000, start=start)
    ensemble = tv.preprocess.segment(recording, period=2.0, context=0.2)
    np.testing.assert_allclose(ensemble.onsets / 2.0, np.round(ensemble.onsets / 2.0), atol=1e-9)
    for row, onset in enumerate(ensemble.onsets):
        first = ensemble.angle[row, ensemble.core][0]
        assert recording.time[int(first)] == pytest.approx(onset)


def test_trials_are_cut_each_for_itself():
    ensemble = tv.preprocess.segment(
        recording_of(1000, trial_starts=(0, 450)), period=1.0, context=0.1
    )
    np.testing.assert_array_equal(ensemble.trials, [0] * 3 + [1] * 4)
    np.testing.assert_array_equal(ensemble.onsets, [1, 2, 3, 1, 2, 3, 4])
    assert ensemble.angle[3, ensemble.core][0] == 550
    assert ensemble.left_out == 2
    assert [len(run) for run in ensemble.runs] == [3, 4]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"period": 20.0}, "no realization of 20 s with 0.5 s of .* fits into a trial of 10 s"),
        ({"period": 1.005}, "1.005 s is not a whole number of samples at 100 Hz"),
        ({"period": None, "context": 6.0}, "no realization with 6 s of context"),
        ({"period": "long"}, "period must be a positive number, got 'long'"),
        ({"period": 2.0, "context": -1.0}, "context must be a number of zero or more"),
    ],
)
def test_what_cannot_be_cut_is_refused(settings, message):
    with pytest.raises(tv.InputError, match=message):
        tv.preprocess.segment(recording_of(1000), **settings)


@given(st.integers(2, 12), st.integers(1, 30), st.floats(-100, 100))
def test_subtracting_the_mean_leaves_none(realizations, samples, offset):
    values = np.random.default_rng(samples).normal(size=(realizations, samples)) + offset
    ensemble = tv.Ensemble(values, 3 * values, 100.0, channels={"emg": values})
    centred = tv.preprocess.subtract_mean(ensemble)
    np.testing.assert_allclose(centred.angle.mean(axis=0), 0, atol=1e-10)
    np.testing.assert_allclose(centred.torque.mean(axis=0), 0, atol=1e-10)
    np.testing.assert_array_equal(centred.channels["emg"], values)


@pytest.mark.parametrize(
    ("realizations", "message"),
    [(1, "at least two realizations, got Ensemble"), (7, "the angle is the same in all 7")],
)
def test_one_realization_and_those_that_are_all_alike_are_refused(random, realizations, message):
    torque = random.normal(size=(realizations, 20))
    ensemble = tv.Ensemble(np.tile(torque[0], (realizations, 1)), torque, 100.0)
    with pytest.raises(tv.InputError, match=message):
        tv.preprocess.subtract_mean(ensemble)


@pytest.mark.parametrize(
    ("actuator", "noise", "channels"),
    [(1e5, 40, ()), (1e3, 40, ()), (100, 5, ()), (30, 5, ()), (100, 40, ("disturbance",))],
)
def test_a_multisine_that_repeats_with_the_behaviour_is_refused(actuator, noise, channels):
    # The noise of the torque moves a stiff actuator by 0.1 %, a soft one by more.
    loop = tv.simulate.CompliantActuator(actuator_stiffness=actuator, noise_bandwidth=noise)
    lines = {
        "beside": (1.2, 5.2, 9.2, 13.2, 17.2),
        "on": (2.0, 7.0, 12.0, 17.0),
        "some on": (2.3, 7.0, 12.3, 17.3),
    }
    cut = {}
    for name, frequencies in lines.items():
        recording = loop.simulate(
            20, perturbation=tv.simulate.Multisine(frequencies), snr_db=10, seed=1
        ).recording
        cut[name] = tv.preprocess.segment(tv.preprocess.decimate(recording, 100), 2.0)
    assert tv.preprocess.subtract_mean(cut["beside"], channels).mean_subtracted
    assert tv.preprocess.subtract_mean(cut["some on"], channels).mean_subtracted
    with pytest.raises(
        tv.InputError,
        match=r"is the same in all 10 .*a multisine needs lines that are no multiples",
    ):
        tv.preprocess.subtract_mean(cut["on"], channels)


def test_a_small_perturbation_beside_a_large_movement_is_legal():
    time = np.arange(2000) / 100
    angle = 0.5 * np.sin(np.pi * time) + 9e-4 * tv.simulate.PRBS().generate(
        2000, 100.0, np.random.default_rng(1)
    )
    ensemble = tv.preprocess.segment(tv.Recording(angle, angle, 100.0), 2.0, context=0)
    assert np.std(tv.preprocess.subtract_mean(ensemble).angle) < 1e-3


def two_trials():
    values = np.arange(1500.0)
    return tv.Recording(
        values, -values, 100.0, start=3.0, channels={"target": 2 * values}, trial_starts=(0, 700)
    )


def test_trimmed_ends_can_serve_as_context():
    trimmed = tv.preprocess.trim(two_trials(), ends=1.0, margin=0.5)
    expected = np.concatenate([np.arange(50, 650), np.arange(750, 1450)])
    np.testing.assert_array_equal(trimmed.angle, expected)
    np.testing.assert_array_equal(trimmed.channels["target"], 2 * expected)
    np.testing.assert_allclose(trimmed.time[[0, 50, 600]], [-0.5, 0.0, -0.5])
    cut = tv.preprocess.segment(trimmed, period=1.0, context=0.5)
    assert (len(cut), cut.left_out) == (5 + 6, 0)
    firsts = [*range(100, 600, 100), *range(800, 1400, 100)]
    np.testing.assert_array_equal(cut.angle[:, cut.context], firsts)
