import numpy as np
import pytest

from tvsysid.numerics import hammerstein


@pytest.fixture
def signals(random):
    return random.normal(size=(3, 4, 230))


def lagged(signals, before):
    """Regressor (sample, signal, lag), lag by lag."""
    times = signals.shape[2] - before
    columns = [
        signals[:, :, before - lag : before - lag + times].reshape(len(signals), -1)
        for lag in range(before + 1)
    ]
    return np.stack(columns, axis=1).transpose(2, 0, 1)


def test_lagged_products_are_those_of_the_lagged_signals(signals, random):
    output = random.normal(size=(4, 200))
    products, columns = hammerstein.lagged_moments([(signals, output)]), lagged(signals, 30)
    columns = columns.reshape(output.size, -1)
    np.testing.assert_allclose(products.gram, columns.T @ columns, atol=1e-10)
    np.testing.assert_allclose(products.cross, columns.T @ output.ravel(), atol=1e-10)
    assert (products.square, products.number) == (pytest.approx(np.sum(output**2)), 800)
