import warnings

import attrs
import numpy as np
import pytest
from tests.conftest import standard_errors_of

import tvsysid as tv
from tvsysid.methods.kbr import record
from tvsysid.methods.kbr.record import lagged
from tvsysid.numerics.differentiation import differentiate


def test_shifts_in_frequency_equal_products_in_time(ensemble_of, monkeypatch):
    ensemble = ensemble_of(40.0, "sine", "prbs")
    for method in (
        tv.KernelRegression(),
        tv.KernelRegression.preset("experiment", band=(1.0, 19.0)),
    ):
        fast = method.identify(ensemble)
        with monkeypatch.context() as patched:
            patched.setattr(
                record.Runs, "_shifted", lambda *arguments: record.Runs._transformed(*arguments[:4])
            )
            slow = method.identify(ensemble)
        np.testing.assert_allclose(fast.stiffness, slow.stiffness, rtol=1e-6)
        np.testing.assert_allclose(fast.inertia, slow.inertia, rtol=1e-4)


@pytest.mark.slow
def test_gaps_are_gaps(ensemble_of):
    ensemble = ensemble_of(60.0, "sine", "noise", 30.0)
    truth = tv.simulate.SineWave()(ensemble.time)
    for kept in (np.arange(30) % 5 != 2, np.arange(30) % 2 == 0):
        for method in (tv.KernelRegression(), tv.KernelRegression.preset("experiment")):
            model = method.identify(ensemble.select(kept))
            assert np.abs(model.stiffness - truth).max() < 4


def test_a_stiffness_that_drifts_is_followed_by_a_decaying_kernel():
    def profile(time):
        return 100 + 30 * np.sin(np.pi * time) + 0.4 * time

    simulation = tv.simulate.Joint(stiffness=profile).simulate(
        60, perturbation=tv.simulate.FilteredNoise(), snr_db=20, seed=3
    )
    ensemble = tv.preprocess.segment(tv.preprocess.decimate(simulation.recording, 100), 2.0)
    truth = np.stack([profile(onset + ensemble.time) for onset in ensemble.onsets])
    model = tv.KernelRegression.preset("experiment").identify(ensemble)
    stiffness, _, _ = model.impedance(ensemble)
    assert stiffness.shape == truth.shape
    assert np.sqrt(np.mean((stiffness - truth) ** 2)) < 4
    np.testing.assert_allclose(model.stiffness, stiffness.mean(axis=0), rtol=1e-9)
    strict = tv.KernelRegression().identify(ensemble)
    assert np.sqrt(np.mean((strict.stiffness - truth) ** 2)) > 5


def test_offset_and_drift_of_the_torque_go_to_the_external_term(ensemble_of):
    ensemble = ensemble_of(40.0, "sine", "noise", 20.0)
    clock = ensemble.onsets[:, None] + np.arange(ensemble.angle.shape[1]) / 100
    drifting = attrs.evolve(ensemble, torque=ensemble.torque + 2 * np.cos(np.pi * clock / 40))
    plain = tv.KernelRegression().identify(ensemble)
    mended = tv.KernelRegression().identify(drifting)
    assert np.abs(mended.stiffness - plain.stiffness).max() < 2.5


@pytest.mark.parametrize("duration", [2.0, 3.0, 1.5])
@pytest.mark.parametrize("decay", [120_000.0, 300.0])
def test_prediction_is_at_the_phase_of_each_realization(duration, decay):
    simulation = tv.simulate.Joint(stiffness=tv.simulate.SineWave()).simulate(
        90, perturbation=tv.simulate.FilteredNoise(), snr_db=60, seed=3
    )
    recording = tv.preprocess.decimate(simulation.recording, 100)
    method, ensemble = (
        tv.KernelRegression(period=2.0, length_decay=decay),
        tv.preprocess.segment(recording, duration),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tv.DataQualityWarning)
        model = method.identify(ensemble)
    assert tv.metrics.vaf(ensemble.torque[:, ensemble.core], model.predict(ensemble)).min() > 98
    # Realizations that begin at another phase than those identified from are predicted at theirs.
    late = attrs.evolve(recording, start=recording.start - 0.5)
    other = tv.preprocess.segment(late, duration)
    other = attrs.evolve(other, onsets=other.onsets + 0.5)
    assert tv.metrics.vaf(other.torque[:, other.core], model.predict(other)).min() > 98


def test_presets_are_the_papers():
    assert tv.KernelRegression.preset("simulation") == tv.KernelRegression()
    experiment = tv.KernelRegression.preset("experiment")
    assert (experiment.length_decay, experiment.gamma) == (30.0, 13.8)
    assert experiment.length_periodic == pytest.approx(np.exp(-1))
    assert tv.methods.parse("kbr:preset=experiment,gamma=5") == attrs.evolve(experiment, gamma=5.0)


