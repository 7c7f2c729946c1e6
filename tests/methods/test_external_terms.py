"""Fits beside a smooth external term, by the regressors or by instruments."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.numerics.test_gaussian import proper_problem

from tvsysid.methods.kbr.fit import fit
from tvsysid.methods.kbr.record import Sums


def sums_of(columns, terms, output, prior):
    powers = np.sum(terms**2, axis=0)
    whole = np.column_stack([columns, output])
    products = np.asfortranarray(np.tril(whole.T @ whole))
    return Sums(products, whole.T @ terms, powers, prior, len(output))


def problem_with_terms(seed):
    columns, output, precision = proper_problem(seed)
    random = np.random.default_rng(seed)
    orthonormal = np.linalg.qr(random.normal(size=(len(output), 3)))[0]
    terms = orthonormal * random.uniform(0.5, 5, 3)
    return columns, terms, output + terms @ random.normal(size=3), precision


@given(seed=st.integers(0, 10**6), prior=st.floats(1e-3, 10.0))
def test_the_fit_is_the_joint_one_at_the_noise_variance_of_its_residual(seed, prior):
    columns, terms, output, precision = problem_with_terms(seed)
    found = fit(sums_of(columns, terms, output, prior), precision)
    noise, count = found.noise_variance, len(precision)
    both = np.concatenate([columns, terms], axis=1)
    inverse = np.linalg.inv(both.T @ both + noise * np.diag([*precision, *[prior] * 3]))
    mean, covariance = inverse @ (both.T @ output), noise * inverse
    residual, effective = output - both @ mean, np.trace(inverse @ both.T @ both)
    spread = np.sqrt(np.diag(covariance))[:count]
    assert np.abs((found.mean - mean[:count]) / spread).max() < 1e-4
    np.testing.assert_allclose(
        found.covariance / np.outer(spread, spread),
        covariance[:count, :count] / np.outer(spread, spread),
        atol=0.01,
    )
    assert found.effective == pytest.approx(effective, rel=2e-3)
    shown = residual @ residual / (len(output) - effective)
    assert noise == pytest.approx(shown, rel=1e-4)


def test_the_instrumental_fit_equals_its_equations(random):
    x, noise = random.standard_normal((400, 3)) * [1, 100, 0.01], random.standard_normal(400)
    z = x + 0.3 * random.standard_normal((400, 3)) * [1, 100, 0.01]
    terms, _ = np.linalg.qr(random.standard_normal((400, 2)))
    y = x @ [2, 0.03, 150] + terms @ [3, -1] + noise
    precision, prior = np.array([0.0, 1e3, 1e-3]), 1e-2
    found = fit(sums_of(np.hstack([x, z]), terms, y, prior), precision)
    p, s = np.diag(precision), found.noise_variance
    project = np.eye(400) - terms @ terms.T / (1 + s * prior)
    inverse = np.linalg.inv(z.T @ project @ x + s * p)
    np.testing.assert_allclose(found.mean, inverse @ z.T @ project @ y, rtol=1e-3)
    left = y - x @ found.mean
    left -= terms @ (terms.T @ left) / (1 + s * prior)
    assert s == pytest.approx(left @ left / (400 - found.effective), rel=3e-3)
    covariance = s * inverse @ (z.T @ project @ z + s * p) @ inverse.T
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-2)
