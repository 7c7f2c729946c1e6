"""Preparing recordings, of which some cannot be used."""

import os
import re

import attrs
import numpy as np
import pytest
from scipy.io import savemat
from tests.study.recorded.conftest import READING, SHORT, trial, write_trials
from tests.virtual import simulated

import tvsysid as tv
from tvsysid.study import Experiment, exclusions, prepared_recordings


def experiment_on(folder, files, **changes):
    settings = {
        "preparation": SHORT,
        "reading": READING,
        "methods": "birf",
        "realizations": 10,
        "bootstraps": 2,
    }
    return Experiment(participants={"P1": {"noise": files}}, folder=folder, **settings | changes)


@pytest.mark.slow
def test_a_virtual_participant_is_prepared_as_by_hand(small):
    simulation = simulated(1)
    parts = {**simulation.recording.channels, "voluntary": simulation.pathways["voluntary"]}
    by_hand = tv.preprocess.prepare(attrs.evolve(simulation.recording, channels=parts))
    prepared = small.prepared[0]
    np.testing.assert_array_equal(prepared.ensemble.torque, by_hand.ensemble.torque)
    np.testing.assert_array_equal(prepared.preparation.table.excluded_by, by_hand.table.excluded_by)
    truth = simulation.truth_of(by_hand.ensemble)["stiffness"].mean(axis=0)
    np.testing.assert_allclose(prepared.truth["stiffness"], truth)
    # What the survivors' torque was before its mean was taken off: the voluntary torque, but for
    # the answers' mean.
    voluntary = by_hand.ensemble.channels["voluntary"][:, by_hand.ensemble.core].mean(axis=0)
    assert np.sqrt(np.mean((prepared.mean_torque - voluntary) ** 2)) < 0.05 * np.ptp(voluntary)
    assert np.ptp(prepared.target_torque) == pytest.approx(
        0.45 * tv.simulate.Traits.of(1).maximal_torque, rel=0.01
    )
    assert prepared.remarks == ()


def test_files_are_prepared_in_the_order_of_their_names(tmp_path):
    write_trials(tmp_path)
    experiment = experiment_on(tmp_path, "trial*.mat")
    (prepared,) = prepared_recordings(experiment)
    recording = tv.read_trials([tmp_path / f"trial{number}.mat" for number in range(3)], **READING)
    by_hand = tv.preprocess.prepare(recording, **SHORT)
    np.testing.assert_array_equal(prepared.ensemble.torque, by_hand.ensemble.torque)
    assert not prepared.truth
    assert prepared.excerpt.duration == pytest.approx(10.0)


