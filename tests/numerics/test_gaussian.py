import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from tvsysid.numerics.gaussian import PRIORS, Moments, least_squares, relevance, ridge, solve


def moments_of(columns, output):
    return Moments(columns.T @ columns, columns.T @ output, float(output @ output), len(output))


def proper_problem(seed, rows=60, count=7):
    """Return columns of very different size, output, and prior precisions; two are flat."""
    random = np.random.default_rng(seed)
    columns = random.normal(size=(rows, count)) * 10 ** random.uniform(-1, 1, count)
    precision = 10 ** random.uniform(-2, 3, count)
    precision[:2] = 0
    weights = random.normal(size=count) / np.sqrt(np.maximum(precision, 1.0))
    noise = 10 ** random.uniform(-2, 1) * random.normal(size=rows)
    return columns, columns @ weights + noise, precision


def log_density(columns, output, precision, noise):
    """Return the restricted log density of an output whose covariance is dense."""
    flat, proper = columns[:, precision == 0], columns[:, precision > 0]
    covariance = noise * np.eye(len(output)) + proper / precision[precision > 0] @ proper.T
    inverse = np.linalg.inv(covariance)
    information = flat.T @ inverse @ flat
    projected = inverse - inverse @ flat @ np.linalg.solve(information, flat.T @ inverse)
    determinants = (
        np.linalg.slogdet(2 * np.pi * covariance)[1]
        + np.linalg.slogdet(information / (2 * np.pi))[1]
    )
    return -0.5 * (determinants + output @ projected @ output)


@given(seed=st.integers(0, 10**6), noise=st.floats(0.01, 10.0))
def test_the_posterior_and_its_evidence_are_those_of_dense_matrices(seed, noise):
    columns, output, precision = proper_problem(seed)
    found = solve(moments_of(columns, output), precision, noise)
    covariance = np.linalg.inv(columns.T @ columns / noise + np.diag(precision))
    mean = covariance @ columns.T @ output / noise
    spread = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose((found.mean - mean) / spread, 0, atol=1e-6)
    np.testing.assert_allclose(
        found.covariance / np.outer(spread, spread),
        covariance / np.outer(spread, spread),
        atol=1e-6,
    )
    residual = np.sum((output - columns @ mean) ** 2)
    assert found.residual == pytest.approx(residual, rel=1e-6)
    assert found.effective == pytest.approx(
        np.trace(covariance @ columns.T @ columns) / noise, rel=1e-6
    )
    expected = log_density(columns, output, precision, noise)
    assert found.log_evidence == pytest.approx(expected, rel=1e-6, abs=1e-6)


@given(seed=st.integers(0, 10**6), noise=st.floats(0.1, 10.0))
def test_the_derivatives_of_the_evidence_are_those_of_differences(seed, noise):
    columns, output, precision = proper_problem(seed)
    moments = moments_of(columns, output)
    found = solve(moments, precision, noise)

    def evidence(by):
        return solve(moments, precision * np.exp(-by[1:]), noise * np.exp(by[0])).log_evidence

    steps = 1e-3 * np.eye(1 + len(precision))
    differences = [(evidence(each) - evidence(-each)) / 2e-3 for each in steps]
    tolerance = 1e-7 * max(1.0, abs(found.log_evidence))
    slopes = [found.noise_gradient, *found.variance_gradient]
    np.testing.assert_allclose(slopes, differences, rtol=1e-5, atol=tolerance)
    assert not found.variance_gradient[:2].any()


def test_a_column_of_zeros_keeps_its_prior():
    columns, output, precision = proper_problem(3)
    columns[:, 4] = 0
    found = solve(moments_of(columns, output), precision, 0.5)
    assert found.mean[4] == 0
    assert found.covariance[4, 4] == pytest.approx(1 / precision[4])
    assert found.determined[4] == pytest.approx(0)


@pytest.fixture
def problem(random):
    columns = random.normal(size=(400, 8)) * np.array([1, 1, 1, 1, 1, 1, 1, 10.0])
    weights = np.array([3.0, -2.0, 0.0, 1.0, 0.0, 0.0, 0.5, 0.2])
    return columns, columns @ weights + 0.7 * random.normal(size=400), weights


def test_least_squares_equals_the_library(problem):
    columns, output, _ = problem
    found = least_squares(moments_of(columns, output))
    np.testing.assert_allclose(found.mean, np.linalg.lstsq(columns, output, rcond=None)[0])
    noise = np.sum((output - columns @ found.mean) ** 2) / (400 - 8)
    assert found.noise_variance == pytest.approx(noise)
    np.testing.assert_allclose(found.covariance, noise * np.linalg.inv(columns.T @ columns))
    double = np.concatenate([columns[:, :3], columns[:, :3]], axis=1)
    found = least_squares(moments_of(double, output))
    np.testing.assert_allclose(found.mean, np.linalg.pinv(double) @ output, atol=1e-9)
    assert found.effective == 3


def best_evidence(columns, output, precision, noise):
    """Return the largest log density near a precision for all columns, or one for each."""
    each = np.ones(columns.shape[1])
    best = minimize(
        lambda x: -log_density(columns, output, each * np.exp(x[:-1]), np.exp(x[-1])),
        np.log([*precision, noise]),
        method="L-BFGS-B",
    )
    return -best.fun


@pytest.mark.slow
def test_ridge_maximises_the_evidence(problem):
    columns, output, _ = problem
    found = ridge(moments_of(columns, output))
    alpha = found.effective / float(found.mean @ found.mean)
    best = best_evidence(columns, output, [alpha], found.noise_variance)
    assert found.log_evidence == pytest.approx(best, abs=1e-6)
    expected = solve(moments_of(columns, output), np.full(8, alpha), found.noise_variance)
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-5, atol=1e-10)
    np.testing.assert_allclose(found.mean, expected.mean, rtol=1e-6)


def test_relevance_prunes_what_explains_nothing_and_maximises_the_evidence(problem):
    columns, output, weights = problem
    found = relevance(moments_of(columns, output))
    np.testing.assert_allclose(found.mean, weights, atol=0.15)
    assert found.effective < 8
    assert np.abs(found.mean[weights == 0]).max() < 0.1
    assert found.log_evidence > ridge(moments_of(columns, output)).log_evidence
    # No other precisions have more evidence, but for the tolerance of the iterations.
    kept = np.diag(found.covariance) > 0
    best = best_evidence(columns[:, kept], output, found.mean[kept] ** -2.0, found.noise_variance)
    assert found.log_evidence == pytest.approx(best, abs=0.02)


@pytest.mark.parametrize("prior", PRIORS)
def test_noiseless_data_are_fitted(prior, problem):
    columns, _, weights = problem
    found = PRIORS[prior](moments_of(columns, columns @ weights))
    np.testing.assert_allclose(found.mean, weights, atol=1e-4)
