"""MAT files: structures, and the objects of the Kearney lab's toolbox."""

import numpy as np
import pytest
from scipy.io import savemat
from tests.recordings.files import (
    MatlabOpaque,
    cells,
    nldat,
    read,
    refused,
    save_objects,
    write_mat_73,
    write_object,
    write_segdat,
)

import tvsysid as tv
from tvsysid.recordings import describe_file

NO_OBJECT_WARNINGS = pytest.mark.filterwarnings("ignore:.*future.infer_string")


def test_structures_of_every_mat_version(tmp_path, signals):
    columns = np.stack([signals[0], -signals[0]], axis=1)
    savemat(tmp_path / "v5.mat", {"run": {"pos": columns}, "note": "ankle"})
    write_mat_73(tmp_path / "v73.mat", *signals)
    for name in ("v5.mat", "v73.mat"):
        np.testing.assert_array_equal(describe_file(tmp_path / name)["run.pos"].read(""), columns)
        with refused(rf"{name}: note: expected real numbers, got text"):
            read(tmp_path / name, angle="note", torque="run.pos")


@NO_OBJECT_WARNINGS
@pytest.mark.parametrize("age", ["old", "v7", "v7.3"])
def test_toolbox_objects(tmp_path, signals, age):
    file = tmp_path / "ankle.mat"
    write_object(file, nldat(signals), age)
    recording = read(file, angle="io.pos", torque="io.tq", angle_unit="deg")
    np.testing.assert_array_equal(recording.torque, signals[1])
    described = {name: (it.unit, it.sampling_rate) for name, it in describe_file(file).items()}
    assert described == {"io.pos": ("deg", 200.0), "io.tq": ("Nm", 200.0)}


@pytest.mark.parametrize("version", ["v7", "v7.3"])
def test_variables_beside_objects(tmp_path, signals, version):
    file, run = tmp_path / "ankle.mat", np.empty((1, 1), dtype=[("pos", object), ("note", object)])
    run["pos"][0, 0], run["note"][0, 0] = signals[0][:, None], np.array(["ankle"])
    own, other = (MatlabOpaque(nldat(signals), kind) for kind in ("nldat", "timeseries"))
    objects = {"io": own, "tq": signals[1][:, None], "run": run, "series": other}
    save_objects(file, objects, version)
    assert {*describe_file(file)} == {"io.pos", "io.tq", "tq", "run.pos", "run.note", "series"}
    recording = read(file, angle="run.pos", channels={"same": "io.tq"})
    np.testing.assert_array_equal([recording.angle, recording.torque], signals)
    np.testing.assert_array_equal(recording.channels["same"], signals[1])
    with refused("series: expected real numbers, got an object of class timeseries"):
        read(file, angle="series")


def test_toolbox_objects_with_realizations_and_without_names(tmp_path, signals):
    three = np.stack([np.stack(signals, axis=1), np.stack(signals[::-1], axis=1)], axis=2)
    unnamed = {"dataSet": three, "chanNames": cells("x", "x")}
    unnamed["domainName"] = np.array(["Frequency (Hz)"])
    write_object(tmp_path / "ankle.mat", nldat(signals, **unnamed), "old")
    names = {"angle": "io.x (1)", "torque": "io.x (2)", "columns": "trials"}
    with pytest.warns(tv.DataQualityWarning, match="has an RMS|states the unit 'deg'"):
        recording = read(tmp_path / "ankle.mat", **names)
    np.testing.assert_array_equal(recording.angle, np.concatenate(signals))
    assert describe_file(tmp_path / "ankle.mat")["io.x (1)"].sampling_rate is None


ONSETS, LENGTHS = [1, 301, 401], [200, 100, 150]


@NO_OBJECT_WARNINGS
@pytest.mark.parametrize(
    ("kind", "by_channel"), [("struct", False), ("struct", True), ("v7", False), ("v7.3", False)]
)
def test_segments_of_a_segdat_are_trials(tmp_path, signals, kind, by_channel):
    file = tmp_path / "ankle.mat"
    tables = [np.stack([each, each], axis=1) if by_channel else each for each in (ONSETS, LENGTHS)]
    write_segdat(file, signals, kind, *tables)
    names = {"angle": "io.pos", "torque": "io.tq", "angle_unit": "deg", "columns": "trials"}
    recording = read(file, **names)
    pairs = zip(ONSETS, LENGTHS, strict=True)
    parts = [signals[1][first - 1 : first - 1 + length] for first, length in pairs]
    np.testing.assert_array_equal(recording.torque, np.concatenate(parts))
    assert recording.trial_starts == (0, 200, 300)
    with refused(r"3 segments with gaps between them; read each as a trial \(--columns tri"):
        read(file, **names | {"columns": "contiguous"})


@NO_OBJECT_WARNINGS
@pytest.mark.parametrize(
    ("kind", "onsets", "lengths"),
    [
        ("struct", [1, 501], [100, 101]),
        ("struct", [0, 301], [100, 100]),
        ("struct", [1, 301], [100]),
        ("struct", [1, np.nan], [100, 1]),
        ("struct", [[1, 1], [301, 301]], [100, 100]),
        ("v7", None, [600, 1]),
    ],
)
def test_segments_that_cannot_be_are_refused(tmp_path, signals, kind, onsets, lengths):
    write_segdat(tmp_path / "ankle.mat", signals, kind, onsets, lengths)
    with refused(
        "io.pos: expected real numbers, got a segdat whose segments cannot be read; in MA"
    ):
        read(tmp_path / "ankle.mat", angle="io.pos", torque="io.tq")
