"""The fit that checks share, its statistics, and the rate at which both are made."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import ttest_1samp
from tests.conftest import realizations
from tests.faults import cut, simulated

import tvsysid as tv
from tvsysid.quality.fit import FittedEnsemble, SecondOrderFit, at_diagnosis_rate
from tvsysid.quality.statistics import SIGNIFICANT, is_mean_significant


@given(st.integers(0, 1000), st.integers(8, 50), st.floats(-3, 3))
def test_significance_is_that_of_students_t(seed, count, mean):
    scores = np.random.default_rng(seed).normal(mean, size=count)
    assert is_mean_significant(scores) == (ttest_1samp(scores, 0).pvalue < SIGNIFICANT)
    assert not is_mean_significant(scores[:7])  # too few prove nothing


@pytest.mark.parametrize("rate", [1000, 500])
def test_a_high_rate_is_lowered_as_preprocessing_does(rate):
    recording = tv.preprocess.decimate(simulated(40.0), rate)
    low = at_diagnosis_rate(tv.preprocess.segment(recording, 2.0))
    same = realizations(recording)
    np.testing.assert_allclose(low.torque[:, low.core], same.torque[:, same.core], atol=1e-9)
    np.testing.assert_array_equal(low.onsets, same.onsets)


@pytest.mark.parametrize(("samples", "low"), [(1111, 112), (499, 54)])
def test_a_rate_that_does_not_divide_is_lowered_between_samples(samples, low):
    """Slow sines are the same at the new samples."""

    def signals(samples, rate):
        turns = np.outer([0.7, 1.3, 2.1, 3.8], np.arange(samples) / rate)
        return np.sin(2 * np.pi * turns), np.cos(2 * np.pi * turns)

    lower = at_diagnosis_rate(tv.Ensemble(*signals(samples, 1000), 1000.0))
    assert lower.samples == low
    assert lower.duration == pytest.approx(samples / 1000)
    truth = np.stack(signals(low, lower.sampling_rate))
    # Odd reflection at the ends is not what the signal does there.
    found = np.stack([lower.angle, lower.torque])
    np.testing.assert_allclose(found[..., 3:-3], truth[..., 3:-3], atol=0.02)


def test_the_mean_impedance_and_its_error_are_right():
    """Over 40 simulations the errors are as large as the values scatter."""
    found = [
        FittedEnsemble.of(cut(simulated(40.0, "prbs", "constant", seed=seed))).fit.mean_impedance
        for seed in range(40)
    ]
    values, errors = (np.array(each) for each in zip(*found, strict=True))
    np.testing.assert_allclose(values.mean(axis=0)[:2], [100, 2.2], rtol=0.03)
    np.testing.assert_allclose(errors.mean(axis=0), values.std(axis=0, ddof=1), rtol=0.3)


@given(st.integers(0, 100), st.integers(3, 30), st.integers(20, 60))
def test_the_partitioned_fit_is_the_dense_one(seed, realizations, samples):
    motion = np.random.default_rng(seed).normal(size=(4, realizations, samples))
    fit = SecondOrderFit(motion[:3], motion[3])
    inside = fit.bins == np.arange(fit.bins.max() + 1)[:, None]
    columns = (motion[:2, None] * inside[:, None]).reshape(-1, motion[3].size)
    dense = np.vstack([columns, motion[2].ravel()]).T
    solution = np.linalg.lstsq(dense, motion[3].ravel(), rcond=None)[0]
    np.testing.assert_allclose(fit.parts.sum(axis=0).ravel(), dense @ solution, atol=1e-8)
