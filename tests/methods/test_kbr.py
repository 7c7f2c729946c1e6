import attrs
import numpy as np
import pytest
from tests.conftest import ensemble_of

import tvsysid as tv
from tvsysid.methods.kbr.kernel import Kernel
from tvsysid.methods.kbr.record import moments_of, runs_of

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


def test_a_stiffness_that_drifts_is_followed_by_a_decaying_kernel():
    def profile(time):
        return 100 + 30 * np.sin(np.pi * time) + 0.4 * time

    simulation = tv.simulate.Joint(stiffness=profile).simulate(
        60, perturbation=tv.simulate.FilteredNoise(), snr_db=20, seed=3
    )
    ensemble = tv.preprocess.segment(tv.preprocess.decimate(simulation.recording, 100), 2.0)
    truth = np.stack([profile(onset + ensemble.time) for onset in ensemble.onsets])
    model = EXPERIMENT.identify(ensemble)
    stiffness = model.impedance(ensemble)[..., 0]
    assert stiffness.shape == truth.shape
    assert np.sqrt(np.mean((stiffness - truth) ** 2)) < 4
    np.testing.assert_allclose(model.stiffness, stiffness.mean(axis=0), rtol=1e-9)
    strict = tv.KernelRegression().identify(ensemble)
    assert np.sqrt(np.mean((strict.stiffness - truth) ** 2)) > 5


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
        kernel = Kernel.of(ensemble, 1.0, np.inf)
        moments = moments_of(runs_of([ensemble], kernel, (0.0, 20.0)), kernel)
        scale = tv.KernelRegression()._scale(moments, kernel.columns)
        assert scale == pytest.approx(DEGREE, rel=0.04)
        own, fixed = (
            tv.KernelRegression(scale=scale).identify(ensemble) for scale in (None, DEGREE)
        )
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
    with pytest.raises(tv.InputError, match=r"explained without any noise; give more realizations"):
        tv.KernelRegression().tuned(two)
