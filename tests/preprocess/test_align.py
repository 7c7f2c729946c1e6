import attrs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.virtual import perfect, simulated

import tvsysid as tv

RATE = 128.0


def late_by(delays, samples=256, context=128):
    """Realizations that follow one target with delays in samples, and an angle that tells which sample is which."""
    target = tv.simulate.SineWave(16.0, 13.0)
    time = (np.arange(samples + 2 * context) - context) / RATE
    torque = np.stack([target(time - delay / RATE) for delay in delays])
    angle = np.tile(np.arange(len(time), dtype=float), (len(delays), 1))
    channels = {"target": np.tile(target(time), (len(delays), 1)), "emg": 3 * torque}
    onsets = 2.0 * np.arange(len(delays))
    trials, recorded = np.zeros(len(delays), dtype=int), angle[..., None] + [0.0, 0.5]
    return tv.Ensemble(
        angle, torque, RATE, context, onsets, trials, channels, recorded_angle=recorded
    )


@given(st.lists(st.integers(-32, 32), min_size=1, max_size=8))
def test_known_delays_are_found_to_the_sample_and_taken_back(delays):
    given_ensemble = late_by(delays)
    before = given_ensemble.torque.copy()
    step = tv.preprocess.align(given_ensemble, "target")
    np.testing.assert_array_equal(step.account.shifts * RATE, delays)
    aligned = step.ensemble
    assert aligned.context == 64
    np.testing.assert_allclose(aligned.torque, aligned.channels["target"], atol=1e-10)
    np.testing.assert_allclose(aligned.channels["emg"], 3 * aligned.torque)
    # The angle moved along, and was taken from the record.
    np.testing.assert_array_equal(aligned.angle[:, 0], 64 + np.array(delays))
    np.testing.assert_array_equal(np.diff(aligned.angle, axis=1), 1.0)
    np.testing.assert_array_equal(aligned.recorded_angle, aligned.angle[..., None] + [0.0, 0.5])
    np.testing.assert_allclose(aligned.onsets, given_ensemble.onsets + np.array(delays) / RATE)
    np.testing.assert_array_equal(given_ensemble.torque, before)


def test_realizations_that_are_far_off_are_excluded_and_accounted_for():
    step = tv.preprocess.align(late_by([0, 33, -10, -50, 32]), "target")
    np.testing.assert_array_equal(step.account.kept, [True, False, True, False, True])
    table = step.account.table
    assert list(table.excluded_by) == ["", "alignment", "", "alignment", ""]
    np.testing.assert_allclose(table.reached[[1, 3]], [33 / RATE, 50 / RATE])
    assert set(table.limit[[1, 3]]) == {0.25}
    assert list(table.onset_s) == [0.0, 2.0, 4.0, 6.0, 8.0]
    assert len(step.judged) == 5


def test_realizations_that_moved_apart_no_longer_follow_each_other():
    step = tv.preprocess.align(late_by([3, 3, 5]), "target")
    assert [list(run) for run in step.ensemble.runs] == [[0, 1], [2]]


def test_a_delay_under_a_perturbation_is_found_within_a_few_samples():
    traits = perfect(2, delay=0.1)
    preparation = tv.preprocess.prepare(tv.simulate.Participant(2, traits).simulate().recording)
    # The perturbation's answer itself moves the best fit: some 6 ms from realization to
    # realization.
    shifts = preparation.account.shifts
    assert abs(np.median(shifts) - 0.1) <= 1 / RATE
    assert 0.002 < shifts.std() < 0.010


@pytest.mark.slow
def test_simulated_trials_have_their_voluntary_torque_aligned_to_the_sample():
    simulation = simulated(1)
    voluntary = tv.preprocess.prepare(
        attrs.evolve(simulation.recording, torque=simulation.pathways["voluntary"]),
        task_limit=None,
        residual_limit=None,
    ).recorded
    target = voluntary.channels["target"]
    shifted = np.array(voluntary.torque)
    by = np.random.default_rng(0).integers(-20, 21, len(shifted))
    rows = [np.roll(row, shift) for row, shift in zip(shifted, by, strict=True)]
    moved = tv.Ensemble(voluntary.angle, rows, RATE, voluntary.context, channels={"target": target})
    own = tv.preprocess.align(voluntary, "target").account.shifts
    found = tv.preprocess.align(moved, "target").account.shifts
    inside = np.abs(own) < 0.3  # so that the roll's seam stays outside of what the search sees
    assert inside.sum() > 290
    np.testing.assert_allclose((found - own)[inside] * RATE, by[inside], atol=1)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"reference": "goal"},
            "there is no channel 'goal' to align to; channels: 'target', 'emg'",
        ),
        (
            {"search": 1.5},
            "shifts of up to 1.5 s need that much context, but the realizations have 1 s",
        ),
        ({"search": 0.0}, "search must be a positive number of seconds"),
        ({"max_shift": float("nan")}, "max_shift must be a positive number of seconds"),
        ({"max_shift": 0.01}, "every realization needs a shift of more than 0.01 s"),
    ],
)
def test_what_cannot_be_aligned_is_refused(settings, message):
    with pytest.raises(tv.InputError, match=message):
        tv.preprocess.align(late_by([20, 30]), **{"reference": "target", **settings})
