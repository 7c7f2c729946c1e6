import numpy as np
import pytest
from scipy.signal import butter, lfilter

import tvsysid as tv

RATE = 128.0
STEPS = {
    "task component": tv.preprocess.exclude_task_outliers,
    "residual": tv.preprocess.exclude_residual_outliers,
}
steps = pytest.mark.parametrize("name", STEPS)


def clean(seed, realizations=300, context=64):
    """Gaussian torque below 5 Hz, as perturbations evoke it, without outliers."""
    white = np.random.default_rng(seed).standard_normal((realizations, 128 + 256 + 2 * context))
    torque = lfilter(*butter(2, 5.0, fs=RATE), white, axis=1)[:, 128:]
    return tv.Ensemble(torque, torque, RATE, context)


def with_torque(ensemble, added):
    torque = np.array(ensemble.torque)
    for realization, values in added.items():
        torque[realization, ensemble.core] += values
    return tv.Ensemble(ensemble.angle, torque, RATE, ensemble.context)


def test_the_task_component_is_the_first_harmonic():
    phase = 2 * np.pi * np.arange(256) / 256
    harmonic = 2 * np.sin(phase + np.arange(3)[:, None])
    torque = 4 + harmonic + 5 * np.cos(2 * phase) + np.sin(100 * phase)
    found = STEPS["task component"](tv.Ensemble(torque, torque, RATE)).torque
    np.testing.assert_allclose(found, harmonic, atol=1e-12)


def test_lapses_and_twitches_are_excluded():
    ensemble = clean(1)
    spread = ensemble.torque.std()
    time = np.arange(256) / RATE
    lapse = 6 * spread * np.sin(np.pi * time)
    twitch = 8 * spread * np.exp(-0.5 * ((time - 1.1) / 0.08) ** 2)
    planted = with_torque(ensemble, {7: lapse, 40: -lapse, 100: twitch, 200: -twitch})
    assert not STEPS["task component"](planted).kept[[7, 40]].any()
    residual = STEPS["residual"](planted)
    assert not residual.kept[[100, 200]].any()
    assert (residual.reached[[100, 200]] > 4).all()
    outside = (np.abs(residual.torque - residual.mean) > residual.half_width).any(axis=1)
    np.testing.assert_array_equal(outside, ~residual.kept)