DEGREE = np.degrees(1.0)  # 1 N·m/deg in N·m/rad


@pytest.mark.parametrize("perturbation", ["noise", "prbs"])
@pytest.mark.parametrize("profile", ["square", "sine"])
def test_of_the_papers_joint_gamma_counts_in_newton_metres_per_degree(
    ensemble_of, profile, perturbation
):
    for duration in (40.0, 150.0):
        ensemble = ensemble_of(duration, profile, perturbation)
        scale = tv.KernelRegression()._scale(record.Record.of(ensemble, (0.0, 20.0)))
        assert scale == pytest.approx(DEGREE, rel=0.04)
        own, fixed = (
            tv.KernelRegression(scale=scale).identify(ensemble) for scale in (None, DEGREE)
        )
        assert np.abs(own.stiffness - fixed.stiffness).max() < 0.2


def test_a_scale_that_is_given_depends_on_no_data(ensemble_of):
    ensemble = ensemble_of(40.0)
    softer = attrs.evolve(ensemble, torque=0.01 * ensemble.torque)
    one = tv.KernelRegression(scale=DEGREE).identify(ensemble)
    same = tv.KernelRegression(scale=0.01 * DEGREE).identify(softer)
    np.testing.assert_allclose(same.stiffness, 0.01 * one.stiffness, rtol=1e-9)
    other = tv.KernelRegression(scale=DEGREE).identify(softer)
    assert np.abs(other.stiffness - 0.01 * one.stiffness).max() > 0.01


@pytest.mark.parametrize(
    ("settings", "rate"),
    [
        ({}, 1e-9),
        ({"length_decay": 1e-9}, 100.0),
        ({"length_periodic": 1e-12, "period": 1e3}, 100.0),
    ],
)
def test_kernels_that_would_fill_the_memory_are_refused(ensemble_of, settings, rate):
    ensemble = ensemble_of(40.0)
    ensemble = attrs.evolve(ensemble, sampling_rate=rate, onsets=ensemble.onsets * 100 / rate)
    with pytest.raises(tv.InputError, match="need more than 5400 features of each coefficient"):
        tv.KernelRegression(**settings).identify(ensemble)


# Other orders, and a lag.


def test_what_a_lower_order_leaves_out_is_none_and_has_no_band(ensemble_of):
    ensemble = ensemble_of(40.0, "sine", "noise")
    model = tv.KernelRegression(order=1).identify(ensemble)
    np.testing.assert_array_equal(model.inertia, 0.0)
    deviation = standard_errors_of(model)
    assert np.isfinite(deviation[:2]).all()
    assert np.isnan(deviation[2]).all()
    with pytest.warns(
        tv.DataQualityWarning, match=r"no band: the model has no inertia \(order 1\)"
    ):
        assert np.isnan(model.estimates["inertia"].band()).all()
    angle, velocity, _ = differentiate(ensemble.angle[:, 38:-38], 100.0)
    torque = model.stiffness * angle + model.viscosity * velocity
    np.testing.assert_allclose(model.predict(ensemble), torque, atol=1e-12)


def lagging(ensemble_of, lag, **settings):
    """The joint of an ensemble with its torque behind a lag, noise and all."""
    ensemble = ensemble_of(**settings)
    return attrs.evolve(
        ensemble, torque=lagged(attrs.evolve(ensemble, angle=ensemble.torque), lag).angle
    )


@pytest.mark.parametrize("context", [0.0, 0.5])
def test_a_lag_that_is_told_no_longer_biases(ensemble_of, context):
    ensemble = lagging(
        ensemble_of, 0.008, duration=80.0, profile="sine", snr_db=40.0, context=context
    )
    blind = tv.KernelRegression().identify(ensemble)
    seeing = tv.KernelRegression(lag=0.008).identify(ensemble)
    truth = tv.simulate.SineWave()(ensemble.time)
    assert blind.viscosity.mean() < 1.7
    assert blind.inertia.mean() < 0.008
    assert seeing.viscosity.mean() == pytest.approx(2.2, abs=0.02)
    assert seeing.inertia.mean() == pytest.approx(0.02, abs=0.0005)
    # Stiffness changes by up to 2 % over the lag.
    assert np.abs(seeing.stiffness - truth).max() < 3.0


def test_two_realizations_leave_no_noise_to_find_settings_by(ensemble_of):
    two = tv.preprocess.subtract_mean(ensemble_of(40.0, "sine", "noise").select([0, 1]))
    with pytest.raises(tv.InputError, match=r"explained without any noise; give more realizations"):
        tv.KernelRegression().tuned(two)
