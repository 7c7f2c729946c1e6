import numpy as np
import pytest
from tests.virtual import perfect, prepared, simulated

import tvsysid as tv


@pytest.mark.slow
def test_the_papers_protocol():
    maximal_torque = tv.simulate.Traits.of(1).maximal_torque
    for perturbation in tv.simulate.PERTURBATIONS:
        simulation = simulated(1, perturbation)
        recording = simulation.recording
        assert recording.sampling_rate == 1024.0
        assert len(recording.trials) == 10
        assert {trial.stop - trial.start for trial in recording.trials} == {70 * 1024}
        inside = (recording.time >= 0) & (recording.time < 60)
        assert np.sqrt(np.mean(recording.angle[inside] ** 2)) == pytest.approx(
            np.radians(0.5), rel=0.01
        )
        # The actuator needs a moment to come to rest.
        at_rest = (recording.time < 0) | (recording.time > 60.2)
        assert np.abs(recording.angle[at_rest]).max() < 1e-6
        target = recording.channels["target"] / maximal_torque
        assert (target.min(), target.max()) == (pytest.approx(0.05), pytest.approx(0.50))
        assert np.all(simulation.truth["stiffness"] > 0)


def test_the_torque_is_the_sum_of_its_parts():
    simulation = tv.simulate.Participant(2, perfect(2, reflex_gain=5.0, inertia=0.03)).simulate()
    recording = simulation.recording
    truth, pathways = simulation.truth, simulation.pathways
    np.testing.assert_allclose(pathways["voluntary"], recording.channels["target"], atol=1e-9)
    rate, angle = recording.sampling_rate, recording.angle
    velocity = np.gradient(angle, 1 / rate)
    acceleration = np.gradient(velocity, 1 / rate)
    intrinsic = (
        truth["inertia"] * acceleration + truth["viscosity"] * velocity + truth["stiffness"] * angle
    )
    error = recording.torque - (intrinsic + pathways["voluntary"] + pathways["reflex"])
    evoked = recording.torque - pathways["voluntary"]
    assert np.std(error) < 0.05 * np.std(evoked)
    np.testing.assert_allclose(
        simulation.noiseless.torque, recording.torque, atol=1e-9
    )  # no noise of the sensor
    assert set(truth["inertia"]) == {0.03}
    assert set(truth["reflex_gain"]) == {5.0}


def test_stiffness_and_viscosity_follow_the_voluntary_torque_not_the_target():
    traits, simulation = tv.simulate.Traits.of(1), simulated(1)
    voluntary, stiffness = simulation.pathways["voluntary"], simulation.truth["stiffness"]
    slope, intercept = np.polyfit(voluntary, stiffness, 1)
    assert slope == pytest.approx(traits.stiffness_per_torque, rel=0.01)
    assert intercept == pytest.approx(traits.passive_stiffness, rel=0.05)
    ratio = simulation.truth["viscosity"] / (2 * np.sqrt(stiffness * traits.inertia))
    np.testing.assert_allclose(ratio, traits.damping_ratio)
    off = np.std(voluntary - simulation.recording.channels["target"])
    assert off > 0.05 * np.std(voluntary)


@pytest.mark.slow
def test_six_people_differ_and_each_stays_the_same():
    everybody = [tv.simulate.Traits.of(number) for number in range(1, 7)]
    assert len({traits.maximal_torque for traits in everybody}) == 6
    again = tv.simulate.Participant(1)
    assert again.traits == everybody[0]
    noise, prbs = again.simulate(), again.simulate(perturbation=tv.simulate.PRBS())
    np.testing.assert_array_equal(noise.recording.torque, simulated(1).recording.torque)
    np.testing.assert_array_equal(prbs.truth["stiffness"], simulated(1, "prbs").truth["stiffness"])
    assert not np.array_equal(noise.pathways["voluntary"], prbs.pathways["voluntary"])


def test_the_truth_of_prepared_realizations_is_that_of_their_trials_and_times():
    simulation = simulated(1, "prbs")
    assert set(simulation.recording.channels) == {"target"}
    preparation = prepared(1, "prbs")  # decimated, trimmed, aligned, selected
    truth = simulation.truth_of(preparation.ensemble)
    assert set(truth) == {"stiffness", "viscosity", "inertia", "reflex_gain"}
    recording, ensemble = simulation.recording, preparation.ensemble
    for number in (0, 57, len(ensemble) - 1):
        inside = recording.trials[ensemble.trials[number]]
        stiffness = np.interp(
            ensemble.onsets[number] + ensemble.time,
            recording.time[inside],
            simulation.truth["stiffness"][inside],
        )
        np.testing.assert_allclose(truth["stiffness"][number], stiffness, rtol=1e-9)


@pytest.mark.parametrize("number", [-1, "one", 1.5])
def test_numbers_that_are_none_are_refused(number):
    with pytest.raises(tv.InputError, match="number must be a whole number from 0 on"):
        tv.simulate.Participant(number)
