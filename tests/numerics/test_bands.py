import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

import tvsysid as tv
from tvsysid.numerics import bands

many = np.full(200, np.inf)


@given(st.floats(0.01, 0.999), st.floats(1.0, 1e6))
def test_critical_value_is_students(level, freedom):
    value = float(bands.critical_value(level, np.array(freedom)))
    assert stats.t.cdf(value, freedom) - stats.t.cdf(-value, freedom) == pytest.approx(
        level, abs=1e-6
    )


@pytest.mark.parametrize("level", [0.0, 1.0, -0.5, 95, np.nan, True, "wide"])
def test_a_level_is_a_probability(level):
    for function in (
        bands.critical_value,
        lambda level, freedom: bands.simultaneous_value(level, freedom, 1.0),
    ):
        with pytest.raises(tv.InputError, match="level: expected a probability"):
            function(level, many)


def test_independent_times_are_covered_together_exactly(random):
    value = bands.simultaneous_value(0.9, many, np.inf)[0]
    assert stats.norm.cdf(value) - stats.norm.cdf(-value) == pytest.approx(0.9 ** (1 / 200))


def test_an_estimate_that_does_not_move_needs_no_more_than_one_time():
    freedom = np.full(50, 12.0)
    np.testing.assert_allclose(
        bands.simultaneous_value(0.95, freedom, 0.0), bands.critical_value(0.95, freedom), rtol=1e-9
    )


def test_a_smooth_estimate_is_covered_together(random):
    basis = tv.CubicBSplines(10)(np.linspace(0, 1, 200))
    covariance = np.diag(np.linspace(1.0, 3.0, 10)) + 0.2
    arc = bands.arc_length(basis, covariance)
    draws = random.multivariate_normal(np.zeros(10), covariance, 20_000) @ basis.T
    deviation = np.sqrt(np.einsum("tj,jk,tk->t", basis, covariance, basis))
    value = bands.simultaneous_value(0.95, many, arc)[0]
    assert value < bands.simultaneous_value(0.95, many, np.inf)[0] - 0.3
    # The tube's volume is exact but for tubes that overlap: on the safe side, and by little.
    assert 0.95 <= np.mean(np.abs(draws / deviation).max(axis=1) < value) < 0.965
