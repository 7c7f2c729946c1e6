import attrs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import kstest, ttest_1samp
from tests.faults import cut, late, simulated

import tvsysid as tv
from tvsysid.numerics.interpolation import between
from tvsysid.quality.fitted import FittedEnsemble
from tvsysid.quality.resampling import lowered
from tvsysid.quality.statistics import FOLDS, gained, innovations, p_value_of, without


@given(st.integers(0, 1000), st.integers(8, 50), st.floats(-3, 3))
def test_a_p_value_is_that_of_students_t(seed, count, mean):
    scores = np.random.default_rng(seed).normal(mean, size=count)
    assert p_value_of(scores) == pytest.approx(ttest_1samp(scores, 0).pvalue, rel=1e-6)


def test_too_few_realizations_prove_nothing():
    assert p_value_of(np.full(7, 1.0) + 1e-9 * np.arange(7)) == 1.0


def slow_gain(target, regressors):
    """Fit to all other realizations, and count what is predicted of those left out."""
    left = 0.0
    for out in np.array_split(np.arange(len(target)), FOLDS):
        kept = np.setdiff1d(np.arange(len(target)), out)
        fitted = regressors[:, kept].reshape(len(regressors), -1).T
        weights = np.linalg.lstsq(fitted, target[kept].ravel(), rcond=None)[0]
        left += np.sum((target[out] - np.tensordot(weights, regressors[:, out], 1)) ** 2)
    return 1 - left / np.sum(target**2)


@given(st.integers(0, 100), st.integers(8, 20))
def test_gain_is_that_of_cross_validation(seed, realizations):
    random = np.random.default_rng(seed)
    regressors = random.normal(size=(3, realizations, 30))
    target = 0.3 * regressors[1] + random.normal(size=(realizations, 30))
    share, _ = gained(target, regressors)
    assert share == pytest.approx(slow_gain(target, regressors), abs=1e-6)


def test_noise_predicts_nothing_and_its_p_value_is_fair():
    random = np.random.default_rng(1)
    found = [
        gained(random.normal(size=(40, 50)), random.normal(size=(5, 40, 50))) for _ in range(200)
    ]
    shares = np.array([share for share, _ in found])
    assert abs(shares.mean()) < 0.005
    certain = np.mean([share > 0 and probability < 0.05 for share, probability in found])
    assert certain < 0.05


def test_the_p_value_is_fair_for_slow_noise():
    """The sum over a realization of slow noise times an independent input.

    Student's t holds, whatever the colour.
    """
    random = np.random.default_rng(2)
    noise = np.cumsum(random.normal(size=(300, 20, 100)), axis=2)
    scores = np.einsum("nrt,nrt->nr", noise, random.normal(size=noise.shape))
    assert kstest([p_value_of(each) for each in scores], "uniform").pvalue > 0.01


def test_without_leaves_nothing_that_the_regressors_explain(random):
    regressors, target = random.normal(size=(4, 10, 50)), random.normal(size=(10, 50))
    left = without(target, regressors)
    np.testing.assert_allclose(np.einsum("art,rt->a", regressors, left), 0, atol=1e-6)


def test_innovations_of_a_known_process(random):
    """x(t) = 1.5 x(t-1) - 0.7 x(t-2) + e(t)."""
    noise = random.normal(size=(20, 500))
    signal = np.zeros_like(noise)
    for t in range(2, 500):
        signal[:, t] = 1.5 * signal[:, t - 1] - 0.7 * signal[:, t - 2] + noise[:, t]
    np.testing.assert_allclose(innovations(signal, 2), noise[:, 2:], atol=0.15)


@pytest.mark.parametrize(
    ("rate", "context", "expected"), [(1000, 0.5, 100), (250, 0.4, 125), (100, 0.5, 100)]
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

    def signals(time):
        return np.sin(2 * np.pi * frequency * time + phase).sum(axis=2)

    ensemble = tv.Ensemble(
        *signals((np.arange(samples + 2 * context) - context) / 1000), 1000.0, context=context
    )
    lower = lowered(ensemble)
    assert lower.samples == low
    assert lower.duration == pytest.approx(ensemble.duration)
    truth = signals((np.arange(low + 2 * lower.context) - lower.context) / lower.sampling_rate)
    inner = slice(3, -3)  # odd reflection at the ends is not what the signal does there
    np.testing.assert_allclose(lower.angle[:, inner], truth[0][:, inner], atol=0.02)
    np.testing.assert_allclose(lower.torque[:, inner], truth[1][:, inner], atol=0.02)


def test_realizations_too_short_for_a_lower_rate_keep_theirs():
    ensemble = tv.Ensemble(*np.random.default_rng(0).normal(size=(2, 10, 61)), 1000.0)
    assert lowered(ensemble) is ensemble
    # No more of the past whitens them than leaves something to see.
    assert FittedEnsemble.of(ensemble).whitening == (61 - 24) // 3


@pytest.mark.parametrize("later", [-0.5, 0.25, 0.5])
def test_values_between_samples(later):
    time = np.arange(200)
    wave = np.sin(2 * np.pi * 0.3 * time + 1.0)[None]
    np.testing.assert_allclose(
        between(wave, later)[0, 20:-20],
        np.sin(2 * np.pi * 0.3 * (time + later) + 1.0)[20:-20],
        atol=2e-3,
    )


def test_a_synchronised_fit_is_that_of_the_record_without_delay():
    recording = simulated(40.0)
    plain, delayed = (
        FittedEnsemble.of(cut(recording)),
        FittedEnsemble.of(cut(late(recording, 0.03))),
    )
    mended = delayed.advance(3)
    assert mended.ensemble.context == plain.ensemble.context - 3
    core = plain.ensemble.core
    np.testing.assert_allclose(
        mended.torque[1:-1, mended.ensemble.core], plain.torque[1:-1, core], atol=0.02
    )
    assert delayed.explained < 0.9 < mended.explained


def test_the_mean_impedance_and_its_error_are_right():
    """Over 40 simulations the errors are as large as the values scatter."""
    found = [
        FittedEnsemble.of(cut(simulated(40.0, "prbs", "constant", seed=seed))).mean_impedance
        for seed in range(40)
    ]
    values, errors = (np.array(each) for each in zip(*found, strict=True))
    np.testing.assert_allclose(values.mean(axis=0)[:2], [100, 2.2], rtol=0.03)
    np.testing.assert_allclose(errors.mean(axis=0), values.std(axis=0, ddof=1), rtol=0.3)


def test_the_order_is_that_of_recording(clean):
    shuffled = clean.select(np.random.default_rng(0).permutation(len(clean)))
    data = FittedEnsemble.of(shuffled)
    assert (np.diff(data.ensemble.onsets[data.order]) > 0).all()


def test_the_fit_is_of_deviations(clean):
    offset = attrs.evolve(clean, torque=clean.torque + 3.0, angle=clean.angle - 1.0)
    np.testing.assert_allclose(
        FittedEnsemble.of(offset).fit.residual, FittedEnsemble.of(clean).fit.residual, atol=1e-9
    )
