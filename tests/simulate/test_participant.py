from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.virtual import participant_of, perfect

import tvsysid as tv


def test_the_papers_protocol():
    person = participant_of(1)
    for trials in (person.noise, person.prbs):
        recording = trials.recording
        assert recording.sampling_rate == 1024.0
        assert len(recording.trials) == 10
        assert {trial.stop - trial.start for trial in recording.trials} == {70 * 1024}
        inside = (recording.time >= 0) & (recording.time < 60)
        assert np.sqrt(np.mean(recording.angle[inside] ** 2)) == pytest.approx(np.radians(0.5), rel=0.01)
        # The actuator needs a moment to come to rest.
        at_rest = (recording.time < 0) | (recording.time > 60.2)
        assert np.abs(recording.angle[at_rest]).max() < 1e-6
        target = recording.channels["target"] / person.traits.maximal_torque
        assert (target.min(), target.max()) == (pytest.approx(0.05), pytest.approx(0.50))
        assert np.all(trials.stiffness > 0)


def test_the_torque_is_the_sum_of_its_parts():
    person = tv.simulate.participant(2, perfect(2, reflex_gain=5.0, inertia=0.03))
    recording = person.noise.recording  # smooth enough, and the inertia small enough, for differences
    np.testing.assert_allclose(person.noise.voluntary_torque, recording.channels["target"], atol=1e-9)
    rate, angle = recording.sampling_rate, recording.angle
    velocity = np.gradient(angle, 1 / rate)
    acceleration = np.gradient(velocity, 1 / rate)
    parts = person.noise
    torque = (
        person.traits.inertia * acceleration
        + parts.viscosity * velocity
        + parts.stiffness * angle
        + parts.voluntary_torque
        + parts.reflex_torque
    )
    error = recording.torque - torque
    evoked = recording.torque - parts.voluntary_torque
    assert np.std(error) < 0.05 * np.std(evoked)


def test_stiffness_and_viscosity_follow_the_voluntary_torque_not_the_target():
    person = participant_of(1)
    traits, trials = person.traits, person.noise
    slope, intercept = np.polyfit(trials.voluntary_torque, trials.stiffness, 1)
    assert slope == pytest.approx(traits.stiffness_per_torque, rel=0.01)
    assert intercept == pytest.approx(traits.passive_stiffness, rel=0.05)
    ratio = trials.viscosity / (2 * np.sqrt(trials.stiffness * traits.inertia))
    np.testing.assert_allclose(ratio, traits.damping_ratio)
    off = np.std(trials.voluntary_torque - trials.recording.channels["target"])
    assert off > 0.05 * np.std(trials.voluntary_torque)


def test_a_reflex_comes_40_ms_after_a_stretch_and_never_pulls():
    calm, lively = (tv.simulate.participant(4, perfect(4, reflex_gain=gain)).noise for gain in (0.0, 5.0))
    assert not calm.reflex_torque.any()
    np.testing.assert_allclose(
        lively.recording.torque - calm.recording.torque, lively.reflex_torque, atol=1e-9
    )  # same perturbation
    moved = np.flatnonzero(np.diff(lively.recording.angle) > 0)[0]
    answered = np.flatnonzero(lively.reflex_torque > 0)[0]
    assert 0.039 < (answered - moved) / 1024 < 0.060
    assert lively.reflex_torque.max() > 0.1
    assert lively.reflex_torque.min() > -0.1 * lively.reflex_torque.max()


def test_six_people_differ_and_each_stays_the_same():
    everybody = [tv.simulate.Traits.of(number) for number in range(1, 7)]
    assert len({traits.maximal_torque for traits in everybody}) == 6
    again = tv.simulate.participant(1)
    np.testing.assert_array_equal(again.noise.recording.torque, participant_of(1).noise.recording.torque)
    np.testing.assert_array_equal(again.prbs.stiffness, participant_of(1).prbs.stiffness)
    assert again.traits == everybody[0]
    assert not np.array_equal(again.noise.voluntary_torque, again.prbs.voluntary_torque)


def test_the_truth_passes_through_as_channels():
    trials = participant_of(1).prbs
    revealed = trials.revealed
    assert set(revealed.channels) == {"target", "stiffness", "viscosity", "voluntary_torque", "reflex_torque"}
    assert set(trials.recording.channels) == {"target"}
    np.testing.assert_array_equal(revealed.channels["stiffness"], trials.stiffness)
    np.testing.assert_array_equal(revealed.torque, trials.recording.torque)


@given(st.integers(0, 2**31))
def test_anybody_is_plausible(number):
    traits = tv.simulate.Traits.of(number)
    assert 40 < traits.maximal_torque < 80
    lowest, highest = (
        traits.passive_stiffness + traits.stiffness_per_torque * share * traits.maximal_torque for share in (0.05, 0.5)
    )
    assert 30 < lowest < 70
    assert 90 < highest < 200


@pytest.mark.parametrize("number", [-1, "one", 1.5])
def test_numbers_that_are_none_are_refused(number):
    with pytest.raises(tv.InputError, match="number must be a whole number of zero or more"):
        tv.simulate.participant(number)


def test_impossible_traits_are_refused():
    with pytest.raises(tv.InputError, match="inertia must be positive"):
        replace(perfect(), inertia=0.0)
    with pytest.raises(tv.InputError, match="delay_jitter must be a number of zero or more"):
        replace(perfect(), delay_jitter=-0.1)