def spoil_truncated(file):
    os.truncate(file, file.stat().st_size // 2)


def spoil_missing_channel(file):
    savemat(file, {"angle": trial()["angle"]})


def spoil_short(file):
    savemat(file, trial(seconds=3.0))


SPOILT = {
    spoil_truncated: r"trial1\.mat is left out: cannot be read",
    spoil_missing_channel: r"trial1\.mat is left out: no channel 'torque'; it holds angle",
    spoil_short: r"left out: it lasts 3 s, less than the 4 s that",
}


@pytest.mark.parametrize("spoil", SPOILT)
def test_a_trial_that_cannot_be_used_is_told_and_the_others_go_on(tmp_path, spoil):
    write_trials(tmp_path)
    spoil(tmp_path / "trial1.mat")
    files = [f"trial{number}.mat" for number in range(3)]
    (prepared,) = prepared_recordings(experiment_on(tmp_path, files))
    assert prepared.failure == ""
    (remark,) = prepared.remarks
    assert re.search(SPOILT[spoil], remark)
    others = tv.preprocess.prepare(
        tv.read_trials([tmp_path / "trial0.mat", tmp_path / "trial2.mat"], **READING), **SHORT
    )
    np.testing.assert_array_equal(prepared.ensemble.torque, others.ensemble.torque)


def test_a_recording_without_any_usable_trial_fails_alone(tmp_path, small):
    write_trials(tmp_path)
    experiment = Experiment(
        participants={"P7": {"noise": "nothing*.mat"}, "P8": {"noise": "trial*.mat"}},
        reading=READING,
        folder=tmp_path, preparation=SHORT, methods="birf", realizations=10, bootstraps=3,
    )  # fmt: skip
    lost, fine = prepared_recordings(experiment)
    assert lost.ensemble is None
    assert lost.failure == "no trial can be used"
    assert lost.remarks[0] == "nothing*.mat is left out: no such file"
    assert fine.failure == ""
    results = tv.study.run(experiment, prepared=(lost, fine), workers=1)
    assert results.survivors.values.tolist() == [0, len(fine.ensemble)]
    assert set(results.failure.values[0, 0]) == {lost.failure}
    assert np.isnan(results.estimate[0]).all()
    assert np.isfinite(results.estimate.sel(quantity="stiffness")[1]).all()
    table = exclusions((lost, fine))
    assert set(table.recording) == {"P8-noise"}


def test_the_account_of_every_realization_is_one_table(small):
    table = exclusions(small.prepared)
    assert len(table) == 600
    assert table.groupby("recording").size().to_dict() == {"P1-noise": 300, "P1-prbs": 300}
    for item, (_, rows) in zip(small.prepared, table.groupby("recording"), strict=True):
        kept = rows[rows.excluded_by == ""]
        assert len(kept) == len(item.ensemble)
        np.testing.assert_allclose(kept.onset_s + kept.shift_s, item.ensemble.onsets)
        gone = rows[rows.excluded_by != ""]
        assert (gone.reached > gone.limit).all()


def test_the_same_file_counts_once_and_brackets_are_no_pattern_where_a_file_has_them(tmp_path):
    folder = tmp_path / "study [2026]"
    folder.mkdir()
    write_trials(folder)
    savemat(folder / "more[1].mat", trial(5))
    (prepared,) = prepared_recordings(
        experiment_on(folder, ["trial*.mat", "./trial0.mat", "more[1].mat"])
    )
    assert (len(set(prepared.ensemble.trials)), prepared.remarks) == (4, ())


class Driven(tv.Method):
    """Stands for a method that needs the muscles' activity."""

    inputs = (tv.methods.Input("emg", "input", "V"), tv.methods.Input("level", "scheduling", "1"))

    def fit(self, ensemble):
        if set(ensemble.channels) != {"emg", "level"}:
            raise ValueError("a channel is lost")
        return tv.BasisIRF().identify(ensemble)


def test_channels_that_methods_need_reach_them(tmp_path):
    for number in range(3):
        signals = trial(number)
        activity = 1.0 + 0.1 * np.random.default_rng(number).standard_normal(len(signals["angle"]))
        savemat(
            tmp_path / f"trial{number}.mat",
            signals | {"EMG_SIGNAL": activity, "LEVEL": 2.0 + 0 * activity},
        )
    channels = {"emg": "EMG_SIGNAL", "level": "LEVEL"}

    def experiment(methods):
        return Experiment(
            participants={"A": {"noise": "*.mat"}}, reading={**READING, "channels": channels},
            preparation=SHORT,
            methods=methods, realizations=8, bootstraps=2, folder=tmp_path,
        )  # fmt: skip

    (prepared,) = prepared_recordings(experiment([Driven()]))
    assert set(prepared.ensemble.channels) == {"emg", "level"}
    (without,) = prepared_recordings(experiment(["birf"]))
    assert not without.ensemble.channels
    assert prepared.digest != without.digest
    (driven,) = prepared_recordings(experiment(["kbr:reference=emg"]))
    assert (prepared.reference, driven.reference) == (None, "emg")
    # What acts on the joint loses its mean with the angle, what only schedules it keeps it.
    assert np.abs(prepared.ensemble.signal("emg").mean(axis=0)).max() < 1e-9
    np.testing.assert_allclose(prepared.ensemble.signal("level"), 2.0, rtol=1e-3)
    results = tv.study.run(experiment([Driven()]), workers=1)
    assert not (results.failure != "").any()
