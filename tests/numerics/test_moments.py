import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tvsysid.numerics import moments


@pytest.mark.parametrize(("times", "beyond"), [(40, 0), (250, 3), (250, 30)])
def test_diagonal_moments_are_those_along_diagonals(random, times, beyond):
    a, b = random.normal(size=(7, times)), random.normal(size=(7, times + beyond))
    dense = np.pad(a.T @ b / 7, ((0, 0), (0, 12)))
    expected = [dense[time, time : time + 13] for time in range(times)]
    np.testing.assert_allclose(moments.diagonal_moments(a, b, 12), expected, atol=1e-12)


@pytest.mark.parametrize("times", [40, 300])
def test_lagged_moments_equal_a_loop(random, times):
    n, u, y = 5, random.normal(size=(9, times)), random.normal(size=(9, times)) + 3
    inner = slice(n, times - n)
    lagged = np.stack([np.roll(u, lag, axis=1)[:, inner] for lag in range(-n, n + 1)])
    expected = [
        np.einsum("art,brt->tab", lagged, lagged) / 9,
        np.einsum("art,rt->ta", lagged, y[:, inner]) / 9,
        np.mean(y[:, inner] ** 2, axis=0),
        np.mean(y[:, inner], axis=0),
    ]
    for found, each in zip(moments.lagged_moments(u, y, n), expected, strict=True):
        np.testing.assert_allclose(found, each, atol=1e-12)


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
    # A negative lag takes a sample that comes later.
    reversed_windows = np.lib.stride_tricks.sliding_window_view(u, before + after + 1, axis=1)
    expected = np.einsum("rtl,tl->rt", reversed_windows[..., ::-1], weights)
    np.testing.assert_allclose(moments.convolve_lags(u, weights), expected, atol=1e-12)
