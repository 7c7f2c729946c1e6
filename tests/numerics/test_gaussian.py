import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tvsysid.numerics import gaussian


def problem(seed, rows=60, columns=7, terms=3):
    """Regressors X, orthogonal nuisance terms T, output, and prior precisions of X's columns.

    Two have none.
    """
    random = np.random.default_rng(seed)
    regressors = random.normal(size=(rows, columns)) * 10 ** random.uniform(-1, 1, columns)
    nuisance = np.linalg.qr(random.normal(size=(rows, terms)))[0] * random.uniform(0.5, 5, terms)
    precision = 10 ** random.uniform(-2, 3, columns)
    precision[:2] = 0
    weights = random.normal(size=columns) / np.sqrt(np.maximum(precision, 1.0))
    output = (
        regressors @ weights
        + nuisance @ random.normal(size=terms)
        + 10 ** random.uniform(-2, 1) * random.normal(size=rows)
    )
    return regressors, nuisance, output, precision


def statistics_of(regressors, nuisance, output):
    return gaussian.Statistics(
        gram=np.asfortranarray(np.tril(regressors.T @ regressors)),
        cross=regressors.T @ output,
        square=float(output @ output),
        number=len(output),
        mixed=regressors.T @ nuisance,
        shared=nuisance.T @ output,
        powers=np.sum(nuisance**2, axis=0),
    )


def dense(regressors, nuisance, output, precision, weak, noise):
    """Solve for weights and nuisance terms jointly.

    Return mean, covariance, residual, and effective number of parameters.
    """
    both = np.concatenate([regressors, nuisance], axis=1)
    prior = np.concatenate([precision, np.full(nuisance.shape[1], weak)])
    inverse = np.linalg.inv(both.T @ both + noise * np.diag(prior))
    mean = inverse @ (both.T @ output)
    return mean, 0.5 * noise * inverse, output - both @ mean, np.trace(inverse @ both.T @ both)


@given(seed=st.integers(0, 10**6), weak=st.floats(1e-3, 10.0))
def test_the_fit_is_the_joint_one_at_a_noise_variance_that_its_residual_shows(seed, weak):
    regressors, nuisance, output, precision = problem(seed)
    found = gaussian.fit(statistics_of(regressors, nuisance, output), precision, weak)
    mean, covariance, residual, effective = dense(
        regressors, nuisance, output, precision, weak, found.noise_variance
    )
    columns = len(precision)
    spread = np.sqrt(np.diag(covariance))[:columns]
    assert np.abs((found.mean - mean[:columns]) / spread).max() < 1e-4
    np.testing.assert_allclose(
        found.covariance / np.outer(spread, spread),
        covariance[:columns, :columns] / np.outer(spread, spread),
        atol=0.01,
    )
    assert found.effective == pytest.approx(effective, rel=2e-3)
    assert found.noise_variance == pytest.approx(
        2 * residual @ residual / (len(output) - effective), rel=1e-4
    )


def test_columns_without_power_keep_their_prior():
    regressors, nuisance, output, precision = problem(3)
    regressors[:, 4] = 0
    found = gaussian.fit(statistics_of(regressors, nuisance, output), precision, 1.0)
    assert found.mean[4] == 0
    assert found.covariance[4, 4] == pytest.approx(0.5 / precision[4], rel=2e-3)


def test_noiseless_output_is_reproduced():
    regressors, nuisance, _, precision = problem(5)
    weights = np.arange(1.0, 8.0)
    found = gaussian.fit(
        statistics_of(regressors, nuisance, regressors @ weights), 0 * precision, 1.0
    )
    np.testing.assert_allclose(found.mean, weights, rtol=1e-5)


def log_density(regressors, nuisance, output, precision, weak, noise):
    """Restricted log density, with the dense covariance of the output."""
    fixed = regressors[:, precision == 0]
    proper = regressors[:, precision > 0]
    covariance = 0.5 * (
        noise * np.eye(len(output))
        + proper / precision[precision > 0] @ proper.T
        + nuisance @ nuisance.T / weak
    )
    inverse = np.linalg.inv(covariance)
    information = fixed.T @ inverse @ fixed
    projected = inverse - inverse @ fixed @ np.linalg.solve(information, fixed.T @ inverse)
    determinants = (
        np.linalg.slogdet(2 * np.pi * covariance)[1]
        + np.linalg.slogdet(information / (2 * np.pi))[1]
    )
    return -0.5 * (determinants + output @ projected @ output)


@given(seed=st.integers(0, 10**6), weak=st.floats(1e-2, 10.0), noise=st.floats(0.01, 10.0))
def test_evidence_is_the_log_density_of_the_data(seed, weak, noise):
    regressors, nuisance, output, precision = problem(seed)
    statistics = statistics_of(regressors, nuisance, output)
    found = gaussian.log_evidence(statistics, precision, weak, noise)
    assert found.value == pytest.approx(
        log_density(regressors, nuisance, output, precision, weak, noise), rel=1e-6, abs=1e-6
    )


@given(seed=st.integers(0, 10**6), noise=st.floats(0.1, 10.0))
def test_derivatives_of_the_evidence_are_those_of_differences(seed, noise):
    regressors, nuisance, output, precision = problem(seed)
    statistics, step = statistics_of(regressors, nuisance, output), 1e-3

    def difference(change):
        values = [gaussian.log_evidence(statistics, *change(sign * step)).value for sign in (1, -1)]
        return (values[0] - values[1]) / (2 * step)

    found = gaussian.log_evidence(statistics, precision, 0.7, noise)
    size = max(1.0, abs(found.value))
    by_noise = difference(lambda by: (precision, 0.7, noise * np.exp(by)))
    assert found.by_noise == pytest.approx(by_noise, rel=1e-5, abs=1e-7 * size)
    for column in range(2, len(precision)):
        each = np.arange(len(precision)) == column
        by_variance = difference(lambda by, each=each: (precision * np.exp(-by * each), 0.7, noise))
        assert found.by_variances[column] == pytest.approx(by_variance, rel=1e-5, abs=1e-7 * size)
    assert not found.by_variances[:2].any()


def test_the_fit_is_where_the_evidence_of_the_noise_is_highest():
    regressors, nuisance, output, precision = problem(11)
    statistics = statistics_of(regressors, nuisance, output)
    noise = gaussian.fit(statistics, precision, 1.0).noise_variance
    best = gaussian.log_evidence(statistics, precision, 1.0, noise)
    assert abs(best.by_noise) < 1e-3
    assert best.value > max(
        gaussian.log_evidence(statistics, precision, 1.0, noise * by).value for by in (0.9, 1.1)
    )


def test_nuisance_terms_eliminated_once_are_those_of_a_prior_that_scales_with_the_noise():
    regressors, nuisance, output, precision = problem(4)
    weak, near = 0.6, 0.8
    once = gaussian.without_nuisance(statistics_of(regressors, nuisance, output), weak, near)
    constant = np.sum(np.log1p(np.sum(nuisance**2, axis=0) / (near * weak)))
    for noise in (0.5, near, 2.0):
        expected = log_density(regressors, nuisance, output, precision, weak * near / noise, noise)
        found = gaussian.log_evidence(once, precision, 1.0, noise).value
        assert found - 0.5 * constant == pytest.approx(expected, rel=1e-7)
