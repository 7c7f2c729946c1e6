"""The fit that checks share, its statistics, and the rate at which both are made."""

import attrs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import kstest, ttest_1samp
from tests.faults import cut, late, simulated

import tvsysid as tv
from tvsysid.quality.fit import SecondOrderFit
from tvsysid.quality.fitted import FittedEnsemble
from tvsysid.quality.repetition import lines
from tvsysid.quality.resampling import lowered
from tvsysid.quality.statistics import FOLDS, gained_share, gains, innovations, p_value_of, without


@given(st.integers(0, 1000), st.integers(8, 50), st.floats(-3, 3))
def test_a_p_value_is_that_of_students_t(seed, count, mean):
    scores = np.random.default_rng(seed).normal(mean, size=count)
    assert p_value_of(scores) == pytest.approx(ttest_1samp(scores, 0).pvalue, rel=1e-6)
    assert p_value_of(scores[:7]) == 1.0  # too few prove nothing


@given(st.integers(0, 100), st.integers(8, 20))
def test_gain_is_that_of_cross_validation(seed, realizations):
    random = np.random.default_rng(seed)
    regressors = random.normal(size=(3, realizations, 30))
    target = 0.3 * regressors[1] + random.normal(size=(realizations, 30))
    left = 0.0
    for out in np.array_split(np.arange(realizations), FOLDS):
        kept = np.setdiff1d(np.arange(realizations), out)
        rows = regressors[:, kept].reshape(3, -1).T
        weights = np.linalg.lstsq(rows, target[kept].ravel(), rcond=None)[0]
        left += np.sum((target[out] - np.tensordot(weights, regressors[:, out], 1)) ** 2)
    assert gained_share(target, regressors) == pytest.approx(1 - left / np.sum(target**2), abs=1e-6)
    rest = without(target, regressors)
    np.testing.assert_allclose(np.einsum("art,rt->a", regressors, rest), 0, atol=1e-6)


def test_noise_predicts_nothing_whatever_its_colour():
    random = np.random.default_rng(1)
    found = [
        gains(random.normal(size=(40, 50)), random.normal(size=(5, 40, 50))) for _ in range(200)
    ]
    assert abs(np.mean(found)) < 0.005 * 50
    assert np.mean([gain.sum() > 0 and p_value_of(gain) < 0.05 for gain in found]) < 0.05
    noise = np.cumsum(random.normal(size=(300, 20, 100)), axis=2)
    scores = np.einsum("nrt,nrt->nr", noise, random.normal(size=noise.shape))
    assert kstest([p_value_of(each) for each in scores], "uniform").pvalue > 0.01


def test_innovations_of_a_known_process(random):
    """x(t) = 1.5 x(t-1) - 0.7 x(t-2) + e(t)."""
    noise = random.normal(size=(20, 500))
    signal = np.zeros_like(noise)
    for t in range(2, 500):
        signal[:, t] = 1.5 * signal[:, t - 1] - 0.7 * signal[:, t - 2] + noise[:, t]
    np.testing.assert_allclose(innovations(signal, 2), noise[:, 2:], atol=0.15)


@pytest.mark.parametrize(
    ("rate", "context", "expected"), [(1000, 0.5, 100), (500, 0.4, 100), (100, 0.5, 100)]
)
def test_a_high_rate_is_lowered_as_preprocessing_does(rate, context, expected):
    recording = simulated(40.0) if rate == 1000 else tv.preprocess.decimate(simulated(40.0), rate)
    low = lowered(tv.preprocess.segment(recording, 2.0, context))
    assert low.sampling_rate == expected
    same = tv.preprocess.segment(tv.preprocess.decimate(recording, expected), 2.0, context)
    np.testing.assert_allclose(low.torque[:, low.core], same.torque[:, same.core], atol=1e-9)
    np.testing.assert_array_equal(low.onsets, same.onsets)


@pytest.mark.parametrize(
    ("samples", "context", "low"), [(1111, 500, 112), (2003, 500, 201), (499, 0, 54)]
)
def test_a_rate_that_does_not_divide_is_lowered_between_samples(samples, context, low):
    """A sum of slow sines is the same at the new samples."""
    random = np.random.default_rng(0)
    frequency, phase = random.uniform(0.5, 4, (2, 10, 6, 1)), random.uniform(0, 6, (2, 10, 6, 1))

    def signals(samples, rate, context):
        time = np.arange(-context, samples + context) / rate
        return np.sin(2 * np.pi * frequency * time + phase).sum(axis=2)

    lower = lowered(tv.Ensemble(*signals(samples, 1000, context), 1000.0, context=context))
    assert lower.samples == low
    assert lower.duration == pytest.approx(samples / 1000)
    truth = signals(low, lower.sampling_rate, lower.context)
    inner = slice(3, -3)  # odd reflection at the ends is not what the signal does there
    found = np.stack([lower.angle, lower.torque])
    np.testing.assert_allclose(found[..., inner], truth[..., inner], atol=0.02)


