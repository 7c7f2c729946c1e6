import attrs
import numpy as np
import pytest

import tvsysid as tv
from tvsysid.numerics.differentiation import differentiate


@pytest.fixture
def angle(random):
    return random.normal(size=500)


BAD = np.where(np.isin(np.arange(500), [17, 40]), np.nan, np.sin(np.arange(500)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"angle": []}, r"angle: expected samples over time, got an array of shape \(0,\)"),
        ({"angle": ["a"] * 500}, "angle: expected real numbers, got values of type <U1"),
        ({"angle": [[1.0], [1.0, 2.0]]}, "angle: expected real numbers, got values of type object"),
        ({"angle": np.full(500, 0.1)}, "angle: all 500 values are 0.1, so"),
        ({"angle": BAD}, "angle: 2 of 500 values are NaN or infinite, the first at time 17"),
        ({"angle": np.ma.masked_greater(np.arange(500.0), 498)}, "angle: 1 of 500 values are NaN"),
        ({"torque": np.zeros(499)}, r"torque: expected the angle's shape \(500,\), got \(499,\)"),
        ({"torque": 1e31 * np.eye(1, 500)[0]}, r"a peak from .* values from 0 to 1e\+31.* damaged"),
        ({"sampling_rate": True}, "sampling_rate must be a positive number of hertz, got True"),
        ({"trial_starts": (0, 500)}, "trial_starts: expected increasing"),
        ({"start": "now"}, "start must be a finite number, got 'now'"),
        ({"channels": {"emg": np.zeros(3)}}, r"channel 'emg': expected the angle's shape \(500,\)"),
    ],
)
def test_a_recording_refuses_what_it_cannot_use(angle, change, message):
    settings = {"angle": angle, "torque": angle, "sampling_rate": 100.0} | change
    with pytest.raises(tv.InputError, match=message):
        tv.Recording(**settings)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"angle": np.zeros(500)}, "angle: expected samples over realization and time, got an"),
        ({"context": 25}, "from 0 to 24"),
        ({"onsets": [0.0, 1.0]}, "expected a value for each of the 10 realizations"),
        ({"recorded_angle": np.ones((10, 49, 2))}, "recorded_angle: expected the angle's shape"),
    ],
)
def test_an_ensemble_refuses_what_it_cannot_use(angle, change, message):
    matrix = angle.reshape(10, 50)
    settings = {"angle": matrix, "torque": matrix, "sampling_rate": 100.0} | change
    with pytest.raises(tv.InputError, match=message):
        tv.Ensemble(**settings)


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.int32])
def test_signals_are_kept_as_they_are_and_cannot_be_changed(kind):
    values, onsets = np.arange(20).reshape(2, 10).astype(kind), np.arange(2.0)
    given = values.copy()
    ensemble = tv.Ensemble(values, values, 100.0, onsets=onsets, channels={"emg": values})
    values[0, 0], onsets[0] = 7, 7  # the caller's own arrays stay the caller's
    for kept in (ensemble.angle, ensemble.torque, ensemble.channels["emg"]):
        assert kept.dtype == np.float64
        np.testing.assert_array_equal(kept, given)
        with pytest.raises(ValueError, match="read-only"):
            kept[0, 0] = 1
    assert ensemble.onsets[0] == 0
    with pytest.raises(attrs.exceptions.FrozenInstanceError):
        ensemble.sampling_rate = 5.0


def test_time_begins_anew_with_each_trial(angle):
    recording = tv.Recording(angle, angle, 100.0, start=-0.5, trial_starts=(0, 300))
    assert recording.trials == (slice(0, 300), slice(300, 500))
    assert recording.duration == 5.0
    np.testing.assert_allclose(recording.time[[0, 299, 300]], [-0.5, 2.49, -0.5])
    assert "in 2 trials at 100 Hz" in repr(recording)


def test_runs_join_realizations_that_follow_each_other(angle):
    matrix = angle.reshape(10, 50)

    def runs(**where):
        return [list(run) for run in tv.Ensemble(matrix, matrix, 100.0, **where).runs]

    assert runs() == [[i] for i in range(10)]
    assert runs(onsets=np.arange(10) * 0.5) == [list(range(10))]
    assert runs(onsets=np.arange(10) * 0.5, trials=[0] * 4 + [1] * 6) == [
        [0, 1, 2, 3],
        [4, 5, 6, 7, 8, 9],
    ]
    shuffled = np.array([3, 0, 1, 2, 4, 5, 6, 7, 8, 9]) * 0.5
    assert runs(onsets=shuffled) == [[1, 2, 3, 0, 4, 5, 6, 7, 8, 9]]


def test_select_takes_everything_along(random):
    angle, torque, emg = random.normal(size=(3, 10, 60))
    more = {"onsets": np.arange(10.0), "channels": {"emg": emg}, "recorded_angle": emg[..., None]}
    chosen = tv.Ensemble(angle, torque, 100.0, 5, **more).select([4, 4, 1])
    np.testing.assert_array_equal(chosen.onsets, [4, 4, 1])
    for values in (chosen.signal("emg"), chosen.recorded_angle[..., 0]):
        np.testing.assert_array_equal(values, emg[[4, 4, 1]])
    assert len(chosen.select(np.arange(3) > 1)) == 1
    with pytest.raises(tv.InputError, match="select: these realizations do not exist"):
        chosen.select([10])
    with pytest.raises(tv.InputError, match="no 'EMG'; the signals are 'angle', 'torque', 'emg'"):
        chosen.signal("EMG")


@pytest.mark.parametrize("context", [0, 5, 12, 20])
def test_derivatives_reach_12_samples_into_the_context(random, context):
    angle = random.normal(size=(4, 100 + 2 * context))
    ensemble = tv.Ensemble(angle, angle, 100.0, context=context)
    assert (ensemble.samples, ensemble.core) == (100, slice(context, context + 100))
    expected = np.full((3, *angle.shape), np.nan)
    expected[..., 12:-12] = differentiate(angle, 100.0)
    np.testing.assert_array_equal(ensemble.derivatives()[1:], expected[1:, :, ensemble.core])
