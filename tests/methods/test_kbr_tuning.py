"""Settings of kernel-based regression that are chosen by marginal likelihood."""

import functools
import math

import attrs
import numpy as np
import pytest
from benchmarks import plain
from scipy.signal import butter, lfilter
from tests.conftest import ensemble_of

import tvsysid as tv
from tvsysid.methods import tuning
from tvsysid.methods.kbr.record import Record
from tvsysid.methods.kbr.search import Likelihood
from tvsysid.numerics.differentiation import differentiate
from tvsysid.numerics.lowpass import low_pass

pytestmark = pytest.mark.filterwarnings("ignore::tvsysid.DataQualityWarning")
slow = pytest.mark.slow  # tuning a kernel takes several seconds


def dense_model(ensemble, theta, decay, near):
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
    smooth = np.mean(torque**2) * external.T @ external

    def in_band(covariance):
        return plain._fourier(plain._fourier(covariance, inside).T, inside)

    covariance = in_band(changing + noise / near * smooth)
    covariance += noise * np.eye(len(covariance))
    return covariance, plain._fourier(signals, inside).T, plain._fourier(torque, inside)


def dense_log_density(ensemble, theta, decay, near):
    """Return the restricted log density of the band's Fourier coefficients, but for a constant.

    The kernel is dense.
    """
    covariance, fixed, output = dense_model(ensemble, theta, decay, near)
    inverse = np.linalg.inv(covariance)
    information = fixed.T @ inverse @ fixed
    projected = inverse - inverse @ fixed @ np.linalg.solve(information, fixed.T @ inverse)
    determinants = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(information)[1]
    return -0.5 * determinants - output @ projected @ output


@pytest.mark.slow
@pytest.mark.parametrize("decay", [math.inf, 15.0])
def test_marginal_likelihood_is_that_of_the_dense_kernel(decay):
    ensemble = ensemble_of(12.0, "sine", "noise")
    record = Record.of(ensemble, (0.0, 20.0))
    kernel = record.kernel(2.0, 0.05, decay)
    likelihood = Likelihood.of(record, kernel, np.ones((3, kernel.columns), dtype=bool), 0.15)
    one = np.log([0.3, 1600.0, 0.3, 3e-5, 0.15])
    other = np.log([0.1, 650.0, 3.0, 3e-4, 0.2])
    found = likelihood(one)[0] - likelihood(other)[0]
    expected = dense_log_density(ensemble, one, decay, 0.15) - dense_log_density(
        ensemble, other, decay, 0.15
    )
    assert found == pytest.approx(expected, abs=1e-3)
    # Its slope is that of differences.
    _, slope = likelihood(one)
    for number in range(5):
        step = 1e-4 * (np.arange(5) == number)
        difference = (likelihood(one + step)[0] - likelihood(one - step)[0]) / 2e-4
        assert slope[number] == pytest.approx(difference, rel=1e-4, abs=1e-3)


def joint_of(duration, lag=0.0, **settings):
    """Return the ensemble of a simulated joint whose torque passes a lag before the noise.

    The lag is applied at the simulation's rate.
    """
    asked = {"perturbation": tv.simulate.PRBS(), "snr_db": 10, "seed": 1}
    asked |= {name: settings.pop(name) for name in asked if name in settings}
    simulation = tv.simulate.Joint(**{"stiffness": tv.simulate.SineWave()} | settings).simulate(
        duration, **asked
    )
    recording = simulation.recording
    torque = low_pass(simulation.noiseless.torque, lag, 1000.0)
    torque = torque + recording.torque - simulation.noiseless.torque
    behind = tv.Recording(recording.angle, torque, 1000.0, recording.start)
    return tv.preprocess.segment(tv.preprocess.decimate(behind, 100), 2.0, 0.5)


LIGHT = (("inertia", 1e-12),)


@functools.cache
def tuned_to_a_joint(order, joint):
    return tv.KernelRegression(order=order).tuned(joint_of(40, **dict(joint)))


@slow
@pytest.mark.parametrize(
    ("order", "given", "joint"),
    [(2, 0, ()), (1, 2, LIGHT), (1, 0, LIGHT), (0, 2, (*LIGHT, ("viscosity", 0.0)))],
)
def test_as_many_terms_as_the_joint_has(order, given, joint):
    tuned, evidence = tuned_to_a_joint(given, joint)
    assert (tuned.order, tuned.lag) == (order, 0.0)
    assert {f"order {other}" for other in range(3) if other != given} <= set(evidence.lines)


