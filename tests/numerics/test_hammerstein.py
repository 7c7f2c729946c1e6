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
    products, columns = hammerstein.lagged_products((signals, output)), lagged(signals, 30)
    np.testing.assert_allclose(
        products.gram, np.einsum("nki,nlj->kilj", columns, columns), atol=1e-10
    )
    np.testing.assert_allclose(
        products.cross, np.einsum("nki,n->ki", columns, output.ravel()), atol=1e-10
    )
    assert (products.square, products.samples) == (pytest.approx(np.sum(output**2)), 800)


@pytest.mark.parametrize("method", ["sls", "hk"])
def test_a_static_function_and_its_response_are_found_from_noiseless_data(signals, method):
    # A response that a filter can undo.
    coefficients, weights = np.array([1.0, 0.5, -0.3]), 0.6 ** np.arange(31)
    output = (lagged(signals, 30) @ weights @ coefficients).reshape(4, -1)
    products, start = hammerstein.lagged_products((signals, output)), np.array([1.0, 0.0, 0.0])
    if method == "sls":
        found, response = hammerstein.separable_least_squares(products, start)
    else:
        found, response = hammerstein.hunter_korenberg(
            products, [(signals[:, :, 30:], output)], start
        )
    np.testing.assert_allclose(
        np.outer(found, response), np.outer(coefficients, weights), atol=2e-3
    )


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_separable_least_squares_end_in_the_same_minimum_from_any_start(signals, random, noise):
    coefficients, weights = np.array([1.0, 0.5, -0.3]), 0.6 ** np.arange(31)
    output = (lagged(signals, 30) @ weights @ coefficients).reshape(4, -1)
    noisy = output + noise * random.normal(size=output.shape)
    products = hammerstein.lagged_products((signals, noisy))
    found, _ = hammerstein.separable_least_squares(products, coefficients)
    for start in [*np.eye(3), *random.normal(size=(5, 3))]:
        other, _ = hammerstein.separable_least_squares(products, start)
        np.testing.assert_allclose(other * np.sign(other @ found), found, atol=1e-6)


def test_two_pathways_that_do_not_overlap_are_told_apart(random, monkeypatch):
    monkeypatch.setattr(hammerstein, "LEAST_GAIN", 1e-14)
    angle, drive = random.normal(size=(2, 4, 2050))
    near, late = np.array([1.0, -3.0, 5.0, 2.0, 0.5]), np.r_[np.zeros(6), 0.8 ** np.arange(45)]
    signals = np.stack([angle, drive])
    output = (
        lagged(signals[:1], 50)[:, 0, :5] @ near + lagged(signals[1:], 50)[:, 0] @ late
    ).reshape(4, -1)
    found = hammerstein.parallel_cascade([(signals, output)], 2, np.ones(1), "rectifier")
    np.testing.assert_allclose(found.intrinsic.weights, near, atol=1e-3)
    np.testing.assert_allclose(found.reflex, late, atol=1e-3)
    assert found.explained > 1 - 1e-6
    # In pieces of a record, of which some have less behind them, it is the same.
    cut = [(signals[:, :1], output[:1]), (signals[:, 1:, 500:], output[1:, 500:])]
    again = hammerstein.parallel_cascade(cut, 2, np.ones(1), "rectifier")
    np.testing.assert_allclose(again.intrinsic.weights, found.intrinsic.weights, atol=2e-3)
