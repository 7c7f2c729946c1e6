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


def test_hand_worked_errors():
    estimates, truth = [[10.0, 20.0], [14.0, 28.0]], [11.0, 24.0]
    assert metrics.bias_error(estimates, truth) == pytest.approx(np.sqrt((1 + 0) / 2))
    assert metrics.random_error(estimates) == pytest.approx(np.sqrt((4 + 4 + 16 + 16) / 4))
    assert metrics.total_error(estimates, truth) == pytest.approx(np.sqrt((1 + 9 + 16 + 16) / 4))


@pytest.mark.parametrize("name", metrics.CATALOGUE)
def test_a_perfect_identification_has_the_best_value(name, random):
    metric = metrics.CATALOGUE[name]
    time = np.arange(200) / 100
    truth = tv.simulate.SquareWave()(time)
    torque = random.normal(size=(4, 200))
    arguments = {
        "random_error": ([truth, truth],),
        "rise_time": (time, [truth]),
        "vaf": (torque, torque),
        "time_varying_vaf": (torque, torque),
        "bandpassed_vaf": (torque, torque, 100.0),
        # A perfect band of 95 % misses the truth in one trial of twenty.
        "coverage": (
            truth + np.r_[[-1.0] * 19, 1.0][:, None],
            truth + np.full((20, 1), 2.0),
            truth,
        ),
    }.get(name, ([truth, truth], truth))
    np.testing.assert_allclose(metric.function(*arguments), metric.best, atol=1e-12)
    assert metric.unit in {"N·m/rad", "s", "%"}
    assert metric.needs_truth == (
        name
        in {
            "bias_error",
            "debiased_bias_error",
            "mean_bias",
            "total_error",
            "rise_time",
            "coverage",
        }
    )


def test_coverage_counts_edges_as_inside_and_leaves_out_what_has_no_band():
    nan = np.nan
    lower, upper = [[0.0, nan, 1.0], [1.5, nan, 2.0]], [[1.0, 5.0, 2.0], [3.0, nan, 3.0]]
    assert metrics.coverage(lower, upper, [1.0, 1.0, 2.0]) == 75.0
    assert (
        metrics.coverage([[nan]], [[1.0]], [0.0])
        != metrics.coverage([[0.0]], [[1.0]], [0.0])
        == 100.0
    )
    for wrong in (
        ([0.0], [1.0], [0.5]),
        ([[0.0]], [[1.0, 2.0]], [0.5]),
        ([[0.0]], [[1.0]], [0.5, 0.5]),
    ):
        with pytest.raises(tv.InputError, match="coverage: expected lower and upper of axes"):
            metrics.coverage(*wrong)


def test_edges_without_estimate_are_left_out_and_counted():
    estimates = np.array([[np.nan, 1.0, 3.0, np.nan], [np.nan, 2.0, 3.0, 5.0]])
    assert metrics.left_out(estimates) == 2
    assert metrics.bias_error(estimates, np.zeros(4)) == metrics.bias_error(
        estimates[:, 1:3], np.zeros(2)
    )
    assert metrics.random_error(estimates) == metrics.random_error(estimates[:, 1:3])
    assert np.isnan(metrics.total_error(np.full((2, 3), np.nan), np.zeros(3)))


@pytest.mark.parametrize(
    ("curve", "expected"),
    [
        (
            lambda t: 50 + 100 * np.clip((t - 0.4) / 0.2, 0, 1),
            0.16,
        ),  # a ramp of 0.2 s from 60 to 140
        (lambda t: np.where(t < 0.5, 50.0, 150.0), 0.0),
        (lambda t: np.where(t < 0.5, 50.0, 130.0), np.nan),  # never high enough
        (lambda t: np.where(t < 0.5, 70.0, 150.0), np.nan),  # never low
    ],
)
def test_rise_time(curve, expected):
    time = np.arange(200) / 100
    assert metrics.rise_time(time, [curve(time)]) == pytest.approx(expected, abs=0.011, nan_ok=True)


def test_noise_far_from_the_switch_does_not_shorten_or_stretch_the_rise():
    time = np.arange(200) / 100
    curve = np.where((time >= 0.5) & (time < 1.5), 150.0, 50.0)
    curve[[3, 20, 30]] = 70.0
    curve[190] = 150.0
    assert metrics.rise_time(time, [curve]) == 0.0


