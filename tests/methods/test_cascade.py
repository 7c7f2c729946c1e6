"""Test the joint fit of both pathways against plain code and on known joints."""

import warnings

import attrs
import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.stats import multivariate_normal
from tests.independent import ensemble_of, imposed
from tests.reflexive import reflexive

import tvsysid as tv
from tvsysid.methods.cascade import columns as fitted
from tvsysid.methods.cascade.columns import Data, deviations, intrinsic_filters, muscle
from tvsysid.methods.cascade.fit import Fit, posterior_of
from tvsysid.methods.pathways import Stretch
from tvsysid.numerics.gaussian import Moments
from tvsysid.numerics.noise import autocorrelation
from tvsysid.numerics.second_order import response_readout

RATE, TIMES, CONTEXT, LAGS = 100.0, 60, 100, 4
NOISE = np.array([1.0, 0.5, 0.2])  # autocorrelation
KNOWN = np.array([np.log(14.0), np.log(0.7), 0.1, 0.043])
CASES = {
    "A": {},
    "C": {"stiffness": "constant", "gain": 0.0},
    "E": {"perturbation": "prbs"},
    "N": {"direction": -1},
    "T": {"threshold": 0.1},
}


def simulated(case, duration):
    return reflexive(duration, **CASES[case])


@pytest.fixture
def fit_of(random):
    """Function that fits a small problem."""
    angle = np.cumsum(random.normal(size=(30, TIMES + 2 * CONTEXT)), axis=1) / 200
    torque = 30 * angle + random.normal(size=angle.shape)
    ensemble = tv.Ensemble(angle, torque, RATE, context=CONTEXT)

    def fit(free, harmonics):
        data = attrs.evolve(Data.of(ensemble, harmonics), noise=NOISE)
        return Fit(data, Stretch(), KNOWN, free)

    return fit


def every_column(fit):
    """All columns, and the derivatives by the shape, (column, realization, time)."""
    signals = np.repeat(fit.data.signals, fit.data.sizes, axis=0)
    intrinsic = signals * fit.data.functions.T[:, None]
    return np.concatenate([intrinsic, fit.late_columns])


def dot(columns, others):
    return np.tensordot(columns, others, ((1, 2), (1, 2)))


def assert_alike(found, expected, tolerance):
    """Compare matrices of columns, relative to the sizes of these."""
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found / scale, expected / scale, atol=tolerance)


def matrix_of(correlation, times):
    return toeplitz(np.pad(correlation, (0, times))[:times])


def test_filters_give_the_angle_its_derivatives_and_its_differences():
    offsets, filters = np.arange(-LAGS, LAGS + 1), intrinsic_filters(RATE)[1]
    norms = np.linalg.norm(filters, axis=1, keepdims=True)
    assert np.linalg.matrix_rank(filters / norms) == 2 * LAGS + 1
    # Of a constant, a ramp and a parabola
    powers = np.stack([(-offsets / RATE) ** power for power in range(3)])
    expected = np.eye(2 * LAGS + 1, 3) * [1, 1, 2]
    np.testing.assert_allclose(filters @ powers.T, expected, atol=1e-9)
    joint = np.array([80.0, 2.0, 0.015])
    found = response_readout(offsets / RATE) @ (joint @ filters[:3])
    np.testing.assert_allclose(found, joint, rtol=3e-3)


@pytest.mark.parametrize("damping", [0.3, 1.0, 2.0])
@pytest.mark.parametrize("delay", [0.04, 0.0437])
def test_the_muscle_is_one_of_second_order(damping, delay):
    # Numerical solution at a rate so high that its steps do not matter.
    fine = 100_000
    force, speed, out = 0.0, 16.0**2, []
    for _ in range(fine):
        out.append(force)
        speed += (-2 * damping * 16.0 * speed - 16.0**2 * force) / fine
        force += speed / fine
    at = np.arange(100) / RATE - delay
    expected = np.where(at >= 0, np.interp(at, np.arange(fine) / fine, out), 0.0) / RATE
    expected /= expected.sum()
    shape = np.array([np.log(16.0), np.log(damping), 0.0, delay])
    np.testing.assert_allclose(
        muscle(shape, 100, RATE), expected, atol=5e-4 * expected.max() + 1e-6
    )


