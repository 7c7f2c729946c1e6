import numpy as np
from hypothesis import given
from hypothesis import strategies as st

import tvsysid as tv

RATE = 128.0


def late_by(delays, samples=256, context=128):
    """Realizations that follow one target with delays in samples. The angle numbers the samples."""
    target = tv.simulate.SineWave(16.0, 13.0)
    time = (np.arange(samples + 2 * context) - context) / RATE
    torque = np.stack([target(time - delay / RATE) for delay in delays])
    angle = np.tile(np.arange(len(time), dtype=float), (len(delays), 1))
    channels = {"target": np.tile(target(time), (len(delays), 1)), "emg": 3 * torque}
    onsets = 2.0 * np.arange(len(delays))
    trials, recorded = np.zeros(len(delays), dtype=int), angle[..., None] + [0.0, 0.5]
    return tv.Ensemble(
        angle, torque, RATE, context, onsets, trials, channels=channels, recorded_angle=recorded
    )


@given(st.lists(st.integers(-32, 32), min_size=1, max_size=8))
def test_known_delays_are_found_and_removed(delays):
    ensemble = late_by(delays)
    step = tv.preprocess.align(ensemble, "target")
    np.testing.assert_array_equal(step.shifts * RATE, delays)
    aligned = step.ensemble
    assert aligned.context == 64
    np.testing.assert_allclose(aligned.torque, aligned.channels["target"], atol=1e-10)
    np.testing.assert_allclose(aligned.channels["emg"], 3 * aligned.torque)
    # The angle moves along, and comes from the record.
    expected = 64 + np.array(delays)[:, None] + np.arange(384)
    np.testing.assert_array_equal(aligned.angle, expected)
    np.testing.assert_array_equal(aligned.recorded_angle, aligned.angle[..., None] + [0.0, 0.5])
    np.testing.assert_allclose(aligned.onsets, ensemble.onsets + np.array(delays) / RATE)


def test_large_shifts_are_excluded():
    step = tv.preprocess.align(late_by([0, 33, -10, -50, 32]), "target")
    np.testing.assert_array_equal(step.kept, [True, False, True, False, True])
    np.testing.assert_allclose(step.reached[[1, 3]], [33 / RATE, 50 / RATE])
    assert [list(run) for run in step.ensemble.runs] == [[0], [1], [2]]  # no longer in a row
