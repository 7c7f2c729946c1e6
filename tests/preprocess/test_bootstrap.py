import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tvsysid.preprocess import bootstrap_weights


@pytest.mark.parametrize("contiguous", [False, True])
@given(st.integers(1, 40), st.integers(1, 20), st.integers(0, 2**32), st.data())
def test_weights_sum_to_the_size_and_more_draws_keep_the_first(
    contiguous, realizations, count, seed, data
):
    size = data.draw(st.integers(1, realizations))
    weights = bootstrap_weights(realizations, size, count, seed, contiguous)
    assert weights.shape == (count, realizations)
    assert weights.min() >= 0
    np.testing.assert_array_equal(weights.sum(axis=1), size)
    more = bootstrap_weights(realizations, size, count + 3, seed, contiguous)
    np.testing.assert_array_equal(more[:count], weights)
    if contiguous:  # in a circle, a block has one beginning at most
        assert weights.max() == 1
        begins = (weights == 1) & (np.roll(weights, 1, axis=1) == 0)
        assert (begins.sum(axis=1) == (size < realizations)).all()
