"""A reference as the instrument, and frequencies weighted by the residual."""

from functools import cache

import attrs
import numpy as np
import pytest
from tests.conftest import realizations

import tvsysid as tv
from tvsysid.methods.shared import instrument
from tvsysid.numerics.bases import FourierSeries
from tvsysid.numerics.gaussian import Moments, ridge
from tvsysid.numerics.instrument import predicted, realization_groups

D = "disturbance"
SEEDS = range(100, 104)
KBR = tv.KernelRegression(reference=D, weighting="residual")
BIRF = tv.BasisIRF(reference=D)
ESM = tv.EnsembleSpectral(stiffness="fit", reference=D)
SDS = tv.ShortDataSegments(reference=D)


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
    ensemble = realizations(simulation.recording)
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
        (tv.EnsembleSpectral(stiffness="fit"), 1e-10),
        (tv.ShortDataSegments(), 1e-10),
        # Both stop where the noise variance stands to 2e-3.
        (tv.KernelRegression(), 2e-3),
        (tv.KernelRegression(weighting="residual"), 2e-3),
    ):
        with_it = attrs.evolve(method, reference=D).identify(ensemble)
        without = method.identify(ensemble)
        np.testing.assert_allclose(with_it.stiffness, without.stiffness, rtol=tolerance)
        if method.key != "birf":
            one, other = (x.estimates["stiffness"].standard_error for x in (with_it, without))
            np.testing.assert_allclose(one.values, other.values, rtol=1e-2)


@pytest.mark.slow
def test_closed_loop_estimates_are_right_where_open_ones_are_not():
    truth = np.asarray(tv.simulate.SineWave()(loop().time))
    cases = (KBR, 4.0, 11.0), (BIRF, 4.0, 12.0), (ESM, 5.0, 16.0), (SDS, 9.0, 40.0)
    for method, mean, random in cases:
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


def test_a_weak_reference_is_refused_or_warned_of():
    weak = loop(3.0, 2.0, -10.0)
    for method in (BIRF, ESM, SDS):
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
        BIRF.identify(half)
    constant = attrs.evolve(half, channels={D: np.ones_like(half.angle)})
    for ensemble in (constant, half.select([0])):
        with pytest.raises(tv.InputError, match="does not vary between realizations"):
            KBR.identify(ensemble)


def test_settings_that_cannot_be():
    for word, message in (
        ("birf:model=irf,reference=d", "model must be 'parametric'"),
        ("esm:reference=d", "stiffness must be 'fit'"),
        ("kbr:weighting=best", "weighting must be one of 'white', 'residual'"),
    ):
        with pytest.raises(tv.InputError, match=message):
            tv.methods.parse(word)
    with pytest.raises(tv.InputError, match=r"it needs the channel 'command' \(reference"):
        tv.methods.parse("kbr:reference=command").identify(loop())


def test_settings_are_chosen_by_what_the_reference_moves():
    ensemble = loop()
    instrument = BIRF._instrument(ensemble, D)[0]
    chosen = BIRF.tuned(ensemble).method
    assert chosen.reference == D
    assert attrs.evolve(chosen, reference=None) == tv.BasisIRF().tuned(instrument).method