@pytest.mark.parametrize("window", [0.06, 0.1, 0.2])
def test_short_segments_rise_over_four_fifths_of_their_window(window):
    simulation = tv.simulate.Joint(stiffness=tv.simulate.SquareWave()).simulate(
        300, perturbation=tv.simulate.FilteredNoise(), snr_db=60, seed=2
    )
    ensemble = tv.preprocess.segment(tv.preprocess.decimate(simulation.recording, 100), 2.0)
    model = tv.ShortDataSegments(window=window).identify(ensemble)
    # The window holds one sample more than it is long.
    assert metrics.rise_time(model.time, [model.stiffness]) == pytest.approx(
        0.8 * (window + 0.01), abs=0.0151
    )


def test_hand_worked_vaf():
    torque, predicted = np.array([[3.0, 4.0], [1.0, 0.0]]), np.array([[3.0, 3.0], [3.0, 0.0]])
    np.testing.assert_allclose(metrics.vaf(torque, predicted), [96.0, 0.0])  # -300 % is clipped
    np.testing.assert_allclose(metrics.time_varying_vaf(torque, predicted), [60.0, 93.75])


@given(
    hnp.arrays(np.float64, (5, 7), elements=finite), hnp.arrays(np.float64, (5, 7), elements=finite)
)
def test_vaf_is_a_percentage(torque, predicted):
    for values in (metrics.vaf(torque, predicted), metrics.time_varying_vaf(torque, predicted)):
        known = values[np.isfinite(values)]
        assert ((known >= 0) & (known <= 100)).all()


def test_vaf_leaves_out_what_was_not_predicted(random):
    torque, predicted = random.normal(size=(3, 50)), random.normal(size=(3, 50))
    predicted[:, :5] = np.nan
    np.testing.assert_allclose(
        metrics.vaf(torque, predicted), metrics.vaf(torque[:, 5:], predicted[:, 5:])
    )
    over_time = metrics.time_varying_vaf(torque, predicted)
    assert np.isnan(over_time[:5]).all()
    assert np.isfinite(over_time[5:]).all()
    assert np.isnan(metrics.vaf(np.zeros((1, 3)), np.zeros((1, 3)))).all()


def test_bandpass_takes_away_what_lies_outside():
    time = np.arange(1000) / 100
    inside, outside = np.sin(2 * np.pi * 4 * time), 5 * np.sin(2 * np.pi * 30 * time)
    assert metrics.vaf([inside + outside], [inside])[0] < 10
    assert metrics.bandpassed_vaf([inside + outside], [inside], 100.0)[0] > 99


@pytest.mark.parametrize("perturbation", ["noise", "prbs"])
def test_bandpass_of_realizations_comes_close_to_that_of_the_record(ensemble_of, perturbation):
    ensemble = ensemble_of(150.0, "square", perturbation)
    torque, predicted = (
        ensemble.torque[:, ensemble.core],
        tv.BasisIRF().identify(ensemble).predict(ensemble),
    )
    sections = butter(3, [1, 10], btype="bandpass", fs=100, output="sos")
    whole = [
        sosfiltfilt(sections, signals.ravel()).reshape(signals.shape)
        for signals in (torque, predicted)
    ]
    found, expected = metrics.bandpassed_vaf(torque, predicted, 100.0), metrics.vaf(*whole)
    assert np.sqrt(np.mean((found - expected) ** 2)) < 0.6


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
        (
            lambda: metrics.bias_error([[1.0, 2.0]], [1.0]),
            r"one value for each of 2 times, got shape \(1,\)",
        ),
        (lambda: metrics.rise_time([0.0], [[1.0, 2.0]]), "one value for each of 2 estimates"),
        (lambda: metrics.vaf([1.0], [1.0]), r"axes \(realization, time\)"),
        (lambda: metrics.vaf([[1.0]], [[1.0, 2.0]]), "of the same shape"),
        (lambda: metrics.bandpassed_vaf([[1.0]], [[1.0]], 15.0), "rises within 0 to 7.5 Hz"),
    ],
)
def test_wrong_shapes_are_refused(call, message):
    with pytest.raises(tv.InputError, match=message):
        call()