@pytest.mark.parametrize("window", [256, 20])
@pytest.mark.parametrize(("free", "harmonics"), [(3, 12), (1, 0)])
def test_moments_and_covariance_are_those_of_the_samples(
    fit_of, monkeypatch, window, free, harmonics
):
    monkeypatch.setattr(fitted, "MAX_WINDOW", window)
    fit = fit_of(free, harmonics)
    columns = every_column(fit)
    coefficients = np.arange(len(columns) - free) / 10
    expected = np.tensordot(coefficients, columns[:-free], 1)
    left = fit.data.residual(coefficients, fit.reflex_columns)
    np.testing.assert_allclose(left, deviations(fit.data.torque - expected), atol=1e-9)

    weights, left, noise = np.zeros((TIMES, TIMES)), fit.residual, np.zeros((TIMES, TIMES))
    correlation = autocorrelation(left, 0.0) * np.sum(left**2) / fit.freedom
    for inside, _ in fit.data.windows:
        size = inside.stop - inside.start
        weights[inside, inside] = np.linalg.inv(matrix_of(NOISE, size))
        noise[inside, inside] = matrix_of(correlation, size)
    every = np.concatenate([columns, fit.data.torque[None]])
    products = dot(every @ weights, every)
    gram, cross, square, _ = fit.data.moments(fit.late_columns)
    assert_alike(np.block([[gram, cross[:, None]], [cross, square]]), products, 1e-8)

    variance, spread = fit.posterior.noise_variance, np.array([0.6, 0.5, 0.3])[:free]
    weight = variance * np.diag([*fit.posterior.precision, *spread**-2])
    coloured = dot(columns @ weights @ noise, columns @ weights)
    inverse = np.linalg.inv(products[:-1, :-1] + weight)
    assert_alike(fit.covariance, inverse @ (coloured + variance * weight) @ inverse, 1e-6)


def test_evidence_is_that_of_the_samples_and_limits_are_kept(random):
    columns, torque = random.normal(size=(40, 5)), random.normal(size=40)
    spread, every = np.array([1e4, 0.5, 2.0, 0.1, 1.0]), np.column_stack([columns, torque])
    moments = Moments.of(every.T @ every, 40.0)
    found = posterior_of(moments, spread)
    covariance = np.eye(40) + (columns * spread**2) @ columns.T
    left = torque @ np.linalg.solve(covariance, torque)
    assert found.noise_variance == pytest.approx(left / 40)
    assert found.log_evidence == pytest.approx(
        multivariate_normal.logpdf(torque, cov=covariance * left / 40), abs=1e-5
    )

    positive = random.normal(size=(30, 5)) + 1.0
    assert (positive @ found.mean).min() < 0
    mean = posterior_of(moments, spread, positive).mean
    assert (positive @ mean).min() > -1e-12
    # Against the limits that are touched, and no others, the posterior density rises.
    touched = positive[positive @ mean < 1e-9]
    slope = moments.gram @ mean - moments.cross + mean / spread**2
    pressing = np.linalg.lstsq(touched.T, slope, rcond=None)[0]
    np.testing.assert_allclose(touched.T @ pressing, slope, atol=1e-8)
    assert (pressing > 0).all()


@pytest.mark.parametrize("wave", ["constant", "ramp"])
def test_slow_noise_hides_no_change_and_makes_none(wave):
    (angle, torque), _ = imposed(wave, "noise", "pink", 5.0, 0)
    with pytest.warns(tv.DataQualityWarning, match="no reflex is detected"):
        model = tv.JointCascade().identify(ensemble_of(angle, torque))
    assert model.diagnostics.details["constant"] == (wave == "constant")


@pytest.mark.slow
@pytest.mark.parametrize("case", ["A", "E", "N", "T"])
def test_both_pathways_are_found(case):
    ensemble, truth = simulated(case, 150 if case == "E" else 40)
    ensemble = tv.preprocess.subtract_mean(ensemble)
    model = tv.JointCascade().identify(ensemble)
    details = model.diagnostics.details
    assert model.diagnostics.warnings == ()
    assert (details["reflex_detected"], details["direction"]) == (1, -1 if case == "N" else 1)
    # The error of stiffness by sds is 55.
    for name, largest_mean, largest in (("stiffness", 4.0, 5.0), ("reflex_gain", 0.5, 1.0)):
        error = model.over_time(name) - truth[name]
        assert abs(error.mean()) < largest_mean
        assert np.sqrt(np.mean(error**2)) < largest
        lower, upper = model.estimates[name].band()
        assert np.mean((lower < truth[name]) & (truth[name] < upper)) > 0.7
    assert details["frequency"] == pytest.approx(15.6, rel=0.06)
    assert details["damping"] == pytest.approx(0.62, rel=0.12)
    assert details["threshold"] == pytest.approx(CASES[case].get("threshold", 0.0), abs=0.03)
    assert details["vaf_held_out"] == pytest.approx(details["vaf"], abs=1.5)
    np.testing.assert_allclose(model.impulse_response.sum(axis=1) / 100, model.stiffness, rtol=1e-9)
    assert model.viscosity.mean() == pytest.approx(2.2, rel=0.05)
    assert model.inertia.mean() == pytest.approx(0.02, rel=0.06)


