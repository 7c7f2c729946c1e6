"""Test skirt decomposition: exact in its span, bands as wide as the error, and its limits."""

import numpy as np
import pytest
from tests.conftest import realizations
from tests.independent import ensemble_of, motion, with_noise

import tvsysid as tv
from tvsysid.simulate import Joint, Multisine, SineWave

SKIRT = tv.SkirtDecomposition()


def perturbed(perturbation, snr_db=10.0, seed=1, stiffness=None, duration=40.0):
    joint = Joint(stiffness or SineWave())
    recording = joint.simulate(
        duration, perturbation=perturbation, snr_db=snr_db, seed=seed
    ).recording
    return realizations(recording)


@pytest.fixture(scope="module")
def quiet():
    return perturbed(Multisine(), np.inf)


def test_a_change_in_the_span_is_recovered(quiet):
    few = quiet.select(range(17))  # over which the mean of a line is not 0
    for ensemble in (quiet, tv.preprocess.subtract_mean(quiet), tv.preprocess.subtract_mean(few)):
        model = SKIRT.identify(ensemble)
        assert model.diagnostics.details["lines"] == 5
        assert np.abs(model.stiffness - SineWave()(model.time)).max() < 0.02
        np.testing.assert_allclose(model.viscosity, 2.2, rtol=5e-3)
        np.testing.assert_allclose(model.inertia, 0.02, rtol=6e-3)
        torque = ensemble.torque[:, ensemble.core]
        assert np.nanmin(tv.metrics.vaf(torque, model.predict(ensemble))) > 99.9


def test_bands_are_as_wide_as_the_error():
    models = [SKIRT.identify(perturbed(Multisine(), seed=300 + trial)) for trial in range(24)]
    stiffness = np.stack([model.stiffness for model in models])
    truth = SineWave()(models[0].time)
    error = np.sqrt(np.mean((stiffness - truth) ** 2))
    assert error < 2.0
    stated = np.mean([model.estimates["stiffness"].standard_error.values for model in models])
    assert stated == pytest.approx(error, rel=0.2)


def changing(time, harmonics):
    return 100 + sum(60 / len(harmonics) * np.sin(np.pi * each * time + each) for each in harmonics)


def independently(harmonics, seed):
    """Simulate 40 s at 10 dB of a joint whose stiffness has these harmonics.

    The package is not used.
    """
    random, time = np.random.default_rng(seed), np.arange(40_000) / 1000
    turns = 2 * np.pi * (np.outer(Multisine().frequencies, time) + random.random((5, 1)))
    moved = motion(0.0039 * np.sin(turns).sum(axis=0))
    torque = changing(time, harmonics) * moved[0] + 2.2 * moved[1] + 0.02 * moved[2]
    return ensemble_of(moved[0], with_noise(torque, 10.0, random))


@pytest.mark.parametrize("harmonics", [(), (1,), (1, 3)])
def test_as_many_harmonics_are_fitted_as_the_torque_shows(harmonics):
    errors, held = [], []
    for seed in range(4):
        model = SKIRT.identify(independently(harmonics, seed))
        assert model.diagnostics.details["harmonics"] in {
            max(harmonics, default=0),
            2 if len(harmonics) < 2 else 3,
        }
        truth, (lower, upper) = changing(model.time, harmonics), model.estimates["stiffness"].band()
        errors.append(model.stiffness - truth)
        held.append((lower <= truth) & (truth <= upper))
    assert np.sqrt(np.mean(np.square(errors))) < 4
    assert np.mean(held) > 0.85


@pytest.mark.parametrize(
    ("harmonics", "told"),
    [
        ((4,), "skirts of harmonic 4"),  # for which the lines leave no room
        ((1, 5), "lines that do not agree with each other"),
    ],
)
def test_a_change_that_is_not_fitted_is_told(harmonics, told):
    with pytest.warns(tv.DataQualityWarning, match=told):
        model = SKIRT.identify(independently(harmonics, 1))
    assert np.sqrt(np.mean((model.stiffness - changing(model.time, harmonics)) ** 2)) > 10


@pytest.mark.parametrize(
    ("perturbation", "message"),
    [
        (
            tv.simulate.FilteredNoise(),
            r"the angle is no multisine of two or more lines, .* explain \d.* % of it, and 99 %",
        ),
        (Multisine((2.3,)), r"no multisine of two or more lines, .*: the 1 found explain"),
    ],
)
def test_what_it_does_not_serve_is_said_in_words(perturbation, message):
    ensemble = perturbed(perturbation)
    with pytest.raises(tv.InputError, match=message):
        SKIRT.identify(ensemble)
