import pickle
import sys
import tracemalloc

import h5py
import numpy as np
import pytest
import xarray as xr
from scipy.io import savemat
from scipy.io.matlab import MatlabObject
from tests.recordings.files import (
    WRITERS,
    cells,
    nldat,
    write_gait,
    write_hdf5,
    write_mat_73,
    write_object,
    write_segdat,
    write_series,
)

import tvsysid as tv
from tvsysid.recordings import channel, describe_file

NAMES = {"angle": "pos", "torque": "tq"}


@pytest.fixture
def signals(random):
    return random.normal(scale=0.1, size=600), random.normal(size=600)


@pytest.fixture(params=WRITERS)
def file(request, tmp_path, signals):
    path = tmp_path / request.param
    WRITERS[request.param](path, *signals)
    return path


def read(file, sampling_rate=200.0, **settings):
    return tv.read_recording(file, **(NAMES | settings), sampling_rate=sampling_rate)


def test_every_format_gives_the_same_recording(file, signals):
    recording = read(file)
    exact = {
        ".c3d": {"rtol": 1e-6, "atol": 1e-8},
        ".csv": {"rtol": 1e-15},
        ".edf": {"rtol": 0, "atol": 1e-4},
    }
    exact = exact.get(
        file.suffix, {"rtol": 0, "atol": 1e-6 if file.suffix == ".bdf" else 0}
    )  # of 16 and 24 bits
    np.testing.assert_allclose(recording.angle, signals[0], **exact)
    np.testing.assert_allclose(recording.torque, signals[1], **exact)


def test_what_is_stated_is_described_and_contradictions_warn(file):
    described = describe_file(file)
    assert set(np.ravel(described["pos"].shape)) <= {600, 1}
    assert described["tq"].dtype == "float64"
    if file.name in ("ankle.csv", "ankle.tsv"):
        assert (described["pos"].unit, described["pos"].sampling_rate) == ("", None)
        read(file, 500.0)
        return
    assert described["pos"].sampling_rate == 200.0
    with pytest.warns(
        tv.DataQualityWarning, match="the file states 200 Hz for pos, tq, you gave 500 Hz"
    ):
        assert read(file, 500.0).sampling_rate == 500.0
    if file.suffix not in (".mat", ".npz"):
        assert described["pos"].unit == "rad"
        with pytest.warns(
            tv.DataQualityWarning,
            match="the file states the unit 'rad' for pos, and is read in deg",
        ):
            read(file, angle_unit="deg")


def test_a_wrong_name_gets_those_that_are_there(file):
    with pytest.raises(
        tv.InputError, match=r"no channel 'ang'; it holds (.*, )?pos \((600|600 x 1|1 x 600)[,)]"
    ):
        read(file, angle="ang")


def test_a_truncated_file_is_refused_wherever_it_is_cut(file):
    content = file.read_bytes()
    if file.suffix in (".csv", ".tsv"):
        pytest.skip("text may end anywhere; columns of different length are found elsewhere")
    for cut in np.linspace(5, len(content) - 600, 25).astype(int):
        file.write_bytes(content[:cut])
        with pytest.raises(tv.InputError, match=file.name):
            read(file)


@pytest.mark.parametrize(
    ("name", "other", "kind"),
    [
        ("v5.mat", ".csv", "a MAT file of version 5 or 7; give it the ending .mat"),
        ("v73.mat", ".npz", "a MAT file of version 7.3; give it the ending .mat"),
        ("ankle.h5", ".mat", "an HDF5 file; give it the ending .h5 or .hdf5"),
        ("classic.nc", ".c3d", "a NetCDF file; give it the ending .nc"),
        ("ankle.c3d", ".h5", "a C3D file; give it the ending .c3d"),
        ("ankle.csv", ".parquet", "text; give it the ending .csv or .tsv"),
    ],
)
def test_a_renamed_file_is_told_what_it_is(tmp_path, signals, name, other, kind):
    WRITERS[name](tmp_path / name, *signals)
    renamed = (tmp_path / name).rename(tmp_path / f"renamed{other}")
    with pytest.raises(
        tv.InputError, match=f"not a {other} file that can be read: by its content it is {kind}"
    ):
        describe_file(renamed)


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (PermissionError(13, "Permission denied"), "Permission denied"),
        (BlockingIOError(11, "unable to lock file"), "unable to lock file"),
    ],
)
def test_a_file_that_cannot_be_opened_is_told(file, monkeypatch, error, reason):
    def refuse(*_, **__):
        raise error

    monkeypatch.setattr(type(file), "open", refuse)
    with pytest.raises(
        tv.InputError, match=rf"cannot be opened \({reason}\); close it in other programs"
    ):
        describe_file(file)


