import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import tvsysid as tv
from tvsysid.quality.fit import Regressors, time_bins
from tvsysid.quality.fitted import FittedEnsemble


def dense(motion, torque, bins):
    """The same fit as one big least-squares problem."""
    count = bins.max() + 1
    indicator = (bins[None, :] == np.arange(count)[:, None]).astype(float)
    columns = [(motion[order][None] * indicator[:, None, :]).reshape(count, -1) for order in (0, 1)]
    regressor = np.vstack([*columns, motion[2].reshape(1, -1)]).T
    solution = np.linalg.lstsq(regressor, torque.ravel(), rcond=None)[0]
    return solution[:count], solution[count:-1], solution[-1]


@given(st.integers(0, 100), st.integers(3, 30), st.integers(20, 60))
def test_the_partitioned_fit_is_the_dense_one(seed, realizations, samples):
    random = np.random.default_rng(seed)
    motion = random.normal(size=(3, realizations, samples))
    torque = random.normal(size=(realizations, samples))
    fit = Regressors(motion, 100.0).fit(torque)
    stiffness, viscosity, inertia = dense(motion, torque, fit.bins)
    np.testing.assert_allclose(fit.stiffness, stiffness, atol=1e-8)
    np.testing.assert_allclose(fit.viscosity, viscosity, atol=1e-8)
    assert fit.inertia == pytest.approx(inertia, abs=1e-8)


def test_a_joint_without_noise_is_found_exactly():
    """A sum of sines has known derivatives; stiffness 80, viscosity 1.5, inertia 0.03."""
    random, time = np.random.default_rng(0), np.arange(300) / 100
    frequency, phase = (
        2 * np.pi * random.uniform(0.5, 20, (40, 8, 1)),
        random.uniform(0, 6, (40, 8, 1)),
    )
    angle = np.sin(frequency * time + phase)
    velocity, acceleration = frequency * np.cos(frequency * time + phase), -(frequency**2) * angle
    torque = (80 * angle + 1.5 * velocity + 0.03 * acceleration).sum(axis=1)
    fit = FittedEnsemble.of(tv.Ensemble(angle.sum(axis=1), torque, 100.0, context=50)).fit
    np.testing.assert_allclose(fit.stiffness, 80, rtol=2e-3)
    np.testing.assert_allclose(fit.viscosity, 1.5, rtol=2e-3)
    assert fit.inertia == pytest.approx(0.03, rel=2e-3)
    np.testing.assert_allclose(fit.parts.sum(axis=0), fit.torque, atol=2e-3 * np.abs(torque).max())


@given(st.integers(10, 500), st.integers(2, 300), st.sampled_from([20.0, 100.0, 128.0]))
def test_bins_cover_all_samples_and_hold_enough(samples, realizations, rate):
    bins = time_bins(samples, realizations, rate)
    assert len(bins) == samples
    assert set(np.diff(bins)) <= {0, 1}
    length = np.bincount(bins).min()
    assert length >= max(1, min(round(0.05 * rate), samples))
    assert length * realizations >= 100 or length >= samples // 10
