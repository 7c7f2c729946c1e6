"""A reference as the instrument, and frequencies weighted by the residual."""

from functools import cache

import attrs
import numpy as np
import pytest
from scipy import stats

import tvsysid as tv
from tvsysid.methods.shared import instrument
from tvsysid.numerics.bases import FourierSeries
from tvsysid.numerics.differentiation import differentiate
from tvsysid.numerics.gaussian import Moments, ridge
from tvsysid.numerics.instrument import predicted, realization_groups
from tvsysid.numerics.spectra import hann

D = "disturbance"
SEEDS = range(100, 104)
KBR = tv.KernelRegression(reference=D, weighting="residual")
ESM = tv.EnsembleSpectral(stiffness="fit", reference=D)


pytestmark = pytest.mark.filterwarnings("ignore::tvsysid.DataQualityWarning")


@cache
def loop(load=100.0, noise_hz=5.0, snr_db=5.0, seed=100, duration=40.0):
    joint = tv.simulate.CompliantActuator(
        tv.simulate.SineWave(),
        actuator_stiffness=load,
        noise_bandwidth=noise_hz,
        disturbance="torque",
    )
    simulation = joint.simulate(
        duration, perturbation=tv.simulate.FilteredNoise(20.0), snr_db=snr_db, seed=seed
    )
    ensemble = tv.preprocess.segment(tv.preprocess.decimate(simulation.recording, 100), 2.0)
    return tv.preprocess.subtract_mean(ensemble, [D])


@cache
def identified(method, *data):
    return method.identify(loop(*data))


def test_the_predicted_angle_is_a_ridge_fit_to_the_other_realizations(random):
    count, samples, context, rate, (early, late) = 12, 60, 20, 50.0, (2, 15)
    core, whole = slice(context, context + samples), samples + 2 * context
    reference = random.standard_normal((count, whole + early + late))
    angle = random.standard_normal((count, whole)) + reference[:, late - 3 : late - 3 + whole]
    groups = realization_groups(np.zeros(count, dtype=int), np.arange(count) % 11.0)
    # One realization was drawn twice
    np.testing.assert_array_equal(groups, [0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 0])
    found = predicted(reference, angle, core, rate, groups)

    time = (np.arange(whole) - context) / samples
    functions, lags = FourierSeries(4)(time), np.arange(-early, late + 1)
    prior = np.outer(
        np.exp(-np.maximum(lags, 0) / rate / 0.08) + 1e-3,
        1 / (1 + np.array([0, 1, 1, 2, 2, 3, 3, 4, 4.0]) ** 2),
    )
    columns = np.stack(
        [
            f * reference[:, late - k : late - k + whole] * np.sqrt(v)
            for k, row in zip(lags, prior, strict=True)
            for f, v in zip(functions.T, row, strict=True)
        ],
        axis=-1,
    )
    x, y = columns[:, core].reshape(-1, columns.shape[-1]), angle[:, core].ravel()
    evidence = ridge(Moments(x.T @ x, x.T @ y, y @ y, len(y)))
    penalty = evidence.noise_variance * evidence.effective / (evidence.mean @ evidence.mean)
    for group in range(5):
        x = columns[groups != group, core].reshape(-1, columns.shape[-1])
        weights = np.linalg.solve(
            x.T @ x + penalty * np.eye(x.shape[1]), x.T @ angle[groups != group, core].ravel()
        )
        np.testing.assert_allclose(
            found[groups == group], columns[groups == group] @ weights, rtol=1e-8, atol=1e-10
        )


def test_where_the_reference_tells_the_whole_angle_nothing_changes(monkeypatch):
    monkeypatch.setattr(instrument, "_predicted", lambda ensemble, reference: ensemble.angle)
    ensemble = loop()
    for method, tolerance in (
        (tv.BasisIRF(), 1e-10),
        (tv.EnsembleSpectral(stiffness="fit"), 1e-8),
        # Both stop where the noise variance stands to 2e-3.
        (tv.KernelRegression(), 2e-3),
        (tv.KernelRegression(weighting="residual"), 2e-3),
    ):
        with_it = attrs.evolve(method, reference=D).identify(ensemble)
        without = method.identify(ensemble)
        np.testing.assert_allclose(with_it.stiffness, without.stiffness, rtol=tolerance)
        if method.key == "kbr":
            one, other = (x.estimates["stiffness"].standard_error for x in (with_it, without))
            np.testing.assert_allclose(one.values, other.values, rtol=1e-2)