def test_more_than_memory_is_refused_before_it_is_read(file, monkeypatch):
    monkeypatch.setattr(channel, "available_memory", lambda: 10_000)
    with pytest.raises(
        tv.InputError, match=r"reading it takes .* GB, and the computer has 1e-05 GB of memory"
    ):
        read(file)


@pytest.mark.parametrize("name", ["ankle.h5", "v73.mat", "ankle.npz"])
def test_an_enormous_file_is_read_in_part(tmp_path, signals, name):
    file = tmp_path / name
    WRITERS[name](file, *signals)
    if file.suffix == ".npz":
        np.savez_compressed(file, pos=signals[0], tq=signals[1], big=np.zeros(20_000_000))
    else:
        with h5py.File(file, "r+") as root:
            for key in ("big", "vast"):  # a terabyte each, which takes no place on disk
                big = root.create_dataset(
                    key, shape=(1000, 125_000_000), chunks=(1, 1_000_000), dtype="f8"
                )
                big.attrs["MATLAB_class"] = np.bytes_("double")
    tracemalloc.start()
    np.testing.assert_array_equal(read(file).angle, signals[0])
    assert tracemalloc.get_traced_memory()[1] < 20e6
    tracemalloc.stop()
    if file.suffix != ".npz":
        with pytest.raises(tv.InputError, match=r"reading it takes 6e\+03 GB"):
            read(file, angle="big", torque="vast")


def test_structures_of_every_mat_version(tmp_path, signals):
    columns = np.stack([signals[0], -signals[0]], axis=1)
    savemat(tmp_path / "v5.mat", {"run": {"pos": columns, "copy": columns}})
    write_mat_73(tmp_path / "v73.mat", *signals)
    with h5py.File(tmp_path / "v73.mat", "r+") as root:
        root["run/copy"] = root["run/pos"]
    for name in ("v5.mat", "v73.mat"):
        recording = read(tmp_path / name, angle="run.pos", torque="run.copy", columns="trials")
        np.testing.assert_array_equal(recording.angle, np.concatenate([signals[0], -signals[0]]))
        assert recording.trial_starts == (0, 600)


def test_matlab_7_3_characters_are_text(tmp_path, signals):
    write_mat_73(tmp_path / "v73.mat", *signals)
    assert list(describe_file(tmp_path / "v73.mat")) == ["fs", "note", "pos", "run.pos", "tq"]
    with pytest.raises(tv.InputError, match=r"v73\.mat: note: expected real numbers, got text"):
        read(tmp_path / "v73.mat", angle="note")


@pytest.mark.filterwarnings("ignore:.*future.infer_string")
@pytest.mark.parametrize("age", ["old", "v7", "v7.3"])
def test_toolbox_objects(tmp_path, signals, age):
    file = tmp_path / "ankle.mat"
    write_object(file, nldat(signals), age)
    recording = read(file, angle="io.pos", torque="io.tq", angle_unit="deg")
    np.testing.assert_array_equal(recording.torque, signals[1])
    described = describe_file(file)
    assert {name: (item.unit, item.sampling_rate) for name, item in described.items()} == {
        "io.pos": ("deg", 200.0),
        "io.tq": ("Nm", 200.0),
    }