def test_the_model_of_a_slow_muscle_gives_the_torque_that_was_fitted():
    settings = {"stiffness": "constant", "gain": 8.0, "frequency": 5.0, "damping": 1.0}
    ensemble = tv.preprocess.subtract_mean(reflexive(40.0, **settings)[0])
    method = tv.JointCascade(harmonics=0)
    fit, model = method.select(ensemble).reflex, method.identify(ensemble)
    gain = fit.posterior.mean[fit.data.intrinsic_count :]
    expected = np.tensordot(gain, fit.reflex_columns, 1)
    found = model.pathways(ensemble)["reflex"][fit.data.rows, fit.data.times]
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())
    details = model.diagnostics.details
    assert details["vaf"] == pytest.approx(details["vaf_held_out"], abs=0.1)


def test_a_constant_fit_of_a_joint_that_changes_is_said_to_be_one():
    with pytest.warns(
        tv.DataQualityWarning, match="cascade: stiffness or viscosity change over a realization"
    ):
        model = tv.JointCascade(harmonics=0).identify(simulated("A", 40)[0])
    assert np.ptp(model.stiffness) == 0
    assert not tv.JointCascade().time_invariant


def test_no_reflex_is_invented():
    ensemble, truth = simulated("C", 40)
    with pytest.warns(tv.DataQualityWarning, match="cascade: no reflex is detected"):
        model = tv.JointCascade().identify(ensemble)
    assert model.diagnostics.details["reflex_detected"] == 0
    np.testing.assert_array_equal(model.pathways(ensemble)["reflex"][:, 45:], 0)
    np.testing.assert_allclose(model.stiffness, truth["stiffness"], atol=2.0)
    lower, upper = model.estimates["reflex_gain"].band(0.999)
    np.testing.assert_array_equal(lower, 0)
    assert (upper > 0).all()
    assert (upper < 1.5).all()


def test_emg_drives_the_reflex():
    ensemble, truth = simulated("A", 40)
    model = tv.JointCascade(emg="emg").identify(ensemble)
    assert model.diagnostics.details["reflex_detected"] == 1
    # Half the bias of sds: noise of the electrode is no drive
    assert abs(np.mean(model.stiffness - truth["stiffness"])) < 15
    assert model.estimates["reflex_gain"].unit == "N m/V"
    assert set(model.pathways(ensemble)) == {"intrinsic", "reflex"}
    with pytest.raises(tv.InputError, match="it needs the channel 'soleus'"):
        tv.JointCascade(emg="soleus").identify(ensemble)


def test_an_angle_at_the_low_rate_only_serves_with_a_warning():
    ensemble, truth = simulated("A", 40)
    with pytest.warns(tv.DataQualityWarning, match="the angle is there at 100 Hz only"):
        model = tv.JointCascade().identify(attrs.evolve(ensemble, recorded_angle=None))
    assert abs(np.mean(model.stiffness - truth["stiffness"])) < 4


def test_realizations_without_history_are_refused(random):
    angle = random.normal(size=(20, 40))
    with pytest.raises(tv.InputError, match=r"the reflex needs 0.45 s of record before"):
        tv.JointCascade().identify(tv.Ensemble(angle, angle, 100.0))


@pytest.mark.parametrize(
    ("gain", "mean", "told"), [(8.0, 8.0, True), ("sine", 8.0, False), ("square", 4.0, False)]
)
def test_a_change_of_the_gain_within_its_band_is_told_and_no_gain_is_negative(gain, mean, told):
    ensemble, _ = reflexive(80, gain=gain, seed=1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tv.DataQualityWarning)
        model = tv.JointCascade().identify(tv.preprocess.subtract_mean(ensemble))
    texts, found = " ".join(model.diagnostics.warnings), model.estimates["reflex_gain"]
    assert ("gain's change over time is not identified" in texts) == told
    lower, upper = found.band()
    assert found.values.mean() == pytest.approx(mean, abs=0.5)
    assert found.values.min() >= lower.min() >= 0
    assert (found.values <= upper).all()
    if gain == "square":
        assert found.values.min() == pytest.approx(0, abs=1e-9)