def test_segments_are_fitted_by_moments_with_the_predicted_angle():
    ensemble, model = loop(), identified(ESM)
    moved = ESM._moved(ensemble, D)[0]
    at, window = ensemble.context + 70, hann(30) ** 2
    z, x = (
        differentiate(each.angle, 100.0)[:, :, at - 15 - 12 : at + 15 - 12]
        for each in (moved, ensemble)
    )
    y = ensemble.torque[:, at - 15 : at + 15]
    a, c = np.einsum("art,brt,t->rab", z, x, window), np.einsum("art,rt,t->ra", z, y, window)
    inverse = np.linalg.inv(a.sum(axis=0))
    impedance = inverse @ c.sum(axis=0)
    scores = c - a @ impedance
    variance = np.diag(inverse @ scores.T @ scores @ inverse.T) * 20 / (20 - 1 - 3)
    for place, name in enumerate(("stiffness", "viscosity", "inertia")):
        estimate = model.estimates[name]
        assert estimate.values[70] == pytest.approx(impedance[place], rel=1e-9)
        assert estimate.standard_error.values[70] == pytest.approx(
            np.sqrt(variance[place]), rel=1e-8
        )
        assert estimate.standard_error.freedom[70] == 16
    # The strength: what belongs to viscosity and inertia taken out of instrument and angle.
    by, out = (np.linalg.solve(m[1:, 1:], m[1:, 0]) for m in (a.sum(axis=0).T, a.sum(axis=0)))
    q = [np.r_[1, -by] @ own @ np.r_[1, -out] for own in a]
    assert model.diagnostics.strength[70] == pytest.approx(
        np.sum(q) ** 2 / np.sum(np.square(q)), rel=1e-8
    )


@pytest.mark.parametrize("time", [0, 70])
def test_short_segments_are_two_stage_least_squares(time):
    ensemble = tv.Ensemble(
        *(each[:, 44:256] for each in (loop().angle, loop().torque)),
        100.0,
        6,
        channels={D: loop().channels[D][:, 44:256]},
        mean_subtracted=True,
    )
    method = tv.ShortDataSegments(max_lag=0.03, window=0.04, reference=D)
    model = method.identify(ensemble)
    whole = np.pad(ensemble.channels[D], ((0, 0), (30, 3)))
    z, x, y, of = [], [], [], []
    for centre in range(max(6 + time - 2, 3), 6 + time + 3):
        z.append(whole[:, centre : centre + 34][:, ::-1])
        x.append(ensemble.angle[:, centre - 3 : centre + 4][:, ::-1])
        y.append(ensemble.torque[:, centre])
        of.append(np.arange(20))
    z, x, y, of = (np.concatenate(each) for each in (z, x, y, of))
    values, vectors = np.linalg.eigh(z.T @ z)
    vectors = vectors[:, values > 1e-3 * values[-1]]
    first = vectors @ np.linalg.lstsq(z @ vectors, x, rcond=None)[0]
    values, kept = np.linalg.eigh((z @ first).T @ (z @ first))
    kept = kept[:, values > 1e-2 * values[-1]]
    by = kept @ np.linalg.lstsq(z @ first @ kept, np.eye(len(y)), rcond=None)[0]
    response = by @ y
    np.testing.assert_allclose(model.impulse_response[time] / 100, response, rtol=1e-7, atol=1e-9)
    scores = np.bincount(of, by.sum(axis=0) * (y - x @ response))
    variance = np.sum(scores**2) * 20 / 18 / (1 - kept.shape[1] / (len(y) * 19 / 20))
    assert model.estimates["stiffness"].standard_error.values[time] == pytest.approx(
        np.sqrt(variance), rel=1e-6
    )


