import numpy as np
import pytest
from scipy.signal import firwin

import tvsysid as tv


def recording_of(angle, rate=1000.0, **settings):
    return tv.Recording(angle, -2 * angle, rate, **settings)


@pytest.mark.parametrize(("sharp", "factors"), [(False, (2, 5, 8, 10, 40)), (True, (2, 10))])
@pytest.mark.parametrize("samples", [830, 1003])
def test_equals_the_plain_convolution(random, sharp, factors, samples):
    angle = random.normal(size=samples)
    for factor in factors:
        found = tv.preprocess.decimate(recording_of(angle, 2000.0), 2000.0 / factor, sharp=sharp)
        half = 10 * factor if sharp else 15
        tail = 2 * angle[-1] - angle[-2 : -2 - half : -1]
        odd = np.concatenate([2 * angle[0] - angle[half:0:-1], angle, tail])
        taps = firwin(2 * half + 1, 1 / factor)
        expected = np.convolve(odd, taps, mode="valid")[::factor]
        np.testing.assert_allclose(found.angle, expected, atol=1e-12)
        np.testing.assert_allclose(found.torque, -2 * expected, atol=1e-12)
        assert found.sampling_rate == 2000.0 / factor


def test_trials_do_not_run_into_each_other(random):
    parts = [random.normal(size=205), random.normal(size=300) + 50]
    whole = np.concatenate(parts)
    recording = recording_of(whole, trial_starts=(0, 205), channels={"emg": whole})
    joined = tv.preprocess.decimate(recording, 100)
    alone = [tv.preprocess.decimate(recording_of(part), 100).angle for part in parts]
    np.testing.assert_array_equal(joined.angle, np.concatenate(alone))
    np.testing.assert_array_equal(joined.channels["emg"], joined.angle)
    assert joined.trial_starts == (0, 21)


@pytest.mark.parametrize("steps", [(100.0,), (500.0, 100.0)])
def test_the_recorded_angle_is_kept(random, steps):
    angle = random.normal(size=505)
    low = recording_of(angle, trial_starts=(0, 203))
    for rate in steps:
        low = tv.preprocess.decimate(low, rate)
    assert low.recorded_angle.shape == (len(low), 10)
    first, second = low.recorded_angle[:21].ravel(), low.recorded_angle[21:].ravel()
    np.testing.assert_array_equal(first[:203], angle[:203])
    np.testing.assert_array_equal(second[:302], angle[203:])
    assert {*first[203:]} == {angle[202]}
    assert {*second[302:]} == {angle[-1]}


def test_a_low_rate_is_warned_of(random):
    recording = recording_of(random.normal(size=1000))
    with pytest.warns(
        tv.DataQualityWarning,
        match=r"decimated to 10 Hz, the record holds nothing above 5 Hz.*in Hz .*not a factor",
    ):
        tv.preprocess.decimate(recording, 10)
    assert tv.preprocess.decimate(recording, 40).sampling_rate == 40  # silent
