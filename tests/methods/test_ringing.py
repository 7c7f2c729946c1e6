"""A joint that rings (5 Hz, damping ratio 0.1), simulated independently."""

import warnings

import numpy as np
import pytest
from tests.independent import ensemble_of, impulses, noise, ringing, with_noise

import tvsysid as tv

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


def test_inertia_that_leaks_into_0_hz_is_told(shaken):
    leaking = quietly("esm", shaken)
    assert any("inertia leaks into 0 Hz" in text for text in leaking.diagnostics.warnings)
    assert np.nanmean(leaking.stiffness) < 0.7 * STIFFNESS
    for key in ("esm:stiffness=fit", "sds", "birf", "kbr"):
        found = quietly(key, shaken)
        assert np.nanmean(found.stiffness) == pytest.approx(STIFFNESS, rel=0.03)
        assert not found.diagnostics.warnings