def test_toolbox_objects_with_realizations_and_without_names(tmp_path, signals):
    three = np.stack([np.stack(signals, axis=1), np.stack(signals[::-1], axis=1)], axis=2)
    unnamed = nldat(
        signals, dataSet=three, chanNames=cells("x", "x"), domainName=np.array(["Frequency (Hz)"])
    )
    write_object(tmp_path / "ankle.mat", unnamed, "old")
    with pytest.warns(tv.DataQualityWarning, match="has an RMS|states the unit 'deg'"):
        recording = read(tmp_path / "ankle.mat", angle="io.1", torque="io.2", columns="trials")
    np.testing.assert_array_equal(recording.angle, np.concatenate(signals))
    assert describe_file(tmp_path / "ankle.mat")["io.1"].sampling_rate is None


def test_objects_of_other_classes_are_named(tmp_path):
    record = np.empty((1, 1), dtype=[("data", object)])
    record["data"][0, 0] = np.ones((3, 1))
    savemat(tmp_path / "ankle.mat", {"io": MatlabObject(record, "timeseries"), "x": np.ones(3)})
    with pytest.raises(
        tv.InputError, match="io: expected real numbers, got an object of class timeseries"
    ):
        read(tmp_path / "ankle.mat", angle="io", torque="x")


def test_groups_and_dimensions_of_netcdf(tmp_path, signals):
    trials = xr.Dataset(
        {
            name: (("trial", "time"), values.reshape(3, 200))
            for name, values in zip(NAMES.values(), signals, strict=True)
        }
    )
    xr.DataTree.from_dict({"/": xr.Dataset(attrs={"fs": 200}), "/day1": trials}).to_netcdf(
        tmp_path / "a.nc", engine="h5netcdf"
    )
    recording = read(tmp_path / "a.nc", angle="day1/pos", torque="day1/tq", columns="trials")
    np.testing.assert_array_equal(recording.angle, signals[0])
    assert recording.trial_starts == (0, 200, 400)


def test_packed_netcdf_is_unpacked(tmp_path, signals):
    WRITERS["ankle.nc"](tmp_path / "ankle.nc", *signals)
    np.testing.assert_allclose(
        read(tmp_path / "ankle.nc", angle="coarse").angle, np.round(signals[0], 3), atol=1e-7
    )


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.ones(600) + 1j, "expected real numbers, got values of type complex128"),
        (np.array(["a"] * 600), "expected real numbers, got text"),
        (np.array([[1.0], [1.0, 2.0]], dtype=object), "pickled objects, which are never read"),
        (
            np.ones(599),
            "different lengths: other 599 x 1, tq 600 x 1; name channels that were sampled "
            "together",
        ),
        (np.ones((10, 20, 3)), "different lengths"),
        (np.zeros(0), "different lengths: other 0 x 1"),
        (np.full(600, np.nan), "600 of 600 values are NaN"),
        (np.ones(600, dtype=bool), "values of type bool"),
    ],
)
def test_what_is_no_signal_is_refused(tmp_path, signals, values, message):
    file = tmp_path / "ankle.npz"
    np.savez(file, other=values, tq=signals[1])
    with pytest.raises(tv.InputError, match=message):
        read(file, angle="other")


def test_nothing_in_an_npz_is_unpickled(tmp_path):
    class Trap:
        def __reduce__(self):
            return (pytest.fail, ("the file was unpickled",))

    np.savez(tmp_path / "trap.npz", pos=np.array([Trap()], dtype=object), tq=np.ones(3))
    with pytest.raises(tv.InputError, match="pos: expected real numbers, got pickled objects"):
        read(tmp_path / "trap.npz")
    (tmp_path / "trap.mat").write_bytes(pickle.dumps(Trap()))
    with pytest.raises(
        tv.InputError, match="by its content it is a Python pickle, which is never read"
    ):
        read(tmp_path / "trap.mat")