@pytest.mark.slow
def test_closed_loop_estimates_are_right_where_open_ones_are_not():
    truth = np.asarray(tv.simulate.SineWave()(loop().time))
    for method, mean, random in (
        (KBR, 4.0, 11.0),
        (ESM, 5.0, 16.0),
        (tv.BasisIRF(reference=D), 4.0, 12.0),
    ):
        models = [identified(method, 100.0, 5.0, 5.0, seed) for seed in SEEDS]
        error = np.stack([model.stiffness for model in models]) - truth
        spread = np.sqrt(np.mean(error.var(axis=0, ddof=1)))
        assert abs(error.mean()) < mean
        assert spread < random
        bands = [model.estimates["stiffness"].band() for model in models]
        assert 0.85 < np.mean([(lower <= truth) & (truth <= upper) for lower, upper in bands]) <= 1
        errors = np.stack([model.estimates["stiffness"].standard_error.values for model in models])
        assert 0.75 < np.sqrt(np.mean(errors**2)) / spread < 1.35
        assert all(
            86 < model.diagnostics.details["predicted_by_reference"] < 91 for model in models
        )
        assert all(model.diagnostics.details["second_order_agreement"] > 99 for model in models)
    opened = [tv.KernelRegression().identify(loop(seed=seed)).stiffness - truth for seed in SEEDS]
    assert np.mean(opened) < -18


def test_a_weak_reference_is_refused_or_has_no_band():
    weak = loop(3.0, 2.0, -10.0)
    for method in (ESM, tv.BasisIRF(reference=D), tv.ShortDataSegments(reference=D)):
        with pytest.raises(
            tv.InputError,
            match=r"the disturbance 'disturbance' hardly moves the angle: it predicts .* %",
        ):
            method.identify(weak)
    KBR.identify(weak)
    half = loop(30.0, 2.0, -5.0)
    with pytest.warns(
        tv.DataQualityWarning,
        match=r"predicts only .* % of the angle: .* disturb more strongly",
    ):
        model = ESM.identify(half)
    assert any("no band at" in text for text in model.diagnostics.warnings)
    error = model.estimates["stiffness"].standard_error
    needed = stats.t.ppf(0.975, 16) ** 2 * 19 / 16
    np.testing.assert_array_equal(np.isnan(error.values), model.diagnostics.strength < needed)
    assert 0 < np.isnan(error.values).mean() < 1
    assert not error.absent
    few = ESM.identify(loop().select(np.arange(4))).estimates["stiffness"]
    with pytest.warns(
        tv.DataQualityWarning,
        match="no band: the reference hardly moves the angle there, or in too few",
    ):
        assert np.isnan(few.band()).all()
    constant = attrs.evolve(half, channels={D: np.ones_like(half.angle)})
    with pytest.raises(tv.InputError, match="does not vary between realizations"):
        KBR.identify(constant)


def test_settings_that_cannot_be():
    for word, message in (
        ("esm:reference=d", "stiffness must be 'fit' .esm:stiffness=fit,reference=d."),
        ("birf:model=irf,reference=d", "model must be 'parametric'"),
        ("kbr:weighting=best", "weighting must be one of 'white', 'residual'"),
    ):
        with pytest.raises(tv.InputError, match=message):
            tv.methods.parse(word)
    with pytest.raises(tv.InputError, match=r"it needs the channel 'command' \(reference"):
        tv.methods.parse("kbr:reference=command").identify(loop())
    with pytest.raises(tv.InputError, match="expected at least two, got one"):
        KBR.identify(loop().select([0]))


def test_settings_are_chosen_by_what_the_reference_moves():
    ensemble = loop()
    moved = tv.BasisIRF(reference=D)._moved(ensemble, D)[0]
    chosen = tv.BasisIRF(reference=D).tuned(ensemble).method
    assert chosen.reference == D
    assert attrs.evolve(chosen, reference=None) == tv.BasisIRF().tuned(moved).method
