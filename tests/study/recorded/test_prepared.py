"""Preparing recordings, of which some cannot be used."""

import os
import re

import numpy as np
import pytest
from scipy.io import savemat
from tests.study.recorded.conftest import READING, SHORT, trial, write_trials
from tests.virtual import simulated

import tvsysid as tv
from tvsysid.study import Experiment, exclusions, prepared_recordings, run


def experiment_on(folder, files, **changes):
    settings = {"methods": "birf", "realizations": 8, "bootstraps": 2, "reading": READING}
    files = files if isinstance(files, dict) else {"P1": {"noise": files}}
    return Experiment(participants=files, folder=folder, preparation=SHORT, **settings | changes)


@pytest.mark.slow
def test_a_virtual_participant_is_prepared_as_by_hand(small):
    simulation = simulated(1)
    by_hand = tv.preprocess.prepare_experiment(simulation.recording)
    prepared = small.prepared[0]
    np.testing.assert_array_equal(prepared.ensemble.torque, by_hand.ensemble.torque)
    np.testing.assert_array_equal(prepared.preparation.table.excluded_by, by_hand.table.excluded_by)
    truth = simulation.truth_of(by_hand.ensemble)["stiffness"].mean(axis=0)
    signals = prepared.over_time
    np.testing.assert_allclose(signals["truth quantity stiffness"], truth)
    # The mean torque is the voluntary one, but for the answers' mean; the target is followed
    assert np.corrcoef(signals["mean_torque"], signals["target_torque"])[0, 1] > 0.99
    assert np.ptp(signals["target_torque"]) == pytest.approx(
        0.45 * tv.simulate.Traits.of(1).maximal_torque, rel=0.01
    )
    assert prepared.remarks == ()


def test_files_are_prepared_in_the_order_of_their_names(tmp_path):
    write_trials(tmp_path)
    (prepared,) = prepared_recordings(experiment_on(tmp_path, "trial*.mat"))
    recording = tv.read_trials([tmp_path / f"trial{number}.mat" for number in range(3)], **READING)
    by_hand = tv.preprocess.prepare_experiment(recording, **SHORT)
    np.testing.assert_array_equal(prepared.ensemble.torque, by_hand.ensemble.torque)
    assert [*prepared.over_time] == ["mean_torque"]
    assert prepared.excerpt.duration == pytest.approx(10.0)


def spoil_truncated(file):
    os.truncate(file, file.stat().st_size // 2)


def spoil_missing_channel(file):
    savemat(file, {"angle": trial()["angle"]})


def spoil_short(file):
    savemat(file, trial(seconds=3.0))


SPOILT = {
    spoil_truncated: r"trial1\.mat is left out: cannot be read",
    spoil_missing_channel: r"trial1\.mat is left out: no channel 'torque'; the file holds angle",
    spoil_short: r"left out: the trial lasts 3 s, less than the 4 s that",
}


@pytest.mark.parametrize("spoil", SPOILT)
def test_a_trial_that_cannot_be_used_is_told_and_the_others_go_on(tmp_path, spoil):
    write_trials(tmp_path)
    spoil(tmp_path / "trial1.mat")
    files = [f"trial{number}.mat" for number in range(3)]
    every, others = (
        prepared_recordings(experiment_on(tmp_path, names))[0] for names in (files, files[::2])
    )
    assert every.failure == ""
    (remark,) = every.remarks
    assert re.search(SPOILT[spoil], remark)
    np.testing.assert_array_equal(every.ensemble.torque, others.ensemble.torque)


def test_a_recording_without_any_usable_trial_fails_alone(tmp_path):
    write_trials(tmp_path)
    files = {"P7": {"noise": "nothing*.mat"}, "P8": {"noise": "trial*.mat"}}
    experiment = experiment_on(tmp_path, files)
    lost, fine = prepared_recordings(experiment)
    assert lost.ensemble is None
    assert lost.remarks == ("nothing*.mat is left out: no such file", "no trial can be used")
    assert fine.failure == ""
    results = run(experiment, prepared=(lost, fine), workers=1)
    assert results.survivors.values.tolist() == [0, len(fine.ensemble)]
    assert set(results.failure.values[0, 0]) == {lost.failure}
    assert np.isnan(results.estimate[0]).all()
    assert np.isfinite(results.estimate.sel(quantity="stiffness")[1]).all()
    assert set(exclusions((lost, fine)).participant) == {"P8"}
    with pytest.raises(tv.InputError, match="First reason: no trial can be used"):
        run(experiment, prepared=[lost], workers=1)


def test_the_account_of_every_realization_is_one_table(small):
    table = exclusions(small.prepared)
    assert table.groupby("perturbation").size().to_dict() == {"noise": 300, "prbs": 300}
    for item, (_, rows) in zip(small.prepared, table.groupby("perturbation"), strict=True):
        kept = rows[rows.excluded_by == ""]
        np.testing.assert_allclose(kept.onset_s + kept.shift_s, item.ensemble.onsets)
        gone = rows[rows.excluded_by != ""]
        assert (gone.reached > gone.limit).all()


def test_the_same_file_counts_once_and_brackets_are_no_pattern_where_a_file_has_them(tmp_path):
    write_trials(tmp_path)
    savemat(tmp_path / "more[1].mat", trial(5))
    files = ["trial*.mat", "./trial0.mat", "more[1].mat"]
    (prepared,) = prepared_recordings(experiment_on(tmp_path, files))
    assert (len(set(prepared.ensemble.trials)), prepared.remarks) == (4, ())


class Driven(tv.Method):
    """Stands for a method that needs the muscles' activity."""

    inputs = (tv.methods.Input("emg", "input", "V"), tv.methods.Input("level", "scheduling", "1"))

    def fit(self, ensemble):
        if set(ensemble.channels) != {"emg", "level"}:
            raise ValueError("a channel is lost")
        return tv.BasisIRF().identify(ensemble)


def test_channels_that_methods_need_reach_them(tmp_path):
    signals = trial()
    level = np.full(len(signals["angle"]), 2.0)
    activity = level + 0.1 * np.random.default_rng(0).standard_normal(len(level))
    savemat(tmp_path / "trial.mat", signals | {"EMG_SIGNAL": activity, "LEVEL": level})
    channels = {"emg": "EMG_SIGNAL", "level": "LEVEL"}

    def experiment(method):
        reading = {**READING, "channels": channels}
        return experiment_on(tmp_path, "*.mat", methods=method, reading=reading)

    (driven,) = prepared_recordings(experiment(Driven()))
    assert set(driven.ensemble.channels) == {"emg", "level"}
    # What acts on the joint loses its mean with the angle, what only schedules it keeps it.
    assert np.abs(driven.ensemble.signal("emg").mean(axis=0)).max() < 1e-9
    np.testing.assert_allclose(driven.ensemble.signal("level"), 2.0, rtol=1e-3)
    assert not (run(experiment(Driven()), workers=1).failure != "").any()