@pytest.mark.parametrize("name", ["ankle.h5", "v73.mat", "ankle.nc"])
def test_nothing_leads_out_of_a_file(tmp_path, signals, name):
    """What is not followed is listed, and spoils nothing else. NetCDF files are refused."""
    secret = tmp_path / "secret"
    secret.write_bytes(signals[0].tobytes())
    write_hdf5(tmp_path / "other.h5", *signals)
    file = tmp_path / name
    WRITERS[name](file, *signals)
    with h5py.File(file, "r+") as root:
        root["inner/link"] = h5py.ExternalLink("other.h5", "pos")
        layout = h5py.VirtualLayout(shape=(600,), dtype="f8")
        layout[:] = h5py.VirtualSource("missing.h5", "tq", shape=(600,))
        root.create_virtual_dataset("virtual", layout)  # HDF5 itself would fill in zeros
        root.create_dataset("outer", (600,), "f8", external=[(str(secret), 0, 4800)])
        root["nowhere"] = h5py.SoftLink("/missing")
        root["circle"] = h5py.SoftLink("/circle")
        root["through"] = h5py.SoftLink("/inner/link")
        root["same"] = h5py.SoftLink("/pos")
        root["inner/again"] = root["/"]
        root["type"], root["empty"] = np.dtype("f8"), h5py.Empty("f8")
    if name == "ankle.nc":
        with pytest.raises(tv.InputError, match="save the file with its values in itself"):
            describe_file(file)
        return
    np.testing.assert_array_equal(read(file, angle="same").angle, signals[0])
    inner = "inner.link" if name == "v73.mat" else "inner/link"
    described = describe_file(file)
    for path, what in {
        inner: "a link to another file, other.h5, which is not followed",
        "virtual": "values in another file, which are not followed",
        "outer": "values in another file, which are not followed",
        "nowhere": "a link to /missing, which is not followed",
        "circle": "a link to /circle, which is not followed",
        "through": "a link to another file, other.h5, which is not followed",
        inner.replace("link", "again"): "a group with another path, which is not followed",
    }.items():
        with pytest.raises(tv.InputError, match=f"{path}: expected real numbers, got {what}"):
            described[path].read(path)


def test_groups_within_groups_are_read_up_to_a_limit(tmp_path):
    with h5py.File(tmp_path / "deep.h5", "w") as root:
        group = root
        for _ in range(300):
            group = group.create_group("g")
            group["x"] = 1.0
    with pytest.raises(tv.InputError, match="groups are nested more than 100 deep"):
        describe_file(tmp_path / "deep.h5")


def test_names_that_occur_twice_are_refused(tmp_path, signals):
    for name, text in {
        "a.csv": "pos, tq ,pos\n1,2,3\n",
        "a.tsv": "pos\ttq\t tq\n1\t2\t3\n",
    }.items():
        (tmp_path / name).write_text(text)
    np.savez(tmp_path / "a.npz", pos=signals[0], tqq=signals[1], tq1=signals[0])
    content = (tmp_path / "a.npz").read_bytes()
    (tmp_path / "a.npz").write_bytes(content.replace(b"tqq.npy", b"tq1.npy"))
    for name in ("first", "second"):
        savemat(tmp_path / f"{name}.mat", {"tq": np.ones(3)})
    (tmp_path / "a.mat").write_bytes(
        (tmp_path / "first.mat").read_bytes() + (tmp_path / "second.mat").read_bytes()[128:]
    )
    for name in ("a.csv", "a.tsv", "a.npz", "a.mat"):
        with pytest.raises(
            tv.InputError,
            match=rf"{name}: .* (called|name) .*(tq|pos).*give each a name of its own",
        ):
            describe_file(tmp_path / name)


def test_columns_without_a_name_are_no_duplicates(tmp_path):
    (tmp_path / "a.csv").write_text("\npos,,tq,\n1,,2,\n2,,3,\n")
    assert [
        name for name in describe_file(tmp_path / "a.csv") if not name.startswith("Unnamed")
    ] == ["pos", "tq"]


@pytest.mark.parametrize("columns", [10_001, 2_000_000])
def test_more_columns_than_anyone_has_are_refused(tmp_path, columns):
    (tmp_path / "wide.csv").write_text(
        ",".join(f"c{number}" for number in range(columns)) + "\n" + "1," * columns
    )
    with pytest.raises(
        tv.InputError, match=r"the first line has \d+ columns or more; expected 10000 at most"
    ):
        describe_file(tmp_path / "wide.csv")


