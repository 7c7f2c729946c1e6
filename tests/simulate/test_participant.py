import numpy as np
import pytest
from tests.virtual import perfect, simulated

from tvsysid.simulate import PERTURBATIONS, Participant, Traits


@pytest.mark.slow
def test_the_papers_protocol():
    for perturbation in PERTURBATIONS:
        simulation = simulated(1, perturbation)
        recording = simulation.recording
        assert recording.sampling_rate == 1024.0
        assert [trial.stop - trial.start for trial in recording.trials] == 10 * [70 * 1024]
        inside = (recording.time >= 0) & (recording.time < 60)
        rms = np.sqrt(np.mean(recording.angle[inside] ** 2))
        assert rms == pytest.approx(np.radians(0.5), rel=0.01)
        # The actuator needs a moment to come to rest.
        at_rest = (recording.time < 0) | (recording.time > 60.2)
        assert np.abs(recording.angle[at_rest]).max() < 1e-6
        target = recording.channels["target"] / Traits.of(1).maximal_torque
        assert (target.min(), target.max()) == (pytest.approx(0.05), pytest.approx(0.50))
        assert np.all(simulation.truth["stiffness"] > 0)


def test_the_torque_is_the_sum_of_its_parts():
    simulation = Participant(2, perfect(2, reflex_gain=5.0, inertia=0.03)).simulate()
    recording, truth, pathways = simulation.recording, simulation.truth, simulation.pathways
    np.testing.assert_allclose(pathways["voluntary"], recording.channels["target"], atol=1e-9)
    # No noise of the sensor.
    np.testing.assert_allclose(simulation.noiseless.torque, recording.torque, atol=1e-9)
    velocity = np.gradient(recording.angle, 1 / recording.sampling_rate)
    acceleration = np.gradient(velocity, 1 / recording.sampling_rate)
    intrinsic = truth["inertia"] * acceleration + truth["viscosity"] * velocity
    intrinsic += truth["stiffness"] * recording.angle
    assert np.std(intrinsic - pathways["intrinsic"]) < 0.05 * np.std(intrinsic)
    assert (set(truth["inertia"]), set(truth["reflex_gain"])) == ({0.03}, {5.0})


def test_stiffness_and_viscosity_follow_the_voluntary_torque_not_the_target():
    traits, simulation = Traits.of(1), simulated(1)
    voluntary, stiffness = simulation.pathways["voluntary"], simulation.truth["stiffness"]
    slope, intercept = np.polyfit(voluntary, stiffness, 1)
    assert slope == pytest.approx(traits.stiffness_per_torque, rel=0.01)
    assert intercept == pytest.approx(traits.passive_stiffness, rel=0.05)
    critical = 2 * np.sqrt(stiffness * traits.inertia)
    np.testing.assert_allclose(simulation.truth["viscosity"] / critical, traits.damping_ratio)
    off = np.std(voluntary - simulation.recording.channels["target"])
    assert off > 0.05 * np.std(voluntary)
