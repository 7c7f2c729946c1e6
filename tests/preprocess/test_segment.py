import numpy as np
import pytest

import tvsysid as tv


def recording_of(samples, **settings):
    values = np.arange(samples, dtype=float)
    return tv.Recording(values, values, 100.0, **settings)


@pytest.mark.parametrize("start", [-1.0, -0.3, 0.7, 12.5])
def test_realizations_begin_at_multiples_of_the_period_from_time_zero(start):
    recording = recording_of(1000, start=start)
    ensemble = tv.preprocess.segment(recording, period=2.0, context=0.2)
    np.testing.assert_allclose(ensemble.onsets / 2.0, np.round(ensemble.onsets / 2.0), atol=1e-9)
    for row, onset in enumerate(ensemble.onsets):
        first = ensemble.angle[row, ensemble.core][0]
        assert recording.time[int(first)] == pytest.approx(onset)


def test_trials_are_cut_each_for_itself():
    ensemble = tv.preprocess.segment(
        recording_of(1000, trial_starts=(0, 450)), period=1.0, context=0.1
    )
    np.testing.assert_array_equal(ensemble.trials, [0] * 3 + [1] * 4)
    np.testing.assert_array_equal(ensemble.onsets, [1, 2, 3, 1, 2, 3, 4])
    assert ensemble.angle[3, ensemble.core][0] == 550
    assert ensemble.left_out == 2
    assert [len(run) for run in ensemble.runs] == [3, 4]


def test_a_small_perturbation_beside_a_large_movement_is_legal():
    time = np.arange(2000) / 100
    angle = 0.5 * np.sin(np.pi * time) + 9e-4 * tv.simulate.PRBS().generate(
        2000, 100.0, np.random.default_rng(1)
    )
    ensemble = tv.preprocess.segment(tv.Recording(angle, angle, 100.0), 2.0, context=0)
    assert np.std(tv.preprocess.subtract_mean(ensemble).angle) < 1e-3


def test_trimmed_ends_serve_as_context():
    recording = recording_of(1500, start=3.0, trial_starts=(0, 700))
    trimmed = tv.preprocess.trim(recording, ends=1.0, margin=0.5)
    np.testing.assert_array_equal(trimmed.angle, [*range(50, 650), *range(750, 1450)])
    np.testing.assert_allclose(trimmed.time[[0, 50, 600]], [-0.5, 0.0, -0.5])
    cut = tv.preprocess.segment(trimmed, period=1.0, context=0.5)
    assert cut.left_out == 0
    firsts = [*range(100, 600, 100), *range(800, 1400, 100)]
    np.testing.assert_array_equal(cut.angle[:, cut.context], firsts)
