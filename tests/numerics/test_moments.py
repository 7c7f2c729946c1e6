import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tvsysid.numerics import moments


@pytest.mark.parametrize(("times", "beyond"), [(40, 0), (250, 3), (250, 30)])
def test_diagonal_moments_equal_a_loop(random, times, beyond):
    a, b = random.normal(size=(7, times)), random.normal(size=(7, times + beyond))
    found = moments.diagonal_moments(a, b, 12)
    assert found.shape == (times, 13)
    for i in range(times):
        for d in range(13):
            expected = np.mean(a[:, i] * b[:, i + d]) if i + d < b.shape[1] else 0.0
            assert found[i, d] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("times", [40, 300])
def test_lagged_moments_equal_a_loop(random, times):
    u, y = random.normal(size=(9, times)), random.normal(size=(9, times)) + 3
    n = 5
    phi_uu, phi_uy, square, mean = moments.lagged_moments(u, y, n)
    for row, i in enumerate(range(n, times - n)):
        lagged = np.stack([u[:, i - lag] for lag in range(-n, n + 1)], axis=1)
        np.testing.assert_allclose(phi_uu[row], lagged.T @ lagged / 9, atol=1e-12)
        np.testing.assert_allclose(phi_uy[row], lagged.T @ y[:, i] / 9, atol=1e-12)
        assert square[row] == pytest.approx(np.mean(y[:, i] ** 2))
        assert mean[row] == pytest.approx(np.mean(y[:, i]))


@given(st.integers(1, 60), st.integers(0, 20), st.integers(0, 20))
def test_sliding_sum_equals_a_loop(length, before, after):
    x = np.random.default_rng(length).normal(size=(length, 2))
    expected = [x[max(0, i - before) : i + after + 1].sum(axis=0) for i in range(length)]
    np.testing.assert_allclose(moments.sliding_sum(x, before, after), expected, atol=1e-12)


@pytest.mark.parametrize("times", [30, 350])
def test_convolution_equals_a_loop(random, times):
    before, after = 3, 4
    u = random.normal(size=(5, times + before + after))
    weights = random.normal(size=(times, before + after + 1))
    found = moments.convolve_lags(u, weights)
    for i in range(times):
        # A negative lag takes a sample that comes later.
        expected = sum(
            weights[i, before + lag] * u[:, i + after - lag] for lag in range(-before, after + 1)
        )
        np.testing.assert_allclose(found[:, i], expected, atol=1e-12)
