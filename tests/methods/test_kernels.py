import numpy as np
import pytest

from tvsysid.methods.kbr import kernel as kernels


def locally_periodic(time, other, period, l1, l2):
    difference = time[:, None] - other
    return np.exp(-(np.sin(np.pi * difference / period) ** 2) / l1 - (difference / l2) ** 2)


@pytest.mark.parametrize("l1", [np.exp(-2), np.exp(-1), 0.02, 3.0])
def test_harmonics_make_the_periodic_kernel(l1):
    time = np.linspace(0, 5, 80)
    variances = kernels.harmonic_variances(l1)
    assert variances.sum() == pytest.approx(1.0, abs=1e-7)
    features = kernels.Kernel.of(1.7, l1, np.inf, 0.0, 5.0, 1e3).periodic_features(time)
    each = np.concatenate([variances[:1], np.repeat(variances[1:], 2)])
    dense = locally_periodic(time, time, 1.7, l1, 1e12)
    np.testing.assert_allclose(features * each @ features.T, dense, atol=1e-7)


@pytest.mark.parametrize(("span", "l2"), [(40.0, 30.0), (40.0, 3.0), (10.0, 1000.0), (600.0, 30.0)])
def test_decay_features_make_the_decay(span, l2):
    time = np.linspace(5.0, 5.0 + span, 123)
    nodes, projection, _ = kernels.decay_features(5.0, span, l2)
    features = kernels.covariance(time, nodes, l2) @ projection
    dense = locally_periodic(time, time, 1.0, 1e12, l2)
    np.testing.assert_allclose(features @ features.T, dense, atol=1e-6)
