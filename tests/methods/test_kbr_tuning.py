"""Settings of kernel-based regression that are chosen by marginal likelihood."""

import math

import numpy as np
import pytest
from benchmarks import plain
from tests.conftest import ensemble_of, realizations

import tvsysid as tv
from tvsysid.methods.kbr.kernel import Kernel
from tvsysid.methods.kbr.search import Likelihood
from tvsysid.numerics.differentiation import differentiate

pytestmark = pytest.mark.filterwarnings("ignore::tvsysid.DataQualityWarning")


def dense_model(ensemble, theta, decay):
    """Return the covariance of the band's Fourier coefficients, the fixed part, and the output.

    The coefficients are real and imaginary parts. The fixed part has no prior.
    """
    l1, *variances, noise = np.exp(theta)
    signals = differentiate(plain.join(ensemble.angle, ensemble.context, 12), 100.0)
    torque = plain.join(ensemble.torque, ensemble.context)
    count = len(torque)
    frequency = np.fft.rfftfreq(count, 1 / 100.0)
    inside = frequency <= 20.0 + 1e-9
    apart = np.subtract.outer(np.arange(count), np.arange(count)) / 100.0
    kernel = np.exp(-(np.sin(np.pi * apart / 2.0) ** 2) / l1 - (apart / decay) ** 2)
    place = (np.arange(count) + 0.5) / count
    external = np.cos(np.pi * np.outer(np.arange(5), place))
    changing = sum(
        each * kernel * np.outer(signal, signal)
        for each, signal in zip(variances, signals, strict=True)
    )

    def in_band(covariance):
        return plain._fourier(plain._fourier(covariance, inside).T, inside)

    covariance = in_band(changing)
    covariance += noise * np.eye(len(covariance))
    fixed = plain._fourier(np.concatenate([signals, external]), inside).T
    return covariance, fixed, plain._fourier(torque, inside)


def dense_log_density(ensemble, theta, decay):
    """Return the restricted log density of the band's Fourier coefficients, but for a constant.

    The kernel is dense.
    """
    covariance, fixed, output = dense_model(ensemble, theta, decay)
    inverse = np.linalg.inv(covariance)
    information = fixed.T @ inverse @ fixed
    projected = inverse - inverse @ fixed @ np.linalg.solve(information, fixed.T @ inverse)
    determinants = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(information)[1]
    return -0.5 * determinants - output @ projected @ output


@pytest.mark.slow
@pytest.mark.parametrize("decay", [math.inf, 15.0])
def test_marginal_likelihood_is_that_of_the_dense_kernel(decay):
    ensemble = ensemble_of(12.0, "sine", "noise")
    likelihood = Likelihood.of(ensemble, Kernel.of(ensemble, 0.05, decay), (0.0, 20.0), 1.0)
    one = np.log([0.3, 1600.0, 0.3, 3e-5, 0.15])
    other = np.log([0.1, 650.0, 3.0, 3e-4, 0.2])
    found = likelihood(one)[0] - likelihood(other)[0]
    expected = dense_log_density(ensemble, one, decay) - dense_log_density(ensemble, other, decay)
    assert found == pytest.approx(expected, abs=1e-3)
    # Its slope is that of differences.
    _, slope = likelihood(one)
    for number in range(5):
        step = 1e-4 * (np.arange(5) == number)
        difference = (likelihood(one + step)[0] - likelihood(one - step)[0]) / 2e-4
        assert slope[number] == pytest.approx(difference, rel=1e-4, abs=1e-3)


@pytest.mark.slow
def test_a_drift_asks_for_a_decay_which_follows_it():
    def profile(time):
        return 100 + 30 * np.sin(np.pi * time) + 0.8 * time

    simulation = tv.simulate.Joint(stiffness=profile).simulate(
        60, perturbation=tv.simulate.FilteredNoise(), snr_db=20, seed=1
    )
    ensemble = realizations(simulation.recording)
    truth = np.stack([profile(onset + ensemble.time) for onset in ensemble.onsets])
    tuned = tv.KernelRegression().tuned(ensemble).method
    assert tuned.length_decay < 300
    model = tuned.identify(ensemble)
    stiffness = model.impedance(ensemble)[..., 0]
    assert np.sqrt(np.mean((stiffness - truth) ** 2)) < 2.5
    np.testing.assert_allclose(model.stiffness, stiffness.mean(axis=0), rtol=1e-9)
    strict = tv.KernelRegression().identify(ensemble)
    assert np.sqrt(np.mean((strict.stiffness - truth) ** 2)) > 5
