import numpy as np
import pytest

from tvsysid.numerics.differentiation import differentiate


@pytest.mark.parametrize("rate", [100.0, 128.0, 1000.0])
@pytest.mark.parametrize("share", [0.01, 0.1, 0.5, 0.8])
def test_sinusoids_are_differentiated_up_to_most_of_the_band(rate, share):
    omega = np.pi * rate * share
    time = np.arange(300) / rate
    signal, first, second = differentiate(np.sin(omega * time)[None], rate)[:, 0]
    inner = time[12:-12]
    np.testing.assert_array_equal(signal, np.sin(omega * time)[12:-12])
    np.testing.assert_allclose(first, omega * np.cos(omega * inner), atol=2e-3 * omega)
    np.testing.assert_allclose(second, -(omega**2) * np.sin(omega * inner), atol=2e-3 * omega**2)


def test_an_offset_has_no_derivative():
    np.testing.assert_allclose(differentiate(np.full((1, 50), 7.0), 100.0)[1:], 0, atol=1e-8)
