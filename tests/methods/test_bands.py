"""Bands against closed forms, plain slow versions and the spread of repeated simulations."""

from functools import cache

import numpy as np
import pytest
from scipy import stats
from scipy.linalg import toeplitz
from tests.conftest import ensemble_of, standard_errors_of

import tvsysid as tv
from tvsysid.methods.shared import residuals, solve_windows
from tvsysid.models import IMPEDANCE
from tvsysid.numerics.differentiation import differentiate
from tvsysid.numerics.noise import autocovariance
from tvsysid.numerics.spectra import hann

DEFAULTS = {
    "eirf": tv.EnsembleIRF(),
    "sds": tv.ShortDataSegments(),
    "birf": tv.BasisIRF(),
    "birf irf": tv.BasisIRF(model="irf"),
    "esm": tv.EnsembleSpectral(),
    "esm fit": tv.EnsembleSpectral(stiffness="fit"),
    "kbr": tv.KernelRegression(),
}
TRIALS = 24


pytestmark = pytest.mark.filterwarnings("ignore::tvsysid.DataQualityWarning")


def freedom_of(model):
    """Degrees of freedom of the standard errors, shape (3, time)."""
    return np.stack([model.estimates[name].standard_error.freedom for name in IMPEDANCE])


def lagged(ensemble, time, lags):
    """Angles from lag -lags to +lags at a time, shape (realization, lag)."""
    centre = ensemble.context + time
    return ensemble.angle[:, centre - lags : centre + lags + 1][:, ::-1]


def prepared(ensemble, subtracted):
    return tv.preprocess.subtract_mean(ensemble) if subtracted else ensemble


@pytest.mark.parametrize("subtracted", [False, True])
def test_ensemble_response_has_the_variance_of_least_squares(subtracted):
    ensemble = prepared(ensemble_of(150.0, "sine", "prbs"), subtracted)
    model = tv.EnsembleIRF(max_lag=0.04, solver="full").identify(ensemble)
    lower, upper = model.estimates["stiffness"].band(0.9)
    for time in (0, 57, 199):
        inputs, output = lagged(ensemble, time, 4), ensemble.torque[:, ensemble.context + time]
        weights = np.linalg.lstsq(inputs, output, rcond=None)[0]
        freedom = len(output) - 9 - subtracted  # an intercept was fitted too
        variance = np.sum((output - inputs @ weights) ** 2) / freedom
        area = np.sqrt(variance * np.linalg.inv(inputs.T @ inputs).sum())
        assert model.stiffness[time] == pytest.approx(weights.sum(), rel=1e-8)
        assert (upper - lower)[time] / 2 == pytest.approx(
            stats.t.ppf(0.95, freedom) * area, rel=1e-5
        )
        signals = differentiate(ensemble.angle, 100.0, 4)[:, :, ensemble.context + time - 4].T
        fit = np.sqrt(variance * np.diag(np.linalg.inv(signals.T @ signals)))
        np.testing.assert_allclose(standard_errors_of(model)[1:, time], fit[1:], rtol=1e-5)


def test_the_rank_does_not_choose_its_own_noise():
    # Of few realizations, a truncation leaves what suits it; all directions leave noise alone.
    ensemble = ensemble_of(60.0, "sine", "noise")
    truncated, full = (
        tv.EnsembleIRF(solver=solver).identify(ensemble) for solver in ("mdl", "full")
    )
    assert truncated.diagnostics.rank.mean() < 24
    np.testing.assert_allclose(
        standard_errors_of(truncated)[1:], standard_errors_of(full)[1:], rtol=1e-9
    )
    np.testing.assert_array_equal(freedom_of(truncated), 30 - 25)


@pytest.mark.parametrize(
    ("context", "subtracted"), [(0.5, False), (0.14, False), (0.0, False), (0.14, True)]
)
def test_short_segments_have_the_variance_of_the_dense_sandwich(context, subtracted):
    ensemble = prepared(ensemble_of(40.0, "sine", "prbs", context=context), subtracted)
    lags, half = 12, 5
    model = tv.ShortDataSegments().identify(ensemble)
    windows = solve_windows(ensemble, lags, half)
    taken = (
        np.eye(2 * half + 1)[0] * np.mean(windows.rank / windows.samples) * 20 / (20 - subtracted)
    )
    left = autocovariance(residuals.residual(ensemble, windows.weights), 2 * half)
    colour = residuals.noise_correlation(left, taken)
    missing = max(0, lags - ensemble.context)
    margin = min(half, max(0, ensemble.context - lags))
    for time in (missing, missing + 2, 100, 199 - missing):
        window = range(
            max(time - half, missing - margin), min(time + half, 199 - missing + margin) + 1
        )
        noise = toeplitz(colour)[: len(window), : len(window)]
        readout = windows.readout[time - missing]
        # Realization, window, lag
        samples = np.stack([lagged(ensemble, i, lags) for i in window], axis=1)
        influence = np.einsum("ml,rwl->mrw", readout, samples) / (len(ensemble) * len(window))
        variance = windows.noise[time - missing] * np.einsum(
            "mrw,wv,mrv->m", influence, noise, influence
        )
        np.testing.assert_allclose(standard_errors_of(model)[:, time] ** 2, variance, rtol=1e-6)


