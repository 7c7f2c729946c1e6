import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

import tvsysid as tv
from tvsysid.recordings import join_trials


@pytest.fixture
def signals(random):
    return random.normal(scale=0.1, size=(40, 3)), random.normal(size=(40, 3))


@pytest.fixture
def mat(tmp_path, signals):
    file = tmp_path / "ankle.mat"
    savemat(file, {"pos": signals[0], "tq": signals[1], "note": "hello", "rate": 100.0})
    return file


def read(file, angle="pos", torque="tq", **settings):
    return tv.read_recording(
        file, angle=angle, torque=torque, **({"sampling_rate": 100.0} | settings)
    )


@pytest.mark.parametrize("compress", [False, True])
def test_columns_that_follow_each_other(tmp_path, signals, compress):
    file = tmp_path / "ankle.mat"
    savemat(file, {"pos": signals[0], "tq": signals[1]}, do_compression=compress)
    recording = read(file)
    np.testing.assert_array_equal(recording.angle, signals[0].T.ravel())
    np.testing.assert_array_equal(recording.torque, signals[1].T.ravel())
    assert recording.trial_starts == (0,)


def test_columns_that_are_trials(mat, signals):
    recording = read(mat, columns="trials", start=-1.0)
    assert recording.trial_starts == (0, 40, 80)
    for trial, (angle, torque) in enumerate(zip(*(values.T for values in signals), strict=True)):
        np.testing.assert_array_equal(recording.angle[recording.trials[trial]], angle)
        np.testing.assert_array_equal(recording.torque[recording.trials[trial]], torque)
    assert recording.start == -1.0


@pytest.mark.parametrize("shape", [(120,), (120, 1), (1, 120)])
def test_vectors_of_any_orientation(tmp_path, signals, shape):
    file = tmp_path / "ankle.mat"
    savemat(file, {"pos": signals[0].reshape(shape), "tq": signals[1].ravel()[:, None]})
    np.testing.assert_array_equal(read(file).angle, signals[0].ravel())


@pytest.mark.parametrize(("ending", "separator"), [(".csv", ","), (".tsv", "\t"), (".CSV", ", ")])
def test_text(tmp_path, signals, ending, separator):
    file = tmp_path / f"ankle{ending}"
    lines = [separator.join(["pos", "tq", "emg"])]
    lines += [
        separator.join(f"{value:.17g}" for value in row)
        for row in zip(*(s.ravel() for s in signals), range(120), strict=True)
    ]
    file.write_text("\n".join(lines))
    recording = read(file, channels={"emg": "emg"})
    np.testing.assert_array_equal(recording.angle, signals[0].ravel())
    np.testing.assert_array_equal(recording.channels["emg"], np.arange(120))


def test_units_and_sign(mat, signals):
    recording = read(mat, angle_unit="deg", torque_sign=-1)
    np.testing.assert_allclose(recording.angle, np.radians(signals[0].T.ravel()))
    np.testing.assert_array_equal(recording.torque, -signals[1].T.ravel())


def test_an_angle_that_is_probably_in_degrees_warns(tmp_path, random):
    file = tmp_path / "degrees.csv"
    pd.DataFrame({"pos": 3 * random.normal(size=50), "tq": random.normal(size=50)}).to_csv(file)
    with pytest.warns(tv.DataQualityWarning, match="pos has an RMS of 3.* rad .* angle_unit='deg'"):
        read(file)
    read(file, angle_unit="deg")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"angle": "angle"}, r"no channel 'angle'; it holds pos \(40 x 3\), tq \(40 x 3\), note"),
        ({"angle": "note"}, "ankle.mat: note: expected real numbers"),
        ({"torque": "rate"}, "different lengths: pos 40 x 3, rate 1 x 1"),
        ({"angle_unit": "grad"}, "angle_unit must be one of 'rad', 'deg', got 'grad'"),
        ({"torque_sign": 2}, "torque_sign must be one of 1, -1, got 2"),
        ({"columns": "rows"}, "columns must be one of 'contiguous', 'trials', got 'rows'"),
        ({"sampling_rate": 0.0}, "sampling_rate must be a positive number"),
        ({"sampling_rate": None}, r"sampling_rate is missing; give it \(--rate\)"),
        ({"channels": {"emg": "EMG"}}, "no channel 'EMG'; it holds pos"),
        ({"channels": ["emg"]}, "--channel emg: expected NAME=CHANNEL"),
        ({"channels": {"torque": "angle"}}, "channels: 'torque' is the name of a signal already"),
    ],
)
def test_a_wrong_request_is_refused(mat, settings, message):
    with pytest.raises(tv.InputError, match=message):
        read(mat, **settings)


