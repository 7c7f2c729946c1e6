import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat
from tests.recordings.files import read, refused

import tvsysid as tv
from tvsysid.recordings import Reading, join_trials


@pytest.fixture
def signals(random):
    return random.normal(scale=0.1, size=(40, 3)), random.normal(size=(40, 3))


@pytest.fixture
def mat(tmp_path, signals):
    file = tmp_path / "ankle.mat"
    savemat(file, {"pos": signals[0], "tq": signals[1], "note": "hello", "rate": 100.0})
    return file


def test_columns_follow_each_other_or_are_trials(mat, signals):
    contiguous = read(mat)
    assert contiguous.trial_starts == (0,)
    trials = read(mat, columns="trials", start=-1.0)
    assert trials.trial_starts == (0, 40, 80)
    assert trials.start == -1.0
    for recording in (contiguous, trials):
        np.testing.assert_array_equal(recording.angle, signals[0].T.ravel())
        np.testing.assert_array_equal(recording.torque, signals[1].T.ravel())


def test_units_and_sign(mat, signals):
    recording = read(mat, angle_unit="deg", torque_sign=-1)
    np.testing.assert_allclose(recording.angle, np.radians(signals[0].T.ravel()))
    np.testing.assert_array_equal(recording.torque, -signals[1].T.ravel())


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"angle": "angle"}, r"no channel 'angle'; the file holds pos \(40 x 3\), tq \(40 x 3\)"),
        ({"angle": "note"}, "ankle.mat: note: expected real numbers"),
        ({"torque": "rate"}, r"lengths or trials: pos \(40 x 3\), rate \(1 x 1\)"),
        ({"angle_unit": "grad"}, "angle_unit must be one of 'rad', 'deg', got 'gra"),
        ({"torque_sign": 2}, "torque_sign must be one of 1, -1, got 2"),
        ({"columns": "rows"}, "columns must be one of 'contiguous', 'trials', got 'rows'"),
        ({"sampling_rate": 0.0}, "sampling_rate must be a positive number"),
        ({"sampling_rate": None}, "missing: sampling_rate; add --rate"),
        ({"channels": {"emg": "EMG"}}, "no channel 'EMG'; the file holds pos"),
        ({"channels": ["emg"]}, "--channel emg: expected NAME=CHANNEL"),
        ({"channels": ["emg=a", "emg=b"]}, "--channel emg=a emg=b: .*each name once"),
        ({"torque": "pos"}, "angle and torque are both 'pos'; name the channel of each"),
        ({"channels": {"torque": "angle"}}, "the names angle and torque are taken"),
    ],
)
def test_a_wrong_request_is_refused(mat, settings, message):
    with refused(message):
        read(mat, **settings)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("empty.mat", b"", "the file is empty"),
        ("text.mat", b"pos,tq\n1,2\n3,4\n" * 40, "cannot be read .* is its ending right"),
        ("noise.mat", bytes(range(256)) * 20, r"noise\.mat: (cannot be read|the library that)"),
        ("hdf5.mat", b"\x89HDF\r\n\x1a\n" + b" " * 200, "cannot be read"),
        ("binary.csv", bytes(range(128, 256)) * 20, "cannot be read"),
        ("header.csv", b"pos,tq\n", "got an empty array"),
        ("words.csv", b"pos,tq\n1,2\nhigh,4\n", "words.csv: pos: expected real numbers"),
        ("gap.csv", b"pos,tq\n1,2\n,4\n5,6\n", "1 of 3 values are NaN .*, the first at time 1"),
        ("longer.csv", b"pos,tq\n1,2,3\n3,4,5\n", "cannot be read"),
        ("ragged.csv", b"pos,tq\n1,2\n3,4,5,6\n", "Expected 2 fields in line 3, saw 4"),
        ("cut.csv", b"emg,pos,tq\n1,2,3\n\n3,4\n5,6,7\n", "torque: 1 of 3 values are NaN"),
        ("other.xls", b"pos,tq\n", "unknown ending '.xls'; files that can be read end in .mat, "),
        ("nowhere.mat", None, r"nowhere\.mat: no such file"),
        ("", None, "expected a file, got a folder"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused(tmp_path, name, content, message):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with refused(message):
        read(tmp_path / name)


@pytest.fixture
def days(tmp_path, random):
    files = [tmp_path / "day0.csv", tmp_path / "day1.csv"]
    for file, length in zip(files, (200, 300), strict=True):
        signals = random.normal(scale=0.1, size=(length, 3))
        pd.DataFrame(signals, columns=["pos", "tq", "emg"]).to_csv(file, index=False)
    return files


def read_days(days, **settings):
    settings = {"sampling_rate": 100.0} | settings
    return tv.read_trials(days, angle="pos", torque="tq", **settings)


def test_trials_in_files_of_their_own(days):
    recording = read_days(days, torque_sign=-1, start=-0.5, channels={"emg": "emg"})
    assert recording.trial_starts == (0, 200)
    assert recording.start == -0.5
    for file, trial in zip(days, recording.trials, strict=True):
        angle, torque, emg = np.loadtxt(file, delimiter=",", skiprows=1).T
        np.testing.assert_allclose(recording.angle[trial], angle, rtol=1e-15)
        np.testing.assert_allclose(recording.torque[trial], -torque, rtol=1e-15)
        np.testing.assert_allclose(recording.channels["emg"][trial], emg, rtol=1e-15)


def test_trials_that_cannot_be_joined_are_refused(days, random):
    with refused(r"expected several files, got .*day0\.csv'; give a list"):
        read_days(days[0])
    with refused("expected recordings with the same rate"):
        read_days([])
    one, two = random.normal(size=(2, 50))
    first = tv.Recording(one, two, 100.0)
    for other in (
        tv.Recording(one, two, 50.0),
        tv.Recording(one, two, 100.0, -1.0),
        tv.Recording(one, two, 100.0, channels={"emg": one}),
    ):
        with refused(r"start \(s\) and channels; read them alike"):
            join_trials([first, other])


def test_trials_that_cannot_be_used_are_left_out(tmp_path, random):
    trials = {name: random.normal(scale=0.1, size=(2, 50, 2)) for name in "abcd"}
    trials["a"][0, 7, 1], trials["d"] = np.nan, trials["d"][:, :20]
    for name, (angle, torque) in trials.items():
        savemat(tmp_path / f"{name}.mat", {"pos": angle, "tq": torque})
    files = {name: tmp_path / f"{name}.mat" for name in "abcde"}
    reading = Reading(angle="pos", torque="tq", sampling_rate=100.0, columns="trials")
    with pytest.warns(tv.DataQualityWarning) as warned:
        recording = tv.recordings.read_usable_trials(files, reading, 0.5)
    reasons = dict(str(each.message).split(" is left out: ") for each in warned)
    assert [*reasons] == ["a, trial 2", "d, trial 1", "d, trial 2", "e"]
    assert reasons["a, trial 2"].startswith("angle: 1 of 50 values are NaN")
    assert reasons["d, trial 2"].startswith("the trial lasts 0.2 s, less than the 0.5 s")
    assert reasons["e"] == "no such file"
    assert len(recording.trials) == 5
