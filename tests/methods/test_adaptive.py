"""Adaptive regression: its small matrices against dense Gaussian processes, and what it finds."""

import pickle
from functools import cache
from types import SimpleNamespace

import attrs
import numpy as np
import pytest
from scipy import stats
from scipy.linalg import toeplitz
from tests import independent
from tests.conftest import ensemble_of, realizations
from tests.methods.free_estimates import estimate_of

import tvsysid as tv
from tvsysid.methods.adaptive import averaging, evidence, prior, regression, search
from tvsysid.methods.adaptive.model import MixtureError, Switch, describe_changes
from tvsysid.methods.adaptive.regression import Regressors
from tvsysid.numerics.differentiation import differentiate

METHOD = tv.AdaptiveRegression()
pytestmark = pytest.mark.filterwarnings("ignore::tvsysid.DataQualityWarning")


def dense_posterior(estimate, covariance, candidate):
    """Return the gain in log evidence over noise alone, posterior mean and standard deviation.

    No small matrix is used.
    """
    axis, positions = estimate.axis, candidate.positions
    features, count = prior.fourier_features(axis), len(positions)
    smooth = features * candidate.smooth.prior.variances @ features.T
    sharp, seen = axis.steps(positions), axis.steps(positions, recorded=True)
    is_balanced, size = divmod(candidate.size_prior, len(prior.SWITCH_SIZES))
    balance = np.eye(count) - is_balanced * np.full((count, count), 1 / max(count, 1))
    spread = prior.SWITCH_SIZES[size] ** 2 * balance
    total = covariance + smooth + seen @ spread @ seen.T
    density, noise = (
        stats.multivariate_normal.logpdf(estimate.values, cov=each) for each in (total, covariance)
    )
    gain = (smooth + sharp @ spread @ seen.T) @ np.linalg.inv(total)
    own = smooth + sharp @ spread @ sharp.T - gain @ (smooth + seen @ spread @ sharp.T)
    return density - noise, gain @ estimate.values, np.sqrt(np.diag(own))


@pytest.mark.parametrize("periodic", [True, False])
def test_evidence_and_posterior_are_those_of_the_dense_gaussian_process(random, periodic):
    estimate, covariance = estimate_of(random, periodic)
    for each in [prior.smooth_priors(estimate.axis)[index] for index in (0, 3, -1)]:
        # A constant of less variance: with the usual one, rounding tells in the dense matrices.
        smooth = evidence.SmoothFit(
            estimate, each._replace(variances=np.r_[4.0, each.variances[1:]])
        )
        for positions in ([], [12.3, 27.8], [5.0, 12.25, 30.5]):
            switches = search.CurveModel(smooth, np.array(positions))
            log_prior = each.log_prior - len(positions) * np.log(40)
            for found in averaging.weigh([smooth], [switches]):
                gain, mean, error = dense_posterior(estimate, covariance, found)
                chance = log_prior - bool(positions) * np.log(6 if periodic else 3)
                assert found.evidence == pytest.approx(gain + chance, abs=1e-5)
                curve = averaging.CurvePosterior.of(found, switches.positions[None])
                np.testing.assert_allclose(curve.means[:, 0], mean, atol=1e-6)
                np.testing.assert_allclose(curve.variances[:, 0], error**2, atol=1e-6)
        own, last = smooth.steps(np.array(positions[:2])), smooth.steps(np.array(positions[2:]))
        expected = smooth.scores_of(own.joined(last)).max()
        assert smooth.scores_with(own, last).max() == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("axis", [prior.Axis(200, True), prior.Axis(100, False)])
def test_smooth_parts_are_gaussian_processes(axis):
    features, late = prior.fourier_features(axis)[:, 1:], np.arange(30) / 10.24
    processes = np.exp(-(late**2) / 2), (1 + np.sqrt(3) * late) * np.exp(-np.sqrt(3) * late)
    found = [
        (features * each.variances[1:] @ features.T)[0, :30]
        for each in prior.smooth_priors(axis)[1:]
    ]
    assert {round(np.sqrt(each[0]), 9) for each in found} == set(prior.AMPLITUDES)
    for process in processes:  # less the constant, which a smooth part does not have
        apart = [each / each[0] - process for each in found]
        assert min(np.ptp(each) for each in apart) < 0.2


@pytest.mark.parametrize(("rate", "reach"), [(100, 1.5), (200, 3.0)])
def test_steps_are_recorded_as_the_decimation_smears_them(rate, reach):
    time = np.arange(2000) / 1000
    recording = tv.Recording(np.sin(time), (time >= 1.0037).astype(float), 1000.0)
    torque = tv.preprocess.decimate(recording, rate).torque
    axis = prior.Axis(len(torque), periodic=False, filter_reach=reach)
    between = axis.steps(np.array([1.0035 * rate]), recorded=True)[:, 0]
    np.testing.assert_allclose(between, torque, atol=0.012)


