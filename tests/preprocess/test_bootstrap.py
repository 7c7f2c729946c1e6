import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import tvsysid as tv
from tvsysid.preprocess import block_weights, bootstrap, bootstrap_weights


@given(st.integers(1, 40), st.integers(1, 60), st.integers(1, 20), st.integers(0, 2**32))
def test_weights_sum_to_the_size_and_depend_on_the_seed_alone(realizations, size, count, seed):
    weights = bootstrap_weights(realizations, size, count, seed)
    assert weights.shape == (count, realizations)
    assert weights.min() >= 0
    np.testing.assert_array_equal(weights.sum(axis=1), size)
    more = bootstrap_weights(realizations, size, count + 3, seed)
    np.testing.assert_array_equal(more[:count], weights)


def test_each_realization_is_drawn_as_often_as_any_other():
    weights = bootstrap_weights(50, 75, 4000, 1)
    # A realization's count is binomial: mean 1.5, variance 1.47.
    np.testing.assert_allclose(weights.mean(axis=0), 1.5, atol=5 * np.sqrt(1.47 / 4000))
    np.testing.assert_allclose(weights.var(axis=0).mean(), 1.47, rtol=0.03)


def test_ensembles_hold_what_the_weights_say():
    values = np.tile(np.arange(5.0)[:, None], (1, 8)) + np.linspace(0, 0.5, 8)
    ensemble = tv.Ensemble(values, values, 100.0, channels={"emg": values})
    drawn = list(bootstrap(ensemble, count=6, seed=3, size=9))
    weights = bootstrap_weights(5, 9, 6, 3)
    assert [len(each) for each in drawn] == [9] * 6
    for each, times in zip(drawn, weights, strict=True):
        np.testing.assert_array_equal(np.bincount(each.angle[:, 0].astype(int), minlength=5), times)
        np.testing.assert_array_equal(each.channels["emg"], each.angle)
    assert len(next(bootstrap(ensemble, 1, 0))) == 5


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"size": 0}, "size must be a whole number of one or more, got 0"),
        ({"count": 2.5}, "count must be a whole number of one or more, got 2.5"),
        ({"seed": "x"}, "seed must be a whole number of zero or more"),
        ({"seed": -1}, "seed must be a whole number of zero or more"),
    ],
)
def test_draws_that_make_no_sense_are_refused_at_once(settings, message):
    values = np.random.default_rng(0).normal(size=(5, 8))
    with pytest.raises(tv.InputError, match=message):
        bootstrap(tv.Ensemble(values, values, 100.0), **{"count": 2, "seed": 0, **settings})


@given(st.integers(1, 40), st.integers(1, 20), st.integers(0, 2**32), st.data())
def test_blocks_are_realizations_that_follow_each_other(realizations, count, seed, data):
    size = data.draw(st.integers(1, realizations))
    weights = block_weights(realizations, size, count, seed)
    np.testing.assert_array_equal(weights.sum(axis=1), size)
    assert set(np.unique(weights)) <= {0, 1}
    # Round a circle, a block has one beginning at most.
    begins = (weights == 1) & (np.roll(weights, 1, axis=1) == 0)
    assert (begins.sum(axis=1) == (size < realizations)).all()
    np.testing.assert_array_equal(
        block_weights(realizations, size, count + 2, seed)[:count], weights
    )


def test_blocks_hold_each_realization_as_often_as_any_other():
    weights = block_weights(50, 10, 4000, 2)
    np.testing.assert_allclose(weights.mean(axis=0), 0.2, atol=5 * np.sqrt(0.16 / 4000))


def test_a_block_longer_than_the_record_is_refused():
    with pytest.raises(
        tv.InputError,
        match="a block of 40 realizations cannot be drawn from 20; give a shorter one",
    ):
        block_weights(20, 40, 1, 0)
