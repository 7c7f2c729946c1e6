import numpy as np
import pytest

import tvsysid as tv


def waves(time):
    return np.sin(2 * np.pi * 3.0 * time) + 0.3 * np.sin(2 * np.pi * 11.0 * time + 1)


@pytest.mark.parametrize("delay", [0.003, -0.003, 0.0013, -0.0047, 0.0])
def test_torque_is_shifted_and_samples_without_torque_are_cut(delay):
    time = np.arange(4000) / 1000
    recording = tv.Recording(
        waves(time), waves(time - delay), 1000.0, trial_starts=(0, 1500), channels={"emg": time}
    )
    aligned = tv.preprocess.align_channels(recording, delay)
    lost = int(np.ceil(abs(1000 * delay) - 1e-9))
    assert [trial.stop - trial.start for trial in aligned.trials] == [1500 - lost, 2500 - lost]
    assert aligned.start == pytest.approx(lost / 1000 if delay < 0 else 0)
    assert aligned.delay_removed == delay
    for trial in aligned.trials:
        inner = slice(trial.start + 20, trial.stop - 20)
        np.testing.assert_allclose(aligned.torque[inner], aligned.angle[inner], atol=1e-3)
        np.testing.assert_array_equal(np.diff(aligned.channels["emg"][trial]).round(9), 0.001)