def test_text_without_names_is_refused_until_it_is_said(tmp_path, signals):
    np.savetxt(tmp_path / "bare.csv", np.stack(signals, axis=1), fmt="%.17g", delimiter=",")
    with pytest.raises(
        tv.InputError, match=r"bare.csv: the first line is all numbers, .* say --no-header"
    ):
        read(tmp_path / "bare.csv", angle="1", torque="2")
    recording = read(tmp_path / "bare.csv", angle="1", torque="2", header=False)
    np.testing.assert_array_equal(recording.angle, signals[0])
    np.testing.assert_array_equal(recording.torque, signals[1])
    WRITERS["ankle.csv"](tmp_path / "ankle.csv", *signals)
    with pytest.raises(
        tv.InputError, match=r"the first line has names, such as \['pos'\]; read it without"
    ):
        read(tmp_path / "ankle.csv", header=False)
    WRITERS["ankle.npz"](tmp_path / "ankle.npz", *signals)
    with pytest.raises(
        tv.InputError,
        match=r"--no-header \(header=False\) is for text tables; leave it out for a .npz",
    ):
        read(tmp_path / "ankle.npz", header=False)


@pytest.mark.parametrize("text", ["1,2\n3,4,5\n", "1,2\n3,x\n", "1,,2\n3,4\n"])
def test_text_without_names_that_is_ragged_is_no_signal(tmp_path, text):
    (tmp_path / "bare.csv").write_text(text)
    with pytest.raises(tv.InputError, match=r"bare\.csv"):
        read(tmp_path / "bare.csv", angle="1", torque="2", header=False)


def test_time_series_of_nwb(tmp_path, signals):
    file = tmp_path / "ankle.nwb"
    counts, both = np.round(signals[0] / 1e-4).astype("i2"), np.stack(signals, axis=1)
    uneven = np.cumsum(np.r_[np.full(300, 0.005), 0.01, np.full(299, 0.005)])
    with h5py.File(file, "w") as root:
        write_series(root, "acquisition/pos", counts, "rad", conversion=1e-4, offset=0.5)
        write_series(root, "processing/behavior/tq", both, "N m", conversion=2.0)
        root["processing/behavior/tq/channel_conversion"] = [1.0, 3.0]
        write_series(root, "acquisition/lost", signals[0], "rad", timestamps=uneven)
        write_series(root, "acquisition/short", signals[0], "rad", timestamps=uneven[1:])
        write_series(
            root,
            "acquisition/shared",
            signals[0],
            "rad",
            timestamps=h5py.SoftLink("/acquisition/lost/timestamps"),
        )
        write_series(root, "acquisition/away", signals[0], "rad")
        del root["acquisition/away/data"]
        root["acquisition/away/data"] = h5py.ExternalLink("other.h5", "pos")
        root["session_description"] = "no signal"
    names = {"angle": "acquisition/pos", "torque": "processing/behavior/tq.2"}
    recording = read(file, **names)
    np.testing.assert_allclose(recording.angle, 1e-4 * counts + 0.5, rtol=1e-15)
    np.testing.assert_allclose(recording.torque, 6 * signals[1], rtol=1e-15)
    for name, what in {
        "lost": "values at times that are not evenly spaced",
        "shared": "values at times that are not evenly spaced",
        "short": "values whose timestamps are missing, elsewhere, or not one for each sample",
        "away": "a link to another file, other.h5, which is not followed",
    }.items():
        with pytest.raises(tv.InputError, match=f"expected real numbers, got {what}"):
            read(file, **names | {"angle": f"acquisition/{name}"})
    assert [*describe_file(file)][-2:] == ["processing/behavior/tq.1", "processing/behavior/tq.2"]


