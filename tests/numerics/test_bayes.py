import numpy as np
import pytest
from scipy.optimize import minimize

from tvsysid.numerics import bayes


def statistics(regressor, output):
    return regressor.T @ regressor, regressor.T @ output, float(output @ output), len(output)


@pytest.fixture
def problem(random):
    regressor = random.normal(size=(400, 8)) * np.array([1, 1, 1, 1, 1, 1, 1, 10.0])
    weights = np.array([3.0, -2.0, 0.0, 1.0, 0.0, 0.0, 0.5, 0.2])
    return regressor, regressor @ weights + 0.7 * random.normal(size=400), weights


def log_evidence(log_alpha, log_beta, regressor, output):
    """Log density of the output, whose covariance is dense."""
    covariance = regressor / np.exp(log_alpha) @ regressor.T + np.eye(len(output)) * np.exp(
        -log_beta
    )
    _, determinant = np.linalg.slogdet(covariance)
    return -0.5 * (
        output @ np.linalg.solve(covariance, output) + determinant + len(output) * np.log(2 * np.pi)
    )


def test_least_squares_equals_the_library(problem):
    regressor, output, _ = problem
    posterior = bayes.least_squares(*statistics(regressor, output))
    np.testing.assert_allclose(posterior.mean, np.linalg.lstsq(regressor, output, rcond=None)[0])
    noise = np.sum((output - regressor @ posterior.mean) ** 2) / (400 - 8)
    assert posterior.noise_variance == pytest.approx(noise)
    np.testing.assert_allclose(posterior.covariance, noise * np.linalg.inv(regressor.T @ regressor))


def test_least_squares_takes_the_minimum_norm_where_columns_are_alike(problem):
    regressor, output, _ = problem
    double = np.concatenate([regressor[:, :3], regressor[:, :3]], axis=1)
    posterior = bayes.least_squares(*statistics(double, output))
    expected = np.linalg.pinv(double) @ output
    np.testing.assert_allclose(posterior.mean, expected, atol=1e-9)
    assert posterior.effective == 3


@pytest.mark.slow
def test_ridge_maximises_the_evidence(problem):
    regressor, output, _ = problem
    posterior = bayes.ridge(*statistics(regressor, output))
    alpha = posterior.effective / float(posterior.mean @ posterior.mean)
    best = minimize(
        lambda x: -log_evidence(np.full(8, x[0]), x[1], regressor, output),
        [np.log(alpha), -np.log(posterior.noise_variance)],
    )
    assert posterior.log_evidence == pytest.approx(-best.fun, abs=1e-6)
    assert posterior.noise_variance == pytest.approx(np.exp(-best.x[1]), rel=1e-3)
    assert posterior.converged
    beta = 1 / posterior.noise_variance
    expected = np.linalg.inv(alpha * np.eye(8) + beta * regressor.T @ regressor)
    np.testing.assert_allclose(posterior.covariance, expected, rtol=1e-5, atol=1e-10)
    np.testing.assert_allclose(posterior.mean, beta * expected @ regressor.T @ output, rtol=1e-6)


def test_relevance_prunes_what_explains_nothing_and_maximises_the_evidence(problem):
    regressor, output, weights = problem
    posterior = bayes.relevance(*statistics(regressor, output))
    assert posterior.converged
    np.testing.assert_allclose(posterior.mean, weights, atol=0.15)
    relevant = np.abs(weights) > 0
    assert posterior.effective < 8
    assert np.abs(posterior.mean[~relevant]).max() < 0.1
    # No other precisions explain the output better by more than the tolerance of the iterations
    # allows.
    assert posterior.log_evidence > bayes.ridge(*statistics(regressor, output)).log_evidence
    kept = np.diag(posterior.covariance) > 0
    sub = regressor[:, kept]
    best = minimize(
        lambda x: -log_evidence(x[:-1], x[-1], sub, output),
        np.append(-2 * np.log(np.abs(posterior.mean[kept])), -np.log(posterior.noise_variance)),
        method="L-BFGS-B",
    )
    assert posterior.log_evidence == pytest.approx(-best.fun, abs=0.02)


def test_relevance_does_not_depend_on_units(problem):
    regressor, output, _ = problem
    units = np.array([1e-3, 1e3, 1, 5, 1, 1e-6, 7, 1])
    plain = bayes.relevance(*statistics(regressor, output))
    scaled = bayes.relevance(*statistics(regressor / units, output * 1e3))
    np.testing.assert_allclose(scaled.mean, plain.mean * units * 1e3, rtol=1e-6)
    assert scaled.noise_variance == pytest.approx(plain.noise_variance * 1e6, rel=1e-6)
    assert scaled.log_evidence == pytest.approx(plain.log_evidence - 400 * np.log(1e3), rel=1e-8)


@pytest.mark.parametrize("prior", ["ard", "ridge", "none"])
def test_noiseless_data_are_fitted(prior, problem):
    regressor, _, weights = problem
    posterior = bayes.PRIORS[prior](*statistics(regressor, regressor @ weights))
    np.testing.assert_allclose(posterior.mean, weights, atol=1e-4)


def test_relevance_of_nothing_is_nothing(random):
    regressor = random.normal(size=(2000, 5))
    posterior = bayes.relevance(*statistics(regressor, random.normal(size=2000)))
    assert np.abs(posterior.mean).max() < 0.1
    assert posterior.noise_variance == pytest.approx(1.0, rel=0.1)


def test_columns_alike_do_not_stop_it(problem):
    regressor, output, _ = problem
    double = np.concatenate([regressor, regressor[:, :2]], axis=1)
    posterior = bayes.relevance(*statistics(double, output))
    fit = bayes.relevance(*statistics(regressor, output))
    np.testing.assert_allclose(double @ posterior.mean, regressor @ fit.mean, atol=0.05)