def test_constants_and_stiffness_are_those_of_a_regression_with_a_stiffness_at_each_time():
    ensemble = ensemble_of(40.0, "square", "prbs")
    signals = Regressors.of_second_order(ensemble)
    u, v, a, y = signals.columns
    free = regression.FreeRegression(ensemble, signals)
    design = np.stack([[*np.diag(u[r]), v[r], a[r]] for r in range(len(u))]).swapaxes(1, 2)
    for weights in (np.eye(200), np.linalg.inv(toeplitz(0.9 ** np.arange(200)))):
        expected = np.linalg.solve(
            np.einsum("rti,ts,rsj->ij", design, weights, design, optimize=True),
            np.einsum("rti,ts,rs->i", design, weights, y, optimize=True),
        )
        filters = np.linalg.cholesky(weights).T
        free.weighted = (regression.Products.of(signals, filters, low_band=False),) * 2
        free._solve(np.zeros(200), signals.prior_precision)
        found = [*free.coefficients[regression.U], *free.constants]
        np.testing.assert_allclose(found, expected, rtol=1e-8)


def test_noise_is_whitened_whatever_its_colour_and_where_it_is_louder(random):
    louder = 1 + (np.arange(120) > 60)
    made = random.normal(size=(400, 140)), np.cumsum(random.normal(size=(400, 140)), axis=1)
    for values in (made[0], made[0][:, 1:] + 0.8 * made[0][:, :-1], made[1]):
        left = values[:, -120:] * louder
        white = regression.whitening_filters(left.T @ left / 400, 400, 100.0, periodic=False)
        after = left @ white.T
        spread = after.std(axis=0)
        assert np.abs(spread[[*range(15, 55), *range(70, 115)]] - 1).max() < 0.15
        assert np.abs(np.corrcoef(after[:, 15:].T) - np.eye(105)).mean() < 0.045


@pytest.mark.parametrize(("colour", "most"), [("pink", 3.0), ("slow", 0.8)])
def test_slow_noise_counts_less_and_bands_hold(colour, most):
    errors, inside = [], []
    for seed in range(2):
        signals, _ = independent.imposed("sine", "prbs", colour, 5, seed)
        model = METHOD.identify(independent.ensemble_of(*signals))
        true = independent.WAVES["sine"](model.time)
        lower, upper = model.estimates["stiffness"].band()
        inside.append((lower <= true) & (true <= upper))
        errors.append(model.stiffness - true)
    assert np.mean(inside) > 0.85
    assert np.sqrt(np.mean(np.square(errors))) < most  # with white weights: 4.3 and 5.9


def mixture_band(weights, means, variances, freedom, **band):
    mixed = averaging.Mixture(*map(np.array, (weights, [means], [variances])))
    error = MixtureError(np.sqrt(mixed.variance()), np.array(freedom), mixture=mixed)
    return np.array(tv.Estimate(mixed.mean(), "N m/rad", error=error).band(**band))[:, 0]


@pytest.mark.parametrize("freedom", [1e9, 6.0])
def test_bands_are_quantiles_of_the_mixture(freedom):
    mixed = [0.7, 0.3], [50.0, 150.0], [1.0, 4.0]
    band = mixture_band(*mixed, freedom, level=0.9)
    shares = stats.t.cdf(band[:, None] - mixed[1], freedom, scale=[1.0, 2.0]) @ mixed[0]
    np.testing.assert_allclose(shares, [0.05, 0.95], atol=2e-3)
    lower, upper = mixture_band(*mixed, freedom, level=0.9, simultaneous=True)
    assert lower <= band[0] < band[1] <= upper
    plain = tv.Estimate([100.0], "N m/rad", error=tv.StandardError([2.0], freedom)).band()
    np.testing.assert_allclose(mixture_band([1], [100], [4], freedom)[:, None], plain, rtol=2e-4)
    lower, upper = mixture_band([0.98, 0.02], [50, 150], [0.01, 0.01], 1e9, level=0.9)
    assert lower < 52 < upper < 60  # the mean is within the band, although a part moves it


@cache
def model_of(profile, *data):
    return METHOD.identify(ensemble_of(150.0, profile, *data))


def test_switches_are_found_between_samples_with_their_sizes():
    model = model_of("square", "noise")
    rows = [row for row in model.switches if row.quantity == "stiffness"]
    assert [row.probability > 0.99 for row in rows] == [True, True]
    for row, (time, size) in zip(rows, ((0.4995, 100.0), (1.4995, -100.0)), strict=True):
        assert row.time == pytest.approx(time, abs=0.003)
        assert row.earliest <= row.time <= row.latest
        assert row.size == pytest.approx(size, abs=4 * row.size_error)
    away = np.abs(model.time[:, None] - [0.5, 1.5]).min(axis=1) > 0.015
    assert np.abs(model.stiffness - tv.simulate.SquareWave()(model.time))[away].max() < 3
    assert model.diagnostics.details["smooth_stiffness"] < 0.5