def test_realizations_too_short_for_a_lower_rate_keep_theirs():
    ensemble = tv.Ensemble(*np.random.default_rng(0).normal(size=(2, 10, 61)), 1000.0)
    assert lowered(ensemble) is ensemble
    # No more of the past whitens them than leaves something to see.
    assert FittedEnsemble.of(ensemble).fit.whitening == (61 - 24) // 3


def test_a_torque_that_was_late_is_that_of_the_record_without_delay():
    recording = simulated(40.0)
    plain, delayed = (FittedEnsemble.of(cut(each)) for each in (recording, late(recording, 0.03)))
    mended = delayed.advance(3)
    inner = mended.core("torque")[1:-1]
    np.testing.assert_allclose(inner, plain.core("torque")[1:-1], atol=0.02)
    assert delayed.fit.explained < 0.9 < mended.fit.explained


def test_the_mean_impedance_and_its_error_are_right():
    """Over 40 simulations the errors are as large as the values scatter."""
    found = [
        FittedEnsemble.of(cut(simulated(40.0, "prbs", "constant", seed=seed))).fit.mean_impedance
        for seed in range(40)
    ]
    values, errors = (np.array(each) for each in zip(*found, strict=True))
    np.testing.assert_allclose(values.mean(axis=0)[:2], [100, 2.2], rtol=0.03)
    np.testing.assert_allclose(errors.mean(axis=0), values.std(axis=0, ddof=1), rtol=0.3)


def test_the_fit_is_of_deviations_in_the_order_of_recording(clean):
    offset = attrs.evolve(clean, torque=clean.torque + 3.0, angle=clean.angle - 1.0)
    shuffled = offset.select(np.random.default_rng(0).permutation(len(clean)))
    data = FittedEnsemble.of(shuffled)
    assert (np.diff(data.ensemble.onsets[data.order]) > 0).all()
    expected = FittedEnsemble.of(clean).fit.residual
    np.testing.assert_allclose(data.fit.residual[data.order], expected, atol=1e-9)


@given(st.integers(0, 100), st.integers(3, 30), st.integers(20, 60))
def test_the_partitioned_fit_is_the_dense_one(seed, realizations, samples):
    random = np.random.default_rng(seed)
    motion = random.normal(size=(3, realizations, samples))
    torque = random.normal(size=(realizations, samples))
    fit = SecondOrderFit(motion, torque, 100.0)
    inside = fit.bins == np.arange(fit.bins.max() + 1)[:, None]
    columns = [(order * inside[:, None]).reshape(len(inside), -1) for order in motion[:2]]
    dense = np.vstack([*columns, motion[2].reshape(1, -1)]).T
    solution, left, *_ = np.linalg.lstsq(dense, torque.ravel(), rcond=None)
    weights = fit.impedance[:, np.searchsorted(fit.bins, np.arange(len(inside)))]
    np.testing.assert_allclose(weights[:2].ravel(), solution[:-1], atol=1e-8)
    np.testing.assert_allclose(weights[2], solution[-1], atol=1e-8)
    assert fit.explained == pytest.approx(1 - left[0] / np.sum(torque**2))
    assert np.sum(fit.residual**2) == pytest.approx(left[0])


def test_lines_are_those_of_a_slow_sum():
    data = FittedEnsemble.of(cut(simulated(40.0)))
    frequency, coherent, power = lines(data.fit.white_residual, data)
    time = data.ensemble.onsets[:, None] + np.arange(data.fit.white_residual.shape[1]) / data.rate
    turns = np.exp(-2j * np.pi * frequency[:, None, None] * time)
    own = np.einsum("rt,frt->fr", data.fit.white_residual, turns)
    expected, alone = np.abs(own.sum(axis=1)) ** 2, np.sum(np.abs(own) ** 2, axis=1)
    np.testing.assert_allclose(power, expected, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(coherent, expected / alone, rtol=1e-6, atol=1e-9)
