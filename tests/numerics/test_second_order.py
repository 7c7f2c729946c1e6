import numpy as np
import pytest

from tvsysid.numerics import moments, pseudoinverse, second_order
from tvsysid.numerics.differentiation import derivative_filters, differentiate

LAGS, RATE = 6, 100.0


@pytest.fixture
def joint(random):
    """Angle and torque of a joint of second order with noise, and the angle's derivatives."""
    angle = np.cumsum(random.normal(size=(60, 60)), axis=1) / 100
    signals = differentiate(angle, RATE, LAGS)
    torque = np.pad(np.einsum("m,mrt->rt", [80.0, 2.0, 0.02], signals), ((0, 0), (LAGS, LAGS)))
    return angle, torque + 0.01 * random.normal(size=torque.shape), signals


def test_fit_to_a_full_response_is_least_squares_on_the_derivatives(joint):
    angle, torque, signals = joint
    phi_uu, phi_uy, _, _ = moments.lagged_moments(angle, torque, LAGS)
    solution = pseudoinverse.full(phi_uu, phi_uy)
    fit = second_order.second_order_readout(phi_uu, phi_uy, solution.area, RATE)
    for time in (0, 20, 47):
        found = fit.readout[time] @ phi_uy[time]
        fitted = fit.impedance[time] @ derivative_filters(LAGS, RATE) @ phi_uy[time]
        assert found[0] == pytest.approx(solution.weights[time].sum(), rel=1e-9)
        regressors, output = signals[:, :, time].T, torque[:, LAGS + time]
        expected = np.linalg.lstsq(regressors, output, rcond=None)[0]
        np.testing.assert_allclose(found[1:], expected[1:], rtol=1e-6)
        assert fitted == pytest.approx(np.mean((regressors @ expected) ** 2), rel=1e-6)
        inputs = angle[:, time : time + 2 * LAGS + 1]
        left = output - regressors @ expected
        explained = inputs @ np.linalg.lstsq(inputs, left, rcond=None)[0]
        assert solution.explained[time] - fitted == pytest.approx(np.mean(explained**2), rel=1e-4)


def test_second_order_fit(random):
    regressors = random.normal(size=(5, 40, 3)) * [1e-3, 1e-1, 10.0]
    expected = np.array([100.0, 2.0, 0.02])
    moments = regressors.transpose(0, 2, 1) @ regressors
    cross = (regressors.transpose(0, 2, 1) @ (regressors @ expected)[..., None])[..., 0]
    found, inverse = second_order.second_order_fit(moments, cross)
    np.testing.assert_allclose(found, np.tile(expected, (5, 1)), rtol=1e-9)
    np.testing.assert_allclose(inverse @ moments, np.tile(np.eye(3), (5, 1, 1)), atol=1e-7)
    moments[2, 2], moments[2, :, 2] = moments[2, 0], moments[2, :, 0]
    assert np.isnan(second_order.second_order_fit(moments, cross)[0][2]).all()


def test_agreement():
    assert second_order.agreement(8.0, 2.0, 1.0) == pytest.approx(90.0)
    assert second_order.agreement(8.0, 1.0, 2.0) == 100.0
    assert np.isnan(second_order.agreement(np.nan, 2.0, 1.0))