def test_motion_bids_is_described_in_folders_above_too(tmp_path, signals):
    file = tmp_path / "sub-1" / "motion" / "sub-1_task-a_run-2_motion.tsv"
    file.parent.mkdir(parents=True)
    WRITERS["sub-1_motion.tsv"](file, *signals)
    described = file.with_name("sub-1_task-a_run-2_channels.tsv").rename(
        tmp_path / "task-a_channels.tsv"
    )
    rate = file.with_name("sub-1_task-a_run-2_motion.json").rename(tmp_path / "sub-1_motion.json")
    file.with_name("sub-1_task-b_motion.json").write_text(
        '{"SamplingFrequency": 7}'
    )  # of another task
    np.testing.assert_array_equal(read(file).torque, signals[1])
    assert describe_file(file)["tq"].sampling_rate == 200
    rate.write_text("{}")
    assert describe_file(file)["tq"].sampling_rate is None
    rows = described.read_text()
    described.write_text(rows.replace("MISC", "LATENCY"))  # whose times are not evenly spaced
    with pytest.raises(
        tv.InputError, match="pos: expected real numbers, got values at times that are not evenly"
    ):
        read(file)
    described.write_text(rows + "\nemg\tEMG\tV")
    with pytest.raises(
        tv.InputError, match=r"it has 2 columns, and its _channels\.tsv describes 3"
    ):
        read(file)
    described.write_text("name\n")
    with pytest.raises(tv.InputError, match=r"task-a_channels\.tsv lacks rows with name and type"):
        read(file)
    described.unlink()
    with pytest.raises(
        tv.InputError,
        match=r"no sub-1_task-a_run-2_channels\.tsv beside it, which names its columns",
    ):
        read(file)


def test_motion_bids_has_no_names_in_it(tmp_path, signals):
    file = tmp_path / "sub-1_motion.tsv"
    WRITERS[file.name](file, *signals)
    file.write_text("pos\ttq\n" + file.read_text())
    with pytest.raises(
        tv.InputError, match=r"expected numbers in the first line, .* got \['pos', 'tq'\]"
    ):
        read(file)