def test_a_model_shows_its_tables_and_a_figure():
    model = model_of("square", "noise")
    assert model.to_xarray().switch_time.shape == (len(model.switches),)
    assert len(model.plot().axes) >= 3


def test_changes_are_described_with_their_probabilities():
    switches = [
        Switch("stiffness", 0.5, 0.4, 0.6, 100.0, 1.0, 1.0),
        Switch("stiffness", 1, 0.9, 1.1, -8, 2, 0.33),
        Switch("stiffness", 1.5, 0.9, 1.6, 8, 2, 0.7),
    ]
    details = SimpleNamespace(details={"smooth_stiffness": 0.1})
    model = SimpleNamespace(switches=switches, diagnostics=details, reflex=True)
    assert describe_changes(model) == [
        "switch at 0.500 s: +100.0 ± 2.0 N·m/rad",
        "possible switch at 1.000 s: -8.0 ± 3.9 N·m/rad, probability 33 %",
        "probable switch at 1.500 s: +8.0 ± 3.9 N·m/rad, probability 70 %",
        "probability that stiffness changes smoothly between switches: 10 %, is constant: 90 %",
        "the torque of a stretch reflex is separated",
    ]
    model.reflex = None
    assert describe_changes(model)[-1] == "no stretch reflex is detected"


def test_what_does_not_change_is_constant_and_what_is_smooth_has_no_switch():
    constant = model_of("constant", "prbs")
    assert constant.diagnostics.details["constant_stiffness"] > 0.5
    assert np.ptp(constant.stiffness) < 2
    sine = model_of("sine", "prbs")
    assert sine.diagnostics.details["constant_stiffness"] < 1e-6
    assert sum(row.probability for row in sine.switches) < 0.3
    assert sine.diagnostics.details["smooth_stiffness"] == pytest.approx(1.0)
    assert sine.diagnostics.details["periodic"] == 1.0


@pytest.mark.slow
def test_a_recording_without_a_low_pass_is_told_by_its_steps(random):
    time = np.arange(200) / 100
    angle = np.cumsum(random.normal(size=(80, 260)), axis=1) * 0.1 + random.normal(size=(80, 260))
    inner = differentiate(angle, 100.0)[:, :, 18:-18]
    torque = np.zeros_like(angle)
    torque[:, 30:-30] = (50 + 100 * ((time > 0.5003) & (time < 1.5))) * inner[0] + 2 * inner[1]
    torque += 10 * random.normal(size=torque.shape)
    model = METHOD.identify(tv.Ensemble(angle, torque, 100.0, context=30))
    rows = [row for row in model.switches if row.quantity == "stiffness"]
    assert [row.probability > 0.9 for row in rows] == [True, True]
    np.testing.assert_allclose(model.stiffness[[49, 51]], [50, 150], atol=10)
    assert model.diagnostics.details["periodic"] == 0.0  # none follows another


def reflex_ensemble(duration, snr_db=15, **joint):
    recording = (
        tv.simulate.ReflexJoint(**joint)
        .simulate(duration, perturbation=tv.simulate.FilteredNoise(), snr_db=snr_db, seed=4)
        .recording
    )
    return realizations(recording, 2.0, 1.0)


SINE = tv.simulate.SineWave()


@pytest.mark.slow
def test_a_reflex_is_taken_out_of_the_stiffness():
    ensemble = reflex_ensemble(60.0, stiffness=SINE, reflex_gain=8.0)
    model = METHOD.identify(tv.preprocess.subtract_mean(ensemble))
    assert np.sqrt(np.mean((model.stiffness - SINE(model.time)) ** 2)) < 3
    assert np.nanmean(model.estimates["reflex_gain"].values) == pytest.approx(8.0, abs=0.6)
    assert set(model.pathways(ensemble)) == {"intrinsic", "reflex"}
    assert model.estimates["viscosity"] is model.reflex.estimates["viscosity"]
    travelled = pickle.loads(pickle.dumps(model)).estimates["stiffness"]
    np.testing.assert_array_equal(travelled.band(), model.estimates["stiffness"].band())
    assert "reflex_gain" not in model_of("sine", "prbs").estimates


