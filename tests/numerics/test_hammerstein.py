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


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_separable_least_squares_end_in_the_same_minimum_from_any_start(signals, random, noise):
    coefficients, weights = np.array([1.0, 0.5, -0.3]), 0.6 ** np.arange(31)
    output = (lagged(signals, 30) @ weights @ coefficients).reshape(4, -1)
    noisy = output + noise * random.normal(size=output.shape)
    products = hammerstein.lagged_moments([(signals, noisy)])
    found = hammerstein.static_function(products, coefficients)
    for start in [*np.eye(3), *random.normal(size=(5, 3))]:
        other = hammerstein.static_function(products, start)
        np.testing.assert_allclose(other * np.sign(other @ found), found, atol=1e-6)
    if not noise:
        np.testing.assert_allclose(found, coefficients / np.linalg.norm(coefficients), atol=1e-6)
