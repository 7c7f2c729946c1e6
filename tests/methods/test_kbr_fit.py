"""Fits of kernel-based regression: the noise variance and instruments."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.numerics.test_gaussian import moments_of, proper_problem

from tvsysid.methods.kbr.kbr import fit
from tvsysid.numerics.gaussian import solve


@given(seed=st.integers(0, 10**6))
def test_the_noise_variance_is_that_of_the_residual(seed):
    columns, output, precision = proper_problem(seed)
    found = fit(moments_of(columns, output), precision)
    residual = output - columns @ found.mean
    shown = residual @ residual / (len(output) - found.effective)
    assert found.noise_variance == pytest.approx(shown, rel=1e-4)
    expected = solve(moments_of(columns, output), precision, found.noise_variance)
    np.testing.assert_allclose(found.mean, expected.mean)
    np.testing.assert_allclose(found.covariance, expected.covariance)


def test_the_instrumental_fit_equals_its_equations(random):
    x, noise = random.standard_normal((400, 3)) * [1, 100, 0.01], random.standard_normal(400)
    z = x + 0.3 * random.standard_normal((400, 3)) * [1, 100, 0.01]
    y = x @ [2, 0.03, 150] + noise
    precision = np.array([0.0, 1e3, 1e-3])
    found = fit(moments_of(np.hstack([x, z]), y), precision)
    p, s = np.diag(precision), found.noise_variance
    inverse = np.linalg.inv(z.T @ x + s * p)
    np.testing.assert_allclose(found.mean, inverse @ z.T @ y, rtol=1e-9)
    left = y - x @ found.mean
    assert s == pytest.approx(left @ left / (400 - found.effective), rel=1e-4)
    np.testing.assert_allclose(found.covariance, s * inverse @ (z.T @ z + s * p) @ inverse.T)
