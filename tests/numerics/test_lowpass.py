import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tvsysid.numerics.differentiation import HALF_WIDTH
from tvsysid.numerics.lowpass import low_pass

RATE = 100.0


def through_the_lag(lag, frequency, phase, time):
    response = 1 / (1 + 2j * np.pi * frequency * lag)
    return np.abs(response) * np.cos(2 * np.pi * frequency * time + phase + np.angle(response))


@given(st.floats(1e-5, 0.1), st.floats(0.0, 38.0), st.floats(0.0, 6.3))
def test_a_sine_comes_out_as_of_the_continuous_lag(lag, frequency, phase):
    time = np.arange(400) / RATE
    found = low_pass(np.cos(2 * np.pi * frequency * time + phase), lag, RATE)
    expected = through_the_lag(lag, frequency, phase, time)
    settled = slice(int(20 * lag * RATE) + 2 * HALF_WIDTH, 400 - HALF_WIDTH)
    size = np.abs(1 / (1 + 2j * np.pi * frequency * lag))
    assert np.abs(found - expected)[settled].max() < 4e-4 * size


def test_what_stands_still_stays_and_no_lag_changes_nothing(random):
    np.testing.assert_allclose(low_pass(np.full(50, 3.0), 0.02, RATE), 3.0, rtol=1e-12)
    signal = random.normal(size=50)
    assert low_pass(signal, 0.0, RATE) is signal


def test_what_comes_before_the_first_sample_fades_with_the_lag():
    time = np.arange(300) / RATE
    whole = np.sin(2 * np.pi * 3 * time)
    late = low_pass(whole[100:], 0.03, RATE) - low_pass(whole, 0.03, RATE)[100:]
    assert np.abs(late[:3]).max() > 1e-3
    np.testing.assert_allclose(late[1:60] / late[:59], np.exp(-1 / 3), atol=1e-3)
