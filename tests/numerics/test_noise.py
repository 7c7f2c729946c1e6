import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from tvsysid.numerics import noise
from tvsysid.numerics.differentiation import derivative_weights

DECAY = 0.6
FILTERS = derivative_weights(4)


def covariances_of(filters, angle, lags):
    return noise.regressor_covariances(filters, noise.angle_products(angle, filters.shape[1], lags))


def coloured(random, shape, decay=DECAY):
    """First-order autoregressive noise of unit variance, started in its stationary state."""
    white = np.sqrt(1 - decay**2) * random.normal(size=shape)
    white[:, 0] /= np.sqrt(1 - decay**2)
    return lfilter([1.0], [1.0, -decay], white, axis=1)


@pytest.mark.parametrize("lags", [0, 3, 30])
def test_covariances_are_sums_of_products_over_all_samples(random, lags):
    x = random.normal(size=(3, 20))
    auto = noise.autocovariance(x, lags)
    assert auto.shape == (lags + 1,)
    for d in range(lags + 1):
        products = [x[r, i] * x[r, i + d] for r in range(3) for i in range(20 - d)]
        assert auto[d] == pytest.approx(np.sum(products) / 60, abs=1e-12)


@pytest.mark.parametrize("lags", [0, 3, 30])
def test_regressors_covariances_are_sums_of_products_over_all_samples(random, lags):
    angle = random.normal(size=(3, 40))
    found = covariances_of(FILTERS, angle, lags)
    signals = np.array(
        [[np.convolve(row, weights, mode="valid") for row in angle] for weights in FILTERS]
    )
    count = signals.shape[2]
    assert found.shape == (lags + 1, 3, 3)
    for d in range(lags + 1):
        expected = np.einsum(
            "jri,kri->jk", signals[:, :, : max(0, count - d)], signals[:, :, d:]
        ) / (3 * count)
        np.testing.assert_allclose(found[d], expected, atol=1e-12)


def test_an_angle_shorter_than_the_filters_is_continued(random):
    ramp = np.arange(6.0)[None] * [[1.0], [2.0]]
    regressors = covariances_of(FILTERS, ramp, 5)
    assert np.isfinite(regressors).all()
    slope = np.convolve(np.arange(9.0), FILTERS[1], mode="valid")[0]
    assert regressors[0, 1, 1] == pytest.approx((1 + 4) / 2 * slope**2, rel=1e-9)


def test_factors_are_those_of_the_dense_sandwich(random):
    correlation = np.r_[0.6 ** np.arange(12), np.zeros(290)]
    angle = np.cumsum(coloured(random, (2, 310), 0.9), axis=1)
    signals = np.array(
        [[np.convolve(row, weights, mode="valid") for row in angle] for weights in FILTERS]
    )
    dense = toeplitz(correlation)[: signals.shape[2], : signals.shape[2]]
    inverse = np.linalg.inv(np.einsum("jri,kri->jk", signals, signals))
    middle = np.einsum("jri,il,krl->jk", signals, dense, signals)
    expected = np.diag(inverse @ middle @ inverse) / np.diag(inverse)
    regressors = covariances_of(FILTERS, angle, 11)
    np.testing.assert_allclose(
        noise.colour_factors(regressors, correlation[:12]), expected, rtol=1e-6
    )


def test_regressor_correlation_is_what_a_fit_takes_from_the_residual(random):
    # White noise, two regressors: products of the residual at a distance are lowered by that much
    # in the mean.
    filters = derivative_weights(3)[:2]
    angle = coloured(random, (1, 2000), 0.9)
    correlation = noise.regressor_correlation(covariances_of(filters, angle, 5))
    assert correlation[0] == pytest.approx(1.0, abs=1e-9)
    regressors = np.stack([np.convolve(angle[0], row, mode="valid") for row in filters], axis=1)
    count = len(regressors)
    hat = regressors @ np.linalg.pinv(regressors)
    lowered = [np.trace(hat, d) / count for d in range(6)]
    np.testing.assert_allclose(2 / count * correlation, lowered, rtol=1e-6)


@pytest.mark.parametrize("band", [(0.0, 0.5), (0.0, 0.2), (0.1, 0.15)])
def test_power_in_a_band_is_the_mean_of_the_spectrum(band):
    frequencies = band[0] + (np.arange(20_000) + 0.5) / 20_000 * (band[1] - band[0])
    spectrum = (1 - 0.6**2) / (1 - 1.2 * np.cos(2 * np.pi * frequencies) + 0.6**2)
    assert noise.power_in_band(0.6 ** np.arange(60), *band) == pytest.approx(
        spectrum.mean(), rel=1e-6
    )
    assert noise.power_in_band(np.eye(9)[0], *band) == 1.0


def test_share_is_that_of_the_variance_of_a_fit(random):
    pole, length, rate = 0.8, 1100, 100.0
    torque = lfilter([1.0], [1.0, -pole], random.normal(size=(2000, length)), axis=1)[:, 100:]
    signal = lfilter([1.0], [1.0, -0.9], random.normal(size=(2000, length)), axis=1)[:, 100:]
    factor = np.einsum("rt,rt->r", torque, signal) / np.mean(np.einsum("rt,rt->r", signal, signal))
    white = torque.var() / np.mean(np.einsum("rt,rt->r", signal, signal))
    assert noise.white_share(torque, signal, rate, (0.0, 50.0)) == pytest.approx(
        white / factor.var(), rel=0.06
    )


def test_noise_that_the_signal_does_not_meet_is_worth_no_more_than_white(random):
    time = np.arange(300) / 100
    slow, fast = np.sin(2 * np.pi * 2 * time), np.sin(2 * np.pi * 15 * time)
    angle, torque = np.outer(random.normal(size=50), slow), np.outer(random.normal(size=50), fast)
    assert noise.white_share(torque, angle, 100.0, (0.0, 20.0)) == 1.0
    assert noise.white_share(angle, angle, 100.0, (0.0, 20.0)) < 0.1
