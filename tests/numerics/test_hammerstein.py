"""Sums of products of lagged signals equal those of the matrix of lagged signals."""

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view

from tvsysid.numerics.hammerstein import lagged_moments


def test_lagged_products_are_those_of_the_lagged_signals(random):
    signals, output = random.normal(size=(3, 4, 230)), random.normal(size=(4, 200))
    late = sliding_window_view(signals, 31, axis=2)[..., ::-1]  # signal, realization, time, lag
    columns = np.moveaxis(late, 0, 2).reshape(output.size, -1)
    gram, cross, square, number = lagged_moments([(signals, output)])
    np.testing.assert_allclose(gram, columns.T @ columns, atol=1e-10)
    np.testing.assert_allclose(cross, columns.T @ output.ravel(), atol=1e-10)
    assert (square, number) == (pytest.approx(np.sum(output**2)), 800)