@pytest.mark.parametrize("subtracted", [False, True])
def test_response_at_rest_has_the_variance_of_a_regression_with_unequal_errors(subtracted):
    ensemble = prepared(ensemble_of(40.0, "sine", "prbs"), subtracted)
    model = tv.EnsembleSpectral().identify(ensemble)
    for time in (0, 101, 199):
        segment = slice(ensemble.context + time - 15, ensemble.context + time + 15)
        inputs, outputs = (
            ensemble.angle[:, segment] @ hann(30),
            ensemble.torque[:, segment] @ hann(30),
        )
        slope = inputs @ outputs / (inputs @ inputs)
        regressors = np.stack([inputs, np.ones(20)][: 1 + subtracted], axis=1)
        errors, leverage = (
            outputs - slope * inputs,
            np.diag(regressors @ np.linalg.pinv(regressors)),
        )
        variance = np.sum(inputs**2 * errors**2 / (1 - leverage)) / (inputs @ inputs) ** 2
        assert standard_errors_of(model)[0, time] ** 2 == pytest.approx(variance, rel=1e-9)
        width = stats.t.ppf(0.975, 19 - subtracted) * np.sqrt(variance)
        assert model.estimates["stiffness"].band()[1][time] - model.stiffness[
            time
        ] == pytest.approx(width, rel=1e-9)


def test_segments_fit_is_weighted_least_squares_on_the_derivatives():
    ensemble = ensemble_of(40.0, "sine", "prbs")
    model = tv.EnsembleSpectral(stiffness="fit").identify(ensemble)
    signals = differentiate(ensemble.angle, 100.0)
    for time in (0, 101, 199):
        at = slice(ensemble.context + time - 15, ensemble.context + time + 15)
        regressors = (signals[:, :, at.start - 12 : at.stop - 12] * hann(30)).reshape(3, -1).T
        output = (ensemble.torque[:, at] * hann(30)).ravel()
        found = [values[time] for values in (model.stiffness, model.viscosity, model.inertia)]
        np.testing.assert_allclose(
            found, np.linalg.lstsq(regressors, output, rcond=None)[0], rtol=1e-7
        )


@cache
def repeated(name, duration, perturbation):
    """Return estimates, standard deviations and bands of stiffness of some trials.

    The mean over realizations is subtracted.
    """
    estimates, deviations, bands = [], [], []
    for seed in range(TRIALS):
        ensemble = tv.preprocess.subtract_mean(
            ensemble_of(duration, "sine", perturbation, seed=300 + seed)
        )
        model = DEFAULTS[name].identify(ensemble)
        estimates.append([model.stiffness, model.viscosity, model.inertia])
        deviations.append(standard_errors_of(model))
        bands.append(model.estimates["stiffness"].band())
    return np.array(estimates), np.array(deviations), np.array(bands)


def scatter_of(name, quantity, perturbation):
    """Return the allowed ratio of claimed to actual standard deviation: lowest, highest."""
    if perturbation == "prbs" and quantity and name != "kbr":
        # What decimation folds back from a PRBS, where it switches, adds to inertia and viscosity
        # and is no noise.
        return 0.65, 1.13
    if name == "birf irf" and quantity != 1:
        # The sparse prior takes what it prunes as known: 0.86 and 0.84 over 60 trials, without a
        # prior 1.03 and 0.98.
        return 0.75, 0.95
    return 0.88, 1.14


@pytest.mark.slow
@pytest.mark.parametrize("perturbation", ["noise", "prbs"])
@pytest.mark.parametrize("name", list(DEFAULTS))
def test_bands_are_as_wide_as_estimates_scatter(name, perturbation):
    duration = 100.0 if name == "eirf" else 40.0
    estimates, deviations, bands = repeated(name, duration, perturbation)
    for quantity in range(3):
        scatter = np.sqrt(np.mean(np.var(estimates[:, quantity], axis=0, ddof=1)))
        lowest, highest = scatter_of(name, quantity, perturbation)
        assert lowest < np.sqrt(np.mean(deviations[:, quantity] ** 2)) / scatter < highest
    truth = tv.simulate.SineWave()(np.arange(200) / 100)
    # At 0 Hz a bias is in the way, and where coefficients are pruned the band is too narrow.
    lowest = {"esm": 88, "birf irf": 88}.get(name, 91)
    assert lowest < tv.metrics.coverage(bands[:, 0], bands[:, 1], truth) < 98


def test_a_model_of_ones_own_may_bring_its_band():
    stiffness, error = np.full(200, 100.0), tv.StandardError(np.full(200, 2.0), 10)
    estimates = {
        "stiffness": tv.Estimate(stiffness, "N m/rad", error=error),
        "viscosity": tv.Estimate(np.ones(200), "N m s/rad"),
    }
    model = tv.Model.of(ensemble_of(), estimates=estimates)
    width = 2 * stats.t.ppf(0.75, 10)
    lower, upper = model.estimates["stiffness"].band(0.5)
    np.testing.assert_allclose([lower, upper], [stiffness - width, stiffness + width])
    assert np.isnan(model.estimates["viscosity"].band()).all()
    assert np.isnan(model.inertia).all()