@slow
def test_a_lag_of_the_torque_is_found():
    ensemble = joint_of(40, lag=0.008, perturbation=tv.simulate.FilteredNoise(), snr_db=15)
    given = tv.KernelRegression()
    tuned, evidence = given.tuned(ensemble)
    assert tuned.order == 2
    assert tuned.lag == pytest.approx(0.008, rel=0.2)
    assert f"lag {1e3 * tuned.lag:.3g} ms" in evidence.lines
    without = attrs.evolve(tuned, lag=0.0).identify(ensemble)
    model = tuned.identify(ensemble)
    assert without.viscosity.mean() < 1.8
    assert without.inertia.mean() < 0.012
    assert model.viscosity.mean() == pytest.approx(2.2, rel=0.05)
    assert model.inertia.mean() == pytest.approx(0.02, rel=0.1)


@slow
def test_slow_noise_and_a_reflex_do_not_take_the_inertia_away():
    """Test that slow noise does not hide the inertia, where that noise is quiet.

    A share of the numbers, as slow noise leaves it, says too little of inertia.
    """
    reflex = tv.simulate.StretchReflex(0.045, 10.0, 0.8, 0.1)
    joint = tv.simulate.ReflexJoint(
        tv.simulate.Constant(60.0), 1.0, reflex_gain=40.0, reflex=reflex
    )
    recording = joint.simulate(60, perturbation=tv.simulate.Pulses(), snr_db=5, seed=0).recording
    noise = lfilter(
        *butter(1, 1.0, fs=1000), np.random.default_rng(0).standard_normal(len(recording))
    )
    recording = attrs.evolve(
        recording, torque=recording.torque + recording.torque.std() * noise / noise.std()
    )
    ensemble = tv.preprocess.subtract_mean(
        tv.preprocess.segment(tv.preprocess.decimate(recording, 100), 2.0)
    )
    tuned = tv.KernelRegression().tuned(ensemble).method
    assert (tuned.order, tuned.lag) == (2, 0.0)
    assert tuned.identify(ensemble).inertia.mean() > 0.015


def test_a_kernel_that_explains_much_less_than_the_one_given_is_warned_of():
    ensemble, worse = (
        ensemble_of(40.0, "square", "noise"),
        tv.KernelRegression(order=0, gamma=1e-12),
    )
    with pytest.warns(
        tv.DataQualityWarning, match=r"chosen explain 43 % of the torque, those given 92 %"
    ):
        tuning.warn_if_worse(tv.KernelRegression(), worse, ensemble)


@slow
@pytest.mark.parametrize(("order", "inertia"), [(2, 0.02), (1, 1e-12)])
def test_a_drift_asks_for_a_decay(order, inertia):
    def profile(time):
        return 100 + 30 * np.sin(np.pi * time) + 0.8 * time

    noise = tv.simulate.FilteredNoise()
    ensemble = joint_of(60, stiffness=profile, snr_db=20, inertia=inertia, perturbation=noise)
    truth = np.stack([profile(onset + ensemble.time) for onset in ensemble.onsets])
    tuned = tv.KernelRegression().tuned(ensemble).method
    assert tuned.order == order
    assert tuned.length_decay < 300
    stiffness, _, _ = tuned.identify(ensemble).impedance(ensemble)
    assert np.sqrt(np.mean((stiffness - truth) ** 2)) < 2.5


def test_one_gamma_is_three_alike():
    ensemble = ensemble_of(20.0, "sine", "noise")
    one, three = (
        tv.KernelRegression(gamma=gamma).identify(ensemble) for gamma in (2.0, (2.0, 2.0, 2.0))
    )
    np.testing.assert_array_equal(one.stiffness, three.stiffness)
    stiff = tv.KernelRegression(gamma=(1e-12, 2.0, 2.0)).identify(ensemble)
    assert np.ptp(stiff.stiffness) < 1e-3
    with pytest.raises(tv.InputError, match="a positive number, or three"):
        tv.KernelRegression(gamma=(1.0, 2.0))