def file_with(folder, name, content):
    file = folder / name
    file.write_bytes(content)
    return file


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("empty.mat", b"", "the file is empty"),
        ("empty.csv", b"", "the file is empty"),
        (
            "text.mat",
            b"pos,tq\n1,2\n3,4\n" * 40,
            "by its content it is text; give it the ending .csv or .tsv",
        ),
        ("noise.mat", bytes(range(256)) * 20, r"noise\.mat: cannot be read .*Copy it again"),
        (
            "hdf.mat",
            b"MATLAB 7.3 MAT-file, Platform: GLNXA64" + b" " * 200,
            r"hdf\.mat: cannot be read .*Copy it again",
        ),
        (
            "hdf5.mat",
            b"\x89HDF\r\n\x1a\n" + b" " * 200,
            "by its content it is an HDF5 file; give it the ending .h5 or .hdf5",
        ),
        ("binary.csv", bytes(range(128, 256)) * 20, "not a text table with a header line"),
        ("header.csv", b"pos,tq\n", "got an empty array"),
        ("words.csv", b"pos,tq\n1,2\nhigh,4\n", "words.csv: pos: expected real numbers"),
        (
            "gap.csv",
            b"pos,tq\n1,2\n,4\n5,6\n",
            "1 of 3 values are NaN or infinite, the first at time 1",
        ),
        ("longer.csv", b"pos,tq\n1,2,3\n3,4,5\n", "not a text table with a header line"),
        ("ragged.csv", b"pos,tq\n1,2\n3,4,5,6\n", "not a text table with a header line"),
        (
            "other.xls",
            b"pos,tq\n",
            r"unknown ending '.xls'; files that can be read end in .mat, .csv, .tsv",
        ),
    ],
)
def test_a_file_that_cannot_be_used_is_refused(tmp_path, name, content, message):
    with pytest.raises(tv.InputError, match=message):
        read(file_with(tmp_path, name, content))


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    with pytest.raises(tv.InputError, match=r"nowhere\.mat: no such file"):
        read(tmp_path / "nowhere.mat")
    (tmp_path / "folder.mat").mkdir()
    with pytest.raises(tv.InputError, match="expected a file, this is a folder"):
        read(tmp_path / "folder.mat")
    with pytest.raises(tv.InputError, match="expected a file, this is a folder"):
        read(tmp_path)


@pytest.fixture
def days(tmp_path, random):
    files = []
    for day, length in enumerate((200, 300)):
        files.append(tmp_path / f"day{day}.csv")
        table = pd.DataFrame(
            random.normal(scale=0.1, size=(length, 3)), columns=["pos", "tq", "emg"]
        )
        table.to_csv(files[-1], index=False)
    return files


def read_days(days, **settings):
    return tv.read_trials(days, angle="pos", torque="tq", **({"sampling_rate": 100.0} | settings))


def test_trials_in_files_of_their_own(days):
    recording = read_days(days, torque_sign=-1, start=-0.5, channels={"emg": "emg"})
    assert recording.trial_starts == (0, 200)
    assert recording.start == -0.5
    for file, trial in zip(days, recording.trials, strict=True):
        angle, torque, emg = np.loadtxt(file, delimiter=",", skiprows=1).T
        np.testing.assert_allclose(recording.angle[trial], angle, rtol=1e-15)
        np.testing.assert_allclose(recording.torque[trial], -torque, rtol=1e-15)
        np.testing.assert_allclose(recording.channels["emg"][trial], emg, rtol=1e-15)


def test_files_of_several_trials_each(mat):
    assert read_days([mat, mat], columns="trials").trial_starts == (0, 40, 80, 120, 160, 200)


def test_trials_that_cannot_be_joined_are_refused(days, random):
    with pytest.raises(
        tv.InputError, match=r"expected several files, got .*day0\.csv'; give a list"
    ):
        read_days(days[0])
    with pytest.raises(tv.InputError, match="expected recordings, got none"):
        read_days([])
    one, two = random.normal(size=(2, 50))
    other = tv.Recording(one, two, 50.0)
    with pytest.raises(
        tv.InputError,
        match=r"recording 1 and the first differ in sampling rate: 50\.0 instead of 100",
    ):
        join_trials([tv.Recording(one, two, 100.0), other])
    with pytest.raises(tv.InputError, match=r"differ in channels: \[\] instead of \['emg'\]"):
        join_trials([tv.Recording(one, two, 50.0, channels={"emg": one}), other])


def test_a_lost_signal_is_told_with_trial_and_time(tmp_path, random):
    signals = random.normal(scale=0.1, size=(2, 500, 2))
    signals[0, 100:140, 1] = 0.05
    signals[1, 460:, 0] = 0.0
    savemat(tmp_path / "ankle.mat", {"pos": signals[0], "tq": signals[1]})
    with pytest.warns(tv.DataQualityWarning) as told:
        read(tmp_path / "ankle.mat", columns="trials", start=-1.0)
    assert [str(item.message) for item in told] == [
        "ankle.mat: pos stays at 0.05 for 0.4 s from 0 s in trial 2 of 2; if the signal was lost "
        "there, cut that out",
        "ankle.mat: tq stays at 0 for 0.4 s from 3.6 s in trial 1 of 2; if the signal was lost "
        "there, cut that out",
    ]


def test_a_joint_that_is_held_before_and_after_is_no_doubt(tmp_path, random):
    angle, torque = random.normal(scale=0.1, size=(2, 500))
    angle[:100], angle[400:], angle[200:220] = 0.0, 0.2, 0.1
    savemat(tmp_path / "ankle.mat", {"pos": angle, "tq": torque})
    assert len(read(tmp_path / "ankle.mat")) == 500


def test_a_perturbation_between_two_levels_is_no_doubt_but_a_third_is(tmp_path, random):
    angle, torque = np.repeat(random.choice([-0.1, 0.1], 20), 50), random.normal(size=1000)
    savemat(tmp_path / "ankle.mat", {"pos": angle, "tq": torque})
    read(tmp_path / "ankle.mat")
    angle[400:450] = 0.0
    savemat(tmp_path / "ankle.mat", {"pos": angle, "tq": torque})
    with pytest.warns(
        tv.DataQualityWarning, match=r"pos stays at 0 for 0\.5 s from 4 s in trial 1 of 1;"
    ):
        read(tmp_path / "ankle.mat")


def test_a_constant_channel_is_told(tmp_path, random):
    savemat(
        tmp_path / "ankle.mat",
        {"pos": 0.1 * random.normal(size=50), "tq": random.normal(size=50), "emg": np.ones(50)},
    )
    with pytest.warns(
        tv.DataQualityWarning, match="all 50 values of channel emg are 1; is this the right channel"
    ):
        read(tmp_path / "ankle.mat", channels={"emg": "emg"})
