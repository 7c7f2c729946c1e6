"""A stretch is rectified at the recorded rate, and decimated after."""

import numpy as np
import pytest
from scipy.signal import firwin

from tvsysid.numerics.stretch import recorded_velocity, stretch


@pytest.mark.parametrize(("rate", "ratio"), [(100.0, 10), (100.0, 1), (200.0, 2)])
def test_velocity_of_a_sine(rate, ratio):
    phase = 8 * np.pi * np.arange(400 * ratio) / (rate * ratio)
    found = recorded_velocity(np.sin(phase).reshape(1, -1, ratio), rate)[0] / (8 * np.pi)
    inner = slice(20 * ratio, -20 * ratio)
    np.testing.assert_allclose(found[inner], np.cos(phase[inner]), atol=2e-3)


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("threshold", [0.0, 0.7])
def test_equals_the_plain_computation(random, direction, threshold):
    velocity = random.normal(size=(3, 500))
    found = stretch(velocity, 10, threshold, direction)
    assert found.shape == (3, 50)
    for row, result in zip(velocity, found, strict=True):
        beyond = direction * np.maximum(direction * row - threshold, 0.0)
        expected = np.convolve(beyond, firwin(31, 0.1), mode="valid")[5::10]
        np.testing.assert_allclose(result[2 : 2 + len(expected)], expected, atol=1e-12)