def test_angles_and_moments_that_c3d_stores_as_points(tmp_path, signals):
    file = tmp_path / "gait.c3d"
    write_gait(file, *signals)
    names = {"angle": "LAnkleAngles.x", "torque": "LAnkleMoment.z"}
    recording = read(file, **names, angle_unit="deg", torque_unit="Nmm")
    np.testing.assert_allclose(recording.angle, signals[0], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(recording.torque, signals[1], rtol=1e-6, atol=1e-9)
    described = describe_file(file)
    assert [*described] == [
        f"{label}.{axis}" for label in ("LAnkleAngles", "LAnkleMoment", "LANK") for axis in "xyz"
    ]
    assert [described[name].unit for name in (*names.values(), "LANK.y")] == ["deg", "Nmm", "mm"]
    with pytest.warns(
        tv.DataQualityWarning,
        match=r"unit 'Nmm' for LAnkleMoment\.z, and is read in Nm|has an RMS|'deg'",
    ):
        read(file, **names)


def test_edf_of_several_rates_is_refused_with_the_rates(tmp_path, signals):
    edfio = pytest.importorskip("edfio", reason="edfio is not installed")
    made = [
        edfio.EdfSignal(signals[0][:400], 200.0, label="pos"),
        edfio.EdfSignal(signals[0][:200], 100.0, label="tq"),
    ]
    edfio.Edf(made).write(tmp_path / "a.edf")
    expected = (
        r"pos 400 x 1, tq 200 x 1 \(sampled at pos 200 Hz, tq 100 Hz\); .* resample them "
        r"to one rate before"
    )
    with pytest.raises(tv.InputError, match=expected):
        tv.read_recording(tmp_path / "a.edf", angle="pos", torque="tq", sampling_rate=200)


def test_edf_that_was_interrupted_is_refused(tmp_path, signals):
    edfio = pytest.importorskip("edfio", reason="edfio is not installed")
    file = tmp_path / "ankle.edf"
    same = [edfio.EdfSignal(each, 200.0, label="V", physical_dimension="mV") for each in signals]
    edfio.Edf(same, annotations=[edfio.EdfAnnotation(0, None, "start")]).write(file)
    assert {name: item.unit for name, item in describe_file(file).items()} == {
        "V (1)": "mV",
        "V (2)": "mV",
    }
    content = file.read_bytes()
    assert content.count(b"EDF+C") == 1
    assert content.count(b"+1\x14\x14") == 1
    file.write_bytes(
        content.replace(b"EDF+C", b"EDF+D")
    )  # which says that there may be gaps, and there is none
    assert len(describe_file(file)) == 2
    file.write_bytes(content.replace(b"EDF+C", b"EDF+D").replace(b"+1\x14\x14", b"+7\x14\x14"))
    with pytest.raises(tv.InputError, match=r"the recording was interrupted \(EDF\+D\)"):
        describe_file(file)


def test_a_library_that_is_missing_is_named(tmp_path, monkeypatch):
    (tmp_path / "a.edf").write_bytes(b"0       ")
    monkeypatch.setitem(sys.modules, "edfio", None)
    with pytest.raises(
        tv.InputError, match=r"these files need edfio: pip install 'tvsysid\[edf\]'"
    ):
        describe_file(tmp_path / "a.edf")


ONSETS, LENGTHS = [1, 301, 401], [200, 100, 150]


@pytest.mark.filterwarnings("ignore:.*future.infer_string")
@pytest.mark.parametrize(
    ("kind", "turn"),
    [("struct", np.ravel), ("struct", np.transpose), ("v7", np.ravel), ("v7.3", np.ravel)],
)
def test_segments_of_a_segdat_are_trials(tmp_path, signals, kind, turn):
    file = tmp_path / "ankle.mat"
    tables = [
        turn(np.stack([each, each])) if turn is np.transpose else np.array(each)
        for each in (ONSETS, LENGTHS)
    ]
    write_segdat(file, signals, kind, *tables)
    names = {"angle": "io.pos", "torque": "io.tq", "angle_unit": "deg", "columns": "trials"}
    recording = read(file, **names)
    parts = [
        slice(first - 1, first - 1 + length) for first, length in zip(ONSETS, LENGTHS, strict=True)
    ]
    np.testing.assert_array_equal(
        recording.torque, np.concatenate([signals[1][part] for part in parts])
    )
    assert recording.trial_starts == (0, 200, 300)
    usable = tv.recordings.read_usable_trials(
        {"P1": file}, tv.recordings.Reading(**names, sampling_rate=200.0), 0.6
    )
    assert usable.names == ("P1, trial 1", "P1, trial 3")
    np.testing.assert_array_equal(usable.recording.torque[200:], signals[1][parts[2]])
    with pytest.raises(
        tv.InputError,
        match=r"3 segments with gaps between them; read each as a trial \(--columns tri",
    ):
        read(file, **names | {"columns": "contiguous"})


@pytest.mark.parametrize(
    ("onsets", "lengths", "count"), [([1, 301], [100, 100], 2), ([1, 1], [600, 600], 1)]
)
def test_as_many_segments_as_channels_are_told_from_columns_of_channels(
    tmp_path, signals, onsets, lengths, count
):
    write_segdat(tmp_path / "ankle.mat", signals, "struct", onsets, lengths)
    recording = read(
        tmp_path / "ankle.mat", angle="io.pos", torque="io.tq", angle_unit="deg", columns="trials"
    )
    assert (len(recording.trial_starts), len(recording)) == (count, 200 if count == 2 else 600)


@pytest.mark.filterwarnings("ignore:.*future.infer_string")
@pytest.mark.parametrize(
    ("kind", "onsets", "lengths", "message"),
    [
        ("struct", [1, 501], [100, 101], "a segdat with segments that its samples do not have"),
        ("struct", [0, 301], [100, 100], "a segdat with segments that its samples do not have"),
        (
            "struct",
            [1, 301],
            [100],
            "a segdat whose segments cannot be read; in MATLAB: s = struct",
        ),
        (
            "struct",
            [1, np.nan],
            [100, 1],
            "a segdat whose segments cannot be read; in MATLAB: s = struct",
        ),
        (
            "struct",
            [[1, 1], [301, 301]],
            [100, 100],
            "a segdat whose segments cannot be read; in MATLAB: s = struct",
        ),
        ("v7", None, [600, 1], "a segdat whose segments cannot be read; in MATLAB: s = struct"),
    ],
)
def test_segments_that_cannot_be_are_refused(tmp_path, signals, kind, onsets, lengths, message):
    write_segdat(tmp_path / "ankle.mat", signals, kind, onsets, lengths)
    with pytest.raises(tv.InputError, match=f"io.pos: expected real numbers, got {message}"):
        read(tmp_path / "ankle.mat", angle="io.pos", torque="io.tq")
