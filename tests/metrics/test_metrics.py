import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.signal import butter, sosfiltfilt

import tvsysid as tv
from tvsysid import metrics

finite = st.floats(-1e3, 1e3)
trials = hnp.arrays(np.float64, st.tuples(st.integers(1, 6), st.just(8)), elements=finite)


@given(trials, hnp.arrays(np.float64, 8, elements=finite))
def test_total_error_is_bias_and_random_error(estimates, truth):
    bias, random = metrics.bias_error(estimates, truth), metrics.random_error(estimates)
    assert metrics.total_error(estimates, truth) ** 2 == pytest.approx(
        bias**2 + random**2, abs=1e-6
    )
    assert metrics.debiased_bias_error(estimates, truth) ** 2 == pytest.approx(
        max(0.0, bias**2 - random**2 / (len(estimates) - 1)) if len(estimates) > 1 else np.nan,
        abs=1e-6,
        nan_ok=True,
    )


def test_coverage_includes_edges_and_leaves_out_times_without_band():
    nan = np.nan
    lower, upper = [[0.0, nan, 1.0], [1.5, nan, 2.0]], [[1.0, 5.0, 2.0], [3.0, nan, 3.0]]
    assert metrics.coverage(lower, upper, [1.0, 1.0, 2.0]) == 75.0
    assert np.isnan(metrics.coverage([[nan]], [[1.0]], [0.0]))


def test_times_without_estimate_are_left_out():
    estimates = np.array([[np.nan, 1.0, 3.0, np.nan], [np.nan, 2.0, 3.0, 5.0]])
    assert metrics.bias_error(estimates, np.zeros(4)) == metrics.bias_error(
        estimates[:, 1:3], np.zeros(2)
    )
    assert metrics.random_error(estimates) == metrics.random_error(estimates[:, 1:3])
    assert np.isnan(metrics.total_error(np.full((2, 3), np.nan), np.zeros(3)))


@pytest.mark.parametrize(
    ("curve", "expected"),
    [
        (lambda t: 50 + 100 * np.clip((t - 0.4) / 0.2, 0, 1), 0.16),  # a ramp of 0.2 s
        (lambda t: np.where(t < 0.5, 50.0, 150.0), 0.0),
        (lambda t: np.where(t < 0.5, 50.0, 130.0), np.nan),  # never high enough
        (lambda t: np.where(t < 0.5, 70.0, 150.0), np.nan),  # never low
        (lambda t: np.where(t < 0.5, 50.0, 150.0) + 20 * (np.abs(t - 0.2) < 0.01), 0.0),  # noise
    ],
)
def test_rise_time(curve, expected):
    time = np.arange(200) / 100
    assert metrics.rise_time(time, [curve(time)]) == pytest.approx(expected, abs=0.011, nan_ok=True)


def test_hand_worked_vaf():
    torque, predicted = [[3.0, 4.0], [1.0, 0.0]], [[3.0, 3.0], [3.0, 0.0]]
    np.testing.assert_allclose(metrics.vaf(torque, predicted), [96.0, 0.0])  # -300 % is clipped
    np.testing.assert_allclose(metrics.time_varying_vaf(torque, predicted), [60.0, 93.75])


def test_vaf_leaves_out_samples_without_prediction(random):
    torque, predicted = random.normal(size=(3, 50)), random.normal(size=(3, 50))
    predicted[:, :5] = np.nan
    np.testing.assert_allclose(
        metrics.vaf(torque, predicted), metrics.vaf(torque[:, 5:], predicted[:, 5:])
    )
    over_time = metrics.time_varying_vaf(torque, predicted)
    assert np.isnan(over_time[:5]).all()
    assert np.isfinite(over_time[5:]).all()
    assert np.isnan(metrics.vaf(np.zeros((1, 3)), np.zeros((1, 3)))).all()


def test_bandpass_is_the_third_order_butterworth(random):
    torque, predicted = random.normal(size=(2, 3, 300))
    sections = butter(3, [1, 10], btype="bandpass", fs=100, output="sos")
    filtered = [
        sosfiltfilt(sections, signals, axis=1, padtype="even", padlen=100)
        for signals in (torque, predicted)
    ]
    np.testing.assert_allclose(
        metrics.bandpassed_vaf(torque, predicted, 100.0), metrics.vaf(*filtered)
    )
    edges = predicted.copy()
    edges[0, :10] = np.nan
    expected = metrics.bandpassed_vaf(torque[:, 10:], predicted[:, 10:], 100.0)
    np.testing.assert_allclose(metrics.bandpassed_vaf(torque, edges, 100.0), expected)
    assert np.isnan(metrics.bandpassed_vaf(torque[:, :15], predicted[:, :15], 100.0)).all()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: metrics.random_error([1.0, 2.0]), r"axes \(trial, time\), got shape \(2,\)"),
        (lambda: metrics.bias_error([[1.0, 2.0]], [1.0]), r"each time, got shape \(1,\)"),
        (lambda: metrics.rise_time([0.0], [[1.0, 2.0]]), r"each time, got shape \(1,\)"),
        (lambda: metrics.coverage([[0.0]], [[1.0]], [0.5, 0.5]), r"each time, got shape \(2,\)"),
        (lambda: metrics.vaf([[1.0]], [[1.0, 2.0]]), "of the same shape"),
    ],
)
def test_wrong_shapes_are_refused(call, message):
    with pytest.raises(tv.InputError, match=message):
        call()
