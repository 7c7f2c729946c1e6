import numpy as np
import pytest

from tvsysid.numerics import bases

ALL = [
    bases.CubicBSplines(10),
    bases.CubicBSplines(4),
    bases.CubicBSplines(10, periodic=True),
    bases.GaussianBumps(10),
    bases.HaarWavelets(16),
    bases.HaarWavelets(5),
    bases.FourierSeries(4),
    bases.ChebyshevPolynomials(10),
]


@pytest.mark.parametrize("basis", ALL, ids=repr)
def test_functions_are_independent(basis):
    values = bases.evaluate(basis, 200)
    assert values.shape[0] == 200
    assert np.linalg.matrix_rank(values) == values.shape[1]


@pytest.mark.parametrize("periodic", [False, True])
def test_splines_sum_to_one_and_are_smooth(periodic):
    values = bases.CubicBSplines(10, periodic)(np.linspace(0, 0.9999, 2000))
    np.testing.assert_allclose(values.sum(axis=1), 1.0)
    assert values.min() >= 0
    assert np.abs(np.diff(values, 2, axis=0)).max() < 1e-3


@pytest.mark.parametrize(
    "basis", [basis for basis in ALL if getattr(basis, "periodic", False)], ids=repr
)
def test_periodic_functions_join(basis):
    np.testing.assert_allclose(
        basis(np.array([1.0, 1.25])), basis(np.array([0.0, 0.25])), atol=1e-12
    )


@pytest.mark.parametrize("basis", [bases.HaarWavelets(16), bases.FourierSeries(5)])
def test_orthonormal_bases_are(basis):
    values = basis(np.arange(1024) / 1024)
    np.testing.assert_allclose(values.T @ values / 1024, np.eye(values.shape[1]), atol=1e-12)