def test_emg_drives_the_reflex():
    ensemble = reflex_ensemble(40.0, stiffness=SINE, reflex_gain=8.0)
    model = tv.methods.parse("adaptive:emg=emg").identify(ensemble)
    assert model.estimates["reflex_gain"].unit == "N m/V"
    # The electrode's noise is no drive.
    assert abs(np.mean(model.stiffness - SINE(model.time))) < 15
    with pytest.raises(tv.InputError, match="it needs the channel 'soleus'"):
        tv.AdaptiveRegression(emg="soleus").identify(ensemble)


@pytest.mark.parametrize("reflex_gain", [0.0, pytest.param(8.0, marks=pytest.mark.slow)])
def test_a_refit_keeps_what_the_whole_found_and_predicts_as_well(reflex_gain, monkeypatch):
    square = tv.simulate.SquareWave()
    ensemble = reflex_ensemble(40.0, snr_db=10, stiffness=square, reflex_gain=reflex_gain)
    kept, left = ensemble.select(range(14)), ensemble.select(range(14, len(ensemble)))
    whole, anew = (METHOD.identify(data) for data in (ensemble, kept))
    monkeypatch.setattr(averaging, "search_switches", None)
    vafs = [
        tv.metrics.vaf(left.torque[:, left.core], each.predict(left)).mean()
        for each in (METHOD.refit(kept, whole), anew)
    ]
    assert vafs[0] == pytest.approx(vafs[1], abs=0.2)


@cache
def odd_ensembles():
    random = np.random.default_rng(3)
    angle = np.cumsum(random.normal(size=(8, 84)), axis=1)
    usual = tv.Ensemble(angle, 80 * angle + random.normal(size=angle.shape), 100.0, context=12)
    one = np.tile(np.sin(np.arange(84) / 9), (6, 1))
    return {
        "four": usual.select([0, 3, 5, 7]),
        "exact": attrs.evolve(usual, torque=80.0 * usual.angle),
        "short": tv.Ensemble(random.normal(size=(9, 40)), random.normal(size=(9, 40)), 100.0),
        "one sine": tv.Ensemble(one, one, 100.0, context=12),
    }


@pytest.mark.parametrize("name", odd_ensembles())
def test_any_legal_ensemble_gives_a_model(name):
    ensemble = odd_ensembles()[name]
    assert METHOD.skip(ensemble) is None
    with np.errstate(all="raise", under="ignore"):
        model = METHOD.identify(ensemble)
    known = np.isfinite(model.stiffness)
    assert known.any()
    for each in model.estimates.values():
        lower, upper = each.band()
        assert (lower[known] <= each.values[known]).all()
        assert (each.values[known] <= upper[known]).all()


@pytest.mark.parametrize(
    ("name", "text"),
    [("four", "whether there is a stretch reflex"), ("one sine", "viscosity and inertia")],
)
def test_what_data_do_not_determine_is_one_warning(name, text):
    texts = METHOD.identify(odd_ensembles()[name]).diagnostics.warnings
    assert [text in each for each in texts if "do not determine" in each] == [True]


def noisy(angle, random, viscosity=0.0):
    """Return an ensemble with a stiffness of 80 N·m/rad, and noise."""
    inner, torque = differentiate(angle, 100.0), np.zeros_like(angle)
    torque[:, 12:-12] = 80 * inner[0] + viscosity * inner[1] + random.normal(size=inner[0].shape)
    return tv.Ensemble(angle, torque, 100.0, context=12)


@pytest.mark.parametrize("method", [METHOD, tv.JointCascade()])
def test_no_viscosity_is_negative_and_a_contradiction_is_reported(random, method):
    model = method.identify(noisy(random.normal(size=(30, 120)), random, -0.5))
    texts = [text for text in model.diagnostics.warnings if "a negative viscosity" in text]
    assert len(texts) == 1
    for values in (model.viscosity, *model.estimates["viscosity"].band()[:1]):
        assert np.nanmin(values) == pytest.approx(0, abs=1e-9)
        assert np.nanmin(values) >= 0


def test_nothing_is_concluded_from_an_angle_that_is_still(random):
    angle = np.cumsum(random.normal(size=(40, 184)), axis=1)
    angle[:, 70:110] = 0.0
    model = METHOD.identify(noisy(angle, random))
    np.testing.assert_allclose(model.stiffness, 80, atol=0.5)
    assert not model.switches


def test_what_it_cannot_serve_it_says():
    nothing = np.eye(9, 60)
    with pytest.raises(
        tv.InputError, match="the torque is 0 in all realizations without their context"
    ):
        METHOD.identify(tv.Ensemble(nothing.cumsum(axis=1), nothing, 100.0, context=12))
    usual = ensemble_of(40.0)
    assert "at least 4 realizations, got 3" in METHOD.skip(usual.select([0, 1, 2]))
    assert "of 16 to 3000 samples with derivatives, got 6" in METHOD.skip(
        tv.Ensemble(*np.ones((2, 9, 30)).cumsum(axis=2), 100.0)
    )
