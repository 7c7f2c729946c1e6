"""A joint that rings (5 Hz, damping ratio 0.1), simulated independently."""

import warnings

import numpy as np
import pytest
from tests.independent import ensemble_of, impulses, noise, ringing, with_noise

import tvsysid as tv
from tvsysid.quality.amount import MAX_INFLATION, angle_inflation
from tvsysid.quality.fit import lowered

STIFFNESS, VISCOSITY, INERTIA = 60.0, 0.38, 0.06


def driven(drive, angle_noise=0.0):
    """80 s of the joint, moved by a torque."""
    random = np.random.default_rng(1)
    torque = drive(80_000, random)
    angle = ringing(torque, STIFFNESS, VISCOSITY, INERTIA)
    scale = 0.0087 / angle.std()
    angle = scale * angle + angle_noise * random.standard_normal(len(angle))
    return ensemble_of(angle, with_noise(scale * torque, 20.0, random))


@pytest.fixture(scope="module")
def struck():
    """An impulse a second, and a noise of the angle of 0.1 mrad."""
    return driven(lambda samples, random: impulses(samples, random, 0.3), 1e-4)


@pytest.fixture(scope="module")
def shaken():
    return driven(lambda samples, random: noise(samples, 0.0, 20.0, random))


def quietly(key, ensemble):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tv.DataQualityWarning)
        return tv.methods.parse(key).identify(ensemble)


def test_ringing_does_not_mislead_a_method_of_a_constant_joint(struck):
    assert np.nanmean(quietly("pc", struck).stiffness) == pytest.approx(STIFFNESS, rel=0.03)


def test_the_diagnosis_says_that_the_joint_rings(struck, shaken):
    assert any("like a free oscillation" in text for text in tv.diagnose(struck).remarks)
    assert not tv.diagnose(shaken).remarks


def test_inertia_that_leaks_into_0_hz_is_told(shaken):
    leaking = quietly("esm", shaken)
    assert any("inertia leaks into 0 Hz" in text for text in leaking.diagnostics.warnings)
    assert np.nanmean(leaking.stiffness) < 0.7 * STIFFNESS
    for key in ("esm:stiffness=fit", "sds", "birf", "kbr"):
        found = quietly(key, shaken)
        assert np.nanmean(found.stiffness) == pytest.approx(STIFFNESS, rel=0.03)
        assert not found.diagnostics.warnings


@pytest.mark.parametrize("realizations", [1, 3, 20])
@pytest.mark.parametrize("perturbation", ["noise", "prbs", "pulses", "multisine"])
def test_no_usual_perturbation_moves_a_joint_like_a_free_oscillation(perturbation, realizations):
    joint = tv.simulate.Joint(stiffness=tv.simulate.SquareWave())
    moved = tv.simulate.PERTURBATIONS[perturbation]
    recording = joint.simulate(40, perturbation=moved, snr_db=10, seed=1).recording
    for ensemble in (recording, tv.preprocess.decimate(recording, 100)):
        cut = tv.preprocess.segment(ensemble, 2.0).select(range(realizations))
        low = lowered(cut)
        inflation = angle_inflation(low.derivatives(), low.sampling_rate)
        assert inflation.max() < 0.7 * MAX_INFLATION
