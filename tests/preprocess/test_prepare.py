import attrs
import numpy as np
import pytest
from tests.virtual import prepared, simulated

import tvsysid as tv

SDS = tv.ShortDataSegments(max_lag=15 / 128, window=12 / 128)
PEOPLE = range(1, 7)
PERTURBATIONS = ("noise", "prbs")


def test_the_sequence_accounts_for_all_300_realizations():
    preparation = prepared(1, "noise")
    ensemble, table, kept = preparation.ensemble, preparation.table, preparation.kept
    assert (len(preparation.recorded), preparation.recorded.left_out, len(table)) == (300, 0, 300)
    assert (ensemble.sampling_rate, ensemble.samples, ensemble.context) == (128.0, 256, 64)
    assert set(table.excluded_by) == {"", "alignment", "task component", "residual"}
    np.testing.assert_allclose(ensemble.onsets, (table.onset_s + table.shift_s)[kept])
    np.testing.assert_array_equal(ensemble.trials, table.trial[kept])
    for name, step in preparation.steps.items():
        assert np.sum(~step.kept) == np.sum(table.excluded_by == name)
    np.testing.assert_allclose(ensemble.torque.mean(axis=0), 0, atol=1e-12)
    excluded = table[~kept]
    assert (excluded.reached > excluded.limit).all()
    np.testing.assert_array_equal(excluded.unit == "s", excluded.excluded_by == "alignment")
    assert table.reached[kept].isna().all()
    assert f"{kept.sum()} of 300 realizations kept; excluded: " in repr(preparation)


@pytest.mark.slow
def test_steps_can_be_left_out_and_channels_pass_the_others():
    recording = simulated(1).recording
    emg, posture = 0.1 * recording.torque, np.arange(len(recording)) / 1e3
    recording = attrs.evolve(recording, channels={"emg": emg, "posture": posture})
    settings = {"reference": None, "task_limit": None, "residual_limit": None}
    plain = tv.preprocess.prepare_experiment(recording, **settings, channels=("emg",))
    assert not plain.steps
    assert len(plain.recorded) == len(plain.ensemble) == plain.kept.sum() == 300
    channels = plain.ensemble.channels
    np.testing.assert_allclose(channels["emg"], 0.1 * plain.ensemble.torque, atol=1e-9)
    assert channels["posture"].mean(axis=0).min() > 1
    some = tv.preprocess.prepare_experiment(recording, reference=None)
    assert list(some.steps) == ["task component", "residual"]
    with pytest.raises(tv.InputError, match="there is no 'EMG'; the signals are 'angle', 'torque'"):
        tv.preprocess.prepare_experiment(recording, reference=None, channels=("EMG",))
