import attrs
import numpy as np
import pytest
from tests.conftest import ensemble_of
from tests.numerics.test_gaussian import moments_of

import tvsysid as tv
from tvsysid.methods.kbr.kbr import fitted_weights

# The paper's settings for its experiment (section 4.2).
EXPERIMENT = tv.KernelRegression(length_periodic=np.exp(-1), length_decay=30.0, gamma=13.8)


@pytest.mark.slow
def test_gaps_are_gaps():
    ensemble = ensemble_of(60.0, "sine", "noise", 30.0)
    truth = tv.simulate.SineWave()(ensemble.time)
    for kept in (np.arange(30) % 5 != 2, np.arange(30) % 2 == 0):
        for method in (tv.KernelRegression(), EXPERIMENT):
            model = method.identify(ensemble.select(kept))
            assert np.abs(model.stiffness - truth).max() < 4


def test_offset_and_drift_of_the_torque_go_to_the_external_term():
    ensemble = ensemble_of(40.0, "sine", "noise", 20.0)
    clock = ensemble.onsets[:, None] + np.arange(ensemble.angle.shape[1]) / 100
    drifting = attrs.evolve(ensemble, torque=ensemble.torque + 2 * np.cos(np.pi * clock / 40))
    plain = tv.KernelRegression().identify(ensemble)
    mended = tv.KernelRegression().identify(drifting)
    assert np.abs(mended.stiffness - plain.stiffness).max() < 2.5


@pytest.mark.parametrize("decay", [120_000.0, 300.0])
def test_prediction_is_at_the_phase_of_each_realization(decay):
    simulation = tv.simulate.Joint(stiffness=tv.simulate.SineWave()).simulate(
        90, perturbation=tv.simulate.FilteredNoise(), snr_db=60, seed=3
    )
    recording = tv.preprocess.decimate(simulation.recording, 100)
    ensemble = tv.preprocess.segment(recording, 2.0)
    model = tv.KernelRegression(length_decay=decay).identify(ensemble)
    assert tv.metrics.vaf(ensemble.torque[:, ensemble.core], model.predict(ensemble)).min() > 98
    # Realizations that begin at another phase than those identified from are predicted at theirs.
    late = attrs.evolve(recording, start=recording.start - 0.5)
    other = tv.preprocess.segment(late, 2.0)
    other = attrs.evolve(other, onsets=other.onsets + 0.5)
    assert tv.metrics.vaf(other.torque[:, other.core], model.predict(other)).min() > 98


@pytest.mark.parametrize("context", [0.0, 0.05])
def test_realizations_without_context_lose_only_the_ends_of_a_run(context):
    whole = ensemble_of(40.0, "sine", "noise", 30.0)
    short = ensemble_of(40.0, "sine", "noise", 30.0, context=context)
    one, other = (tv.KernelRegression().identify(each) for each in (whole, short))
    errors = one.estimates["stiffness"].standard_error.values
    assert (np.abs(one.stiffness - other.stiffness) < errors).all()


DEGREE = np.degrees(1.0)  # 1 N·m/deg in N·m/rad


@pytest.mark.parametrize("perturbation", ["noise", "prbs"])
@pytest.mark.parametrize("profile", ["square", "sine"])
def test_of_the_papers_joint_gamma_counts_in_newton_metres_per_degree(profile, perturbation):
    for duration in (40.0, 150.0):
        ensemble = ensemble_of(duration, profile, perturbation)
        own, fixed = (
            tv.KernelRegression(scale=scale).identify(ensemble) for scale in (None, DEGREE)
        )
        assert own.scale == pytest.approx(DEGREE, rel=0.04)
        assert np.abs(own.stiffness - fixed.stiffness).max() < 0.2


@pytest.mark.parametrize(
    ("settings", "rate"),
    [
        ({}, 1e-9),
        ({"length_decay": 1e-9}, 100.0),
    ],
)
def test_kernels_that_would_fill_the_memory_are_refused(settings, rate):
    ensemble = ensemble_of(40.0)
    ensemble = attrs.evolve(ensemble, sampling_rate=rate, onsets=ensemble.onsets * 100 / rate)
    with pytest.raises(tv.InputError, match="need too many features of each coefficient"):
        tv.KernelRegression(**settings).identify(ensemble)


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


def test_two_realizations_leave_no_noise_to_find_settings_by():
    two = tv.preprocess.subtract_mean(ensemble_of(40.0, "sine", "noise").select([0, 1]))
    why = r"explains the torque without any noise; give more realizations"
    with pytest.raises(tv.InputError, match=why):
        tv.KernelRegression().tuned(two)


@pytest.mark.parametrize("has_instruments", [False, True])
def test_the_fit_equals_its_equations(random, has_instruments):
    x, noise = random.standard_normal((400, 3)) * [1, 100, 0.01], random.standard_normal(400)
    z = x + has_instruments * 0.3 * random.standard_normal((400, 3)) * [1, 100, 0.01]
    y = x @ [2, 0.03, 150] + noise
    precision = np.array([0.0, 1e3, 1e-3])
    moments = moments_of(np.hstack([x, z] if has_instruments else [x]), y)
    found = fitted_weights(moments, precision)
    p, s = np.diag(precision), found.noise_variance
    inverse = np.linalg.inv(z.T @ x + s * p)
    np.testing.assert_allclose(found.mean, inverse @ z.T @ y, rtol=1e-9)
    left = y - x @ found.mean
    assert s == pytest.approx(left @ left / (400 - found.effective), rel=1e-4)
    np.testing.assert_allclose(found.covariance, s * inverse @ (z.T @ z + s * p) @ inverse.T)
