"""What all systems have in common: truth, pathways, channels, seeds."""

import attrs
import numpy as np
import pytest
from tests.simulate.conftest import simulate

import tvsysid as tv
from tvsysid.simulate import PERTURBATIONS, PROFILES, SYSTEMS, SineWave

systems = pytest.mark.parametrize("name", SYSTEMS)


def signals(simulation):
    recording = simulation.recording
    parts = (recording.channels, simulation.truth, simulation.pathways)
    named = {
        f"{number} {name}": values
        for number, part in enumerate(parts)
        for name, values in part.items()
    }
    return named | {"angle": recording.angle, "torque": recording.torque}


@systems
def test_the_same_seed_gives_the_same_numbers_and_another_does_not(name):
    first, again, other = (simulate(SYSTEMS[name], seed=seed) for seed in (4, 4, 5))
    for key, values in signals(first).items():
        np.testing.assert_array_equal(values, signals(again)[key])
        assert values.shape == (12_000,)
        assert np.isfinite(values).all()
    assert not np.array_equal(first.recording.angle, other.recording.angle)
    sequence = np.random.SeedSequence(4)
    for seed in (sequence, sequence, np.random.default_rng(4)):
        torque = simulate(SYSTEMS[name], seed=seed).recording.torque
        np.testing.assert_array_equal(torque, first.recording.torque)


@systems
def test_the_noise_has_the_size_asked_for(name):
    # In a closed loop the noise is scaled to the torque of the disturbance, which is a little less.
    slack = 0.15 if name in ("compliant", "loaded") else 1e-9
    simulation = simulate(SYSTEMS[name], 60.0, snr_db=7.0)
    np.testing.assert_array_equal(simulation.noiseless.torque, sum(simulation.pathways.values()))
    torque = simulation.noiseless.torque[1000:61_000]
    noise = (simulation.recording.torque - simulation.noiseless.torque)[1000:61_000]
    assert 10 * np.log10(np.var(torque) / np.var(noise)) == pytest.approx(7.0, abs=slack)


@systems
@pytest.mark.parametrize("perturbation", PERTURBATIONS)
def test_the_intrinsic_torque_answers_the_recorded_angle(name, perturbation):
    # Derivatives are differences of the angle, which smear the jumps of a PRBS's acceleration.
    system = attrs.evolve(
        SYSTEMS[name], stiffness=PROFILES["sine"], viscosity=SineWave(2, 1), inertia=0.002
    )
    simulation = system.simulate(
        10.0, perturbation=PERTURBATIONS[perturbation], snr_db=40.0, seed=1, rate=8000.0
    )
    angle, truth = simulation.recording.angle, simulation.truth
    velocity = np.gradient(angle, 1 / 8000)
    parts = (
        truth["inertia"] * np.gradient(velocity, 1 / 8000),
        truth["viscosity"] * velocity,
        truth["stiffness"] * angle,
    )
    parts, torque = np.stack(parts)[:, 10:-10], simulation.pathways["intrinsic"][10:-10]
    limit = {"noise": 2e-3, "prbs": 2.5e-2, "pulses": 2.5e-2, "multisine": 2e-3}[perturbation]
    assert np.std(torque - parts.sum(axis=0)) < limit * np.std(torque)
    np.testing.assert_allclose(np.linalg.lstsq(parts.T, torque, rcond=None)[0], 1.0, rtol=0.02)


def test_the_truth_of_an_ensemble_is_found_by_trial_and_time():
    simulation = simulate(SYSTEMS["reflex"], 20.0)
    recording = tv.preprocess.decimate(simulation.recording, 100)
    ensemble = tv.preprocess.segment(recording, 2.5, context=0.25)
    truth = simulation.truth_of(ensemble)
    assert set(truth) == {"stiffness", "viscosity", "inertia", "reflex_gain"}
    expected = PROFILES["square"](np.arange(8)[:, None] * 2.5 + ensemble.time)
    np.testing.assert_array_equal(truth["stiffness"], expected)
    chosen = tv.preprocess.subtract_mean(ensemble.select([6, 1, 1]))
    np.testing.assert_array_equal(simulation.truth_of(chosen)["stiffness"], expected[[6, 1, 1]])
    shifted = attrs.evolve(ensemble.select([2]), onsets=[5.3])
    np.testing.assert_array_equal(
        simulation.truth_of(shifted)["stiffness"][0],
        PROFILES["square"](np.round(5.3 + ensemble.time, 9)),
    )


@pytest.mark.parametrize(
    "change", [{"trials": [0, 1]}, {"onsets": [0.0, 19.5]}, {"onsets": [-2.0, 0.0]}]
)
def test_the_truth_of_a_foreign_ensemble_is_refused(change):
    simulation = simulate(SYSTEMS["joint"], 20.0)
    ensemble = tv.preprocess.segment(simulation.recording, 2.0).select([0, 1])
    with pytest.raises(tv.InputError, match="cut from this simulation's recording"):
        simulation.truth_of(attrs.evolve(ensemble, **change))
