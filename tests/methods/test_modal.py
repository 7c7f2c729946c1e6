"""Modal decomposition: what a joint that rings tells, and words where none does."""

import attrs
import numpy as np
import pytest
from tests.conftest import realizations
from tests.independent import ensemble_of, impulses, with_noise
from tests.independent import ringing as shaken

import tvsysid as tv
from tvsysid.methods import resolve
from tvsysid.simulate import PERTURBATIONS, SYSTEMS, Constant, Pulses

MODAL = tv.ModalDecomposition()
IMPULSES = Pulses(duration=0.02, interval=1.0)


def hit(perturbation=IMPULSES, snr_db=30.0, duration=40.0, **changes):
    joint = attrs.evolve(
        resolve(MODAL.system, SYSTEMS, "system"), **({"stiffness": Constant(100.0)} | changes)
    )
    recording = joint.simulate(duration, perturbation=perturbation, snr_db=snr_db, seed=1).recording
    return realizations(recording)


@pytest.fixture(scope="module")
def ringing():
    return hit()


def test_a_joint_that_rings_tells_its_stiffness(ringing):
    for ensemble in (ringing, tv.preprocess.subtract_mean(ringing)):
        model = MODAL.identify(ensemble)
        known = np.isfinite(model.stiffness)
        assert known.mean() > 0.9
        assert np.abs(model.stiffness[known] - 100.0).mean() < 3.0
        assert np.mean(model.viscosity[known]) == pytest.approx(1.3, rel=0.06)
        np.testing.assert_allclose(model.inertia[known], 0.1, rtol=2e-3)
        lower, upper = model.estimates["stiffness"].band()
        banded = np.isfinite(lower)
        assert banded.mean() > 0.7
        assert (lower[banded] < upper[banded]).all()


@pytest.mark.parametrize("damping", [0.1, 0.2, 0.3])
def test_no_single_time_is_far_off_and_bands_hold(damping):
    """80 s at 30 dB, not simulated by the package.

    Some impulses fall into the ringing of those before.
    """
    viscosity, errors, held = 2 * damping * np.sqrt(100.0 * 0.1), [], []
    for seed in range(2):
        random = np.random.default_rng(seed)
        torque = impulses(80_000, random, 0.45)
        angle = shaken(torque, 100.0, viscosity, 0.1)
        model = MODAL.identify(ensemble_of(angle, with_noise(torque, 30.0, random)))
        lower, upper = model.estimates["stiffness"].band()
        errors.append(model.stiffness - 100.0)
        held.append(((lower <= 100.0) & (upper >= 100.0))[np.isfinite(lower)])
        assert np.nanmean(model.viscosity) == pytest.approx(viscosity, rel=0.02)
    assert np.nanmax(np.abs(errors)) < 7
    assert np.mean(np.concatenate(held)) > 0.9


@pytest.mark.parametrize(
    ("perturbation", "changes", "message"),
    [
        (
            PERTURBATIONS["noise"],
            {},
            r"the torque is no impulses with rests between them: 85 % of its power take \d+ % of",
        ),
        (PERTURBATIONS["pulses"], {}, r"the torque is no impulses with rests between them"),
        (
            IMPULSES,
            {"viscosity": 5.0},
            r"the joint does not ring: its damping ratio is 0.79 \(99.9 N·m/rad, 5 N·m·s",
        ),
    ],
)
def test_what_it_does_not_serve_is_said_in_words(perturbation, changes, message):
    with pytest.raises(tv.InputError, match=message):
        MODAL.identify(hit(perturbation, **changes))
