import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import butter, lfilter

import tvsysid as tv
from tvsysid.preprocess.exclude import task_component

RATE = 128.0
STEPS = {
    "task component": tv.preprocess.exclude_task_outliers,
    "residual": tv.preprocess.exclude_residual_outliers,
}


def clean(seed, realizations=300, context=64):
    """Gaussian torque below 5 Hz, as perturbations evoke it: no realization is unlike the others."""
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
    torque = 4 + 2 * np.sin(phase + 0.3) + 5 * np.cos(2 * phase) + np.sin(100 * phase)
    np.testing.assert_allclose(
        task_component(torque[None, :])[0], 2 * np.sin(phase + 0.3), atol=1e-12
    )


def test_a_lapse_is_found_by_the_task_component_and_a_twitch_by_the_residual():
    ensemble = clean(1)
    spread = ensemble.torque.std()
    time = np.arange(256) / RATE
    lapse = 6 * spread * np.sin(np.pi * time)
    twitch = 8 * spread * np.exp(-0.5 * ((time - 1.1) / 0.08) ** 2)
    planted = with_torque(ensemble, {7: lapse, 40: -lapse, 100: twitch, 200: -twitch})
    task = STEPS["task component"](planted)
    assert not task.account.kept[[7, 40]].any()
    residual = STEPS["residual"](planted)
    assert not residual.account.kept[[100, 200]].any()
    assert (residual.account.reached[[100, 200]] > 4).all()
    # What excluded them can be read off what was judged.
    outside = (np.abs(residual.judged - residual.mean) > residual.half_width).any(axis=1)
    np.testing.assert_array_equal(outside, ~residual.account.kept)


# Share of clean realizations excluded, in per cent: limits on what was measured over 3000 of them.
@pytest.mark.parametrize(
    ("step", "limit", "low", "high"),
    [
        ("task component", 3.0, 0.6, 1.7),  # exp(-4.5) = 1.1 %
        (
            "residual",
            3.0,
            8.5,
            11.5,
        ),  # some 20 independent values, each in 370 out: the paper's rule takes 30 of 300
        ("residual", 4.0, 0.1, 0.8),
    ],
)
def test_how_many_of_clean_realizations_are_excluded(step, limit, low, high):
    excluded = [
        300 - np.count_nonzero(STEPS[step](clean(seed), limit=limit).account.kept)
        for seed in range(10)
    ]
    assert low < 100 * sum(excluded) / 3000 < high


def test_limits_are_those_of_all_and_not_computed_again():
    ensemble = clean(3)
    step = STEPS["task component"](ensemble)
    np.testing.assert_allclose(step.half_width, 3 * step.judged.std(axis=0, ddof=1))
    assert len(step.judged) == 300


@pytest.mark.parametrize("name", STEPS)
@given(seed=st.integers(0, 1000), limit=st.floats(2.5, 5.0))
def test_what_is_kept_is_untouched_and_in_order(name, seed, limit):
    ensemble = clean(seed, realizations=40)
    before = ensemble.torque.copy()
    step, again = STEPS[name](ensemble, limit=limit), STEPS[name](ensemble, limit=limit)
    np.testing.assert_array_equal(ensemble.torque, before)
    np.testing.assert_array_equal(step.ensemble.torque, before[step.account.kept])
    np.testing.assert_array_equal(step.account.kept, again.account.kept)
    assert (step.account.reached[~step.account.kept] > limit).all()


@pytest.mark.parametrize("name", STEPS)
def test_limits_that_make_no_sense_are_refused(name):
    with pytest.raises(
        tv.InputError, match="limit must be a positive number of standard deviations"
    ):
        STEPS[name](clean(0), limit=0.0)
    with pytest.raises(tv.InputError, match="every realization leaves the mean by 1e-06 SD"):
        STEPS[name](clean(0), limit=1e-6)
    with pytest.raises(tv.InputError, match="expected at least two realizations"):
        STEPS[name](clean(0, realizations=1))


def test_a_cutoff_above_half_the_rate_is_refused():
    with pytest.raises(tv.InputError, match="cutoff must be between 0 and 64 Hz"):
        STEPS["residual"](clean(0), cutoff=64.0)
