"""Every format gives the same recording, states what it knows, and refuses what is no signal."""

import pickle

import h5py
import numpy as np
import pytest
import xarray as xr
from scipy.io import savemat
from tests.recordings.files import (
    NAMES,
    WRITERS,
    read,
    refused,
    write_gait,
    write_hdf5,
    write_series,
)

import tvsysid as tv
from tvsysid.recordings import describe_file


@pytest.fixture(params=WRITERS)
def file(request, tmp_path, signals):
    path = tmp_path / request.param
    WRITERS[request.param](path, *signals)
    return path


def test_every_format_gives_the_same_recording(file, signals):
    recording = read(file)
    exact = {".c3d": 1e-6, ".edf": 1e-4, ".bdf": 1e-6, ".csv": 1e-15}.get(file.suffix, 0)
    np.testing.assert_allclose(recording.angle, signals[0], rtol=0, atol=exact)
    np.testing.assert_allclose(recording.torque, signals[1], rtol=0, atol=exact)


def test_contradictions_to_what_a_file_states_warn(file):
    channel = describe_file(file)["pos"]
    assert set(channel.shape) <= {600, 1}
    assert channel.dtype == "float64"
    if file.name in ("ankle.csv", "ankle.tsv"):
        assert (channel.unit, channel.sampling_rate) == ("", None)
        return
    assert channel.sampling_rate == 200.0
    with refused("missing: sampling_rate; add --rate 200, which the file states"):
        read(file, None)
    with pytest.warns(tv.DataQualityWarning, match="states 200 Hz, you gave 500 Hz"):
        assert read(file, 500.0).sampling_rate == 500.0
    if file.suffix not in (".mat", ".npz"):
        message = "'rad' for pos, but it is read in deg; add --angle-unit rad"
        with pytest.warns(tv.DataQualityWarning, match=message):
            read(file, angle_unit="deg")


def test_a_truncated_file_is_refused_wherever_it_is_cut(file):
    content = file.read_bytes()
    if file.suffix in (".csv", ".tsv"):
        pytest.skip("text may end anywhere; short lines are found elsewhere")
    for cut in np.linspace(5, len(content) - 600, 25).astype(int):
        file.write_bytes(content[:cut])
        with refused(file.name):
            read(file)


def test_an_enormous_file_is_read_in_part(tmp_path, signals):
    file = tmp_path / "ankle.h5"
    write_hdf5(file, *signals)
    with h5py.File(file, "r+") as root:
        for key in ("big", "vast"):  # a terabyte each, which takes no place on disk
            root.create_dataset(key, (1000, 125_000_000), "f8", chunks=(1, 1_000_000))
    np.testing.assert_array_equal(read(file).angle, signals[0])
    with refused(r"it asks for too much memory.* Save a part of a large one"):
        read(file, angle="big", torque="vast")


def test_groups_dimensions_and_packed_values_of_netcdf(tmp_path, signals):
    pairs = zip(NAMES.values(), signals, strict=True)
    trials = {name: (("trial", "time"), values.reshape(3, 200)) for name, values in pairs}
    tree = {"/": xr.Dataset(attrs={"fs": 200}), "/day1": xr.Dataset(trials)}
    xr.DataTree.from_dict(tree).to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    recording = read(tmp_path / "a.nc", angle="day1/pos", torque="day1/tq", columns="trials")
    np.testing.assert_array_equal(recording.angle, signals[0])
    assert recording.trial_starts == (0, 200, 400)
    WRITERS["ankle.nc"](tmp_path / "ankle.nc", *signals)
    angle = read(tmp_path / "ankle.nc", angle="coarse").angle
    np.testing.assert_allclose(angle, np.round(signals[0], 3), atol=1e-7)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.ones(600) + 1j, "expected real numbers, got values of type complex128"),
        (np.array(["a"] * 600), "expected real numbers, got text"),
        (
            np.array([[1.0], [1.0, 2.0]], dtype=object),
            "an array that cannot be read .Object",
        ),
        (np.ones(599), r"lengths or trials: other \(599\), tq \(600\); name channels"),
        (np.ones((10, 20, 3)), r"expected a vector or a matrix, got an array of shape"),
        (np.zeros(0), "expected samples, got an empty array"),
    ],
)
def test_what_is_no_signal_is_refused(tmp_path, signals, values, message):
    np.savez(tmp_path / "ankle.npz", other=values, tq=signals[1])
    with refused(message):
        read(tmp_path / "ankle.npz", angle="other")


def test_nothing_is_unpickled(tmp_path):
    class Trap:
        def __reduce__(self):
            return (pytest.fail, ("the file was unpickled",))

    np.savez(tmp_path / "trap.npz", pos=np.array([Trap()], dtype=object), tq=np.ones(3))
    for ending in ("mat", "npy.npz", "nc"):
        (tmp_path / f"trap.{ending}").write_bytes(pickle.dumps(Trap()))
    for file in tmp_path.iterdir():
        with refused("cannot be read"):
            read(file)


@pytest.mark.parametrize("name", ["ankle.h5", "v73.mat", "ankle.nc"])
def test_nothing_leads_out_of_a_file(tmp_path, signals, name):
    """What is not followed is listed. Files of libraries that follow links are refused."""
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
        root["through"] = h5py.SoftLink("/inner/link")
        root["same"] = h5py.SoftLink("/pos")
        root["inner/again"] = root["/"]
        root["type"], root["empty"] = np.dtype("f8"), h5py.Empty("f8")
    if name != "ankle.h5":
        with refused("save the file with its values in itself"):
            describe_file(file)
        return
    np.testing.assert_array_equal(read(file, angle="same").angle, signals[0])
    described = describe_file(file)
    for path in ("inner/link", "nowhere", "through", "virtual", "outer"):
        with refused(f"{path}: expected real numbers, got (a link|values in another file), which"):
            described[path].read(path)


def test_names_that_occur_twice_are_refused(tmp_path):
    (tmp_path / "a.csv").write_text("pos, tq ,pos\n1,2,3\n")
    savemat(tmp_path / "a.mat", {"tq": np.ones(3)})
    content = (tmp_path / "a.mat").read_bytes()
    (tmp_path / "a.mat").write_bytes(content + content[128:])
    for name, text in {"a.csv": "channels are called 'pos'", "a.mat": "name 'tq'"}.items():
        with refused(f"{name}: .*{text}"):
            describe_file(tmp_path / name)


@pytest.mark.parametrize(
    "text",
    [
        "pos,tq,n\n0.5,-1,1\n1.25,2,2\n",
        "pos;tq;n\n0,5;-1;1\n1,25;2;2\n",
        "pos;tq;n\n0.5;-1;1\n1.25;2;2\n",
        "pos;tq;n\r\n[°];N m;\r\n0,5;-1;1\r\n1,25;2;2\r\n",
    ],
)
def test_text_with_and_without_names_by_commas_or_semicolons(tmp_path, text):
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    recording = read(tmp_path / "a.csv", angle_unit="deg")
    assert describe_file(tmp_path / "a.csv")["tq"].unit == "N m" * ("N m" in text)
    np.testing.assert_allclose(np.degrees(recording.angle), [0.5, 1.25])
    np.testing.assert_array_equal(recording.torque, [-1, 2])
    (tmp_path / "a.csv").write_text(text[text.index("0") :])
    bare = read(tmp_path / "a.csv", angle="1", torque="2", angle_unit="deg")
    np.testing.assert_array_equal(bare.angle, recording.angle)


def test_time_series_of_nwb(tmp_path, signals):
    file = tmp_path / "ankle.nwb"
    counts, both = np.round(signals[0] / 1e-4).astype("i2"), np.stack(signals, axis=1)
    uneven = np.cumsum(np.r_[np.full(300, 0.005), 0.01, np.full(299, 0.005)])
    with h5py.File(file, "w") as root:
        write_series(root, "pos", counts, "rad", conversion=1e-4, offset=0.5)
        write_series(root, "tq", both, "N m", conversion=2.0)
        root["tq/channel_conversion"] = [1.0, 3.0]
        shared = h5py.SoftLink("/lost/timestamps")
        for name, times in {"lost": uneven, "short": uneven[1:], "shared": shared}.items():
            write_series(root, name, signals[0], "rad", timestamps=times)
        root["session_description"] = "no signal"
    recording = read(file, torque="tq.2")
    np.testing.assert_allclose(recording.angle, 1e-4 * counts + 0.5, rtol=1e-15)
    np.testing.assert_allclose(recording.torque, 6 * signals[1], rtol=1e-15)
    for name in ("lost", "shared", "short"):
        with refused("expected real numbers, got values without evenly spaced times"):
            read(file, angle=name, torque="tq.2")


def test_motion_bids_without_its_descriptions_is_refused(tmp_path, signals):
    file, described = tmp_path / "sub-1_motion.tsv", tmp_path / "sub-1_channels.tsv"
    WRITERS["sub-1_motion.tsv"](file, *signals)
    rows = described.read_text()
    for text, message in {
        rows.replace("MISC", "LATENCY"): "got values without evenly spaced times",
        rows + "\nemg\tEMG\tV": "for each of the 2 columns, got 3 rows",
    }.items():
        described.write_text(text)
        with refused(message):
            read(file)
    described.unlink()
    with refused(r"no sub-1_channels\.tsv beside it, which names its columns"):
        read(file)
    file.write_text("pos\ttq\n" + file.read_text())
    with refused(r"expected numbers in the first line, .* got \['pos', 'tq'\]"):
        read(file)


def test_angles_and_moments_that_c3d_stores_as_points(tmp_path, signals):
    file = tmp_path / "gait.c3d"
    write_gait(file, *signals)
    names = {"angle": "LAnkleAngles.x", "torque": "LAnkleMoment.z"}
    recording = read(file, **names, angle_unit="deg", torque_unit="Nmm")
    np.testing.assert_allclose(recording.angle, signals[0], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(recording.torque, signals[1], rtol=1e-6, atol=1e-9)
    described = describe_file(file)
    labels = ("LAnkleAngles", "LAnkleMoment", "LANK")
    assert {*described} == {f"{label}.{axis}" for label in labels for axis in "xyz"}
    assert [described[name].unit for name in (*names.values(), "LANK.y")] == ["deg", "Nmm", "mm"]
    with pytest.warns(tv.DataQualityWarning, match=r"unit 'Nmm' for LAnk.*|has an RMS|'deg'"):
        read(file, **names)


def test_edf_that_was_interrupted_is_refused(tmp_path, signals):
    edfio = pytest.importorskip("edfio", reason="edfio is not installed")
    file = tmp_path / "ankle.edf"
    same = [edfio.EdfSignal(each, 200.0, label="V", physical_dimension="mV") for each in signals]
    edfio.Edf(same, annotations=[edfio.EdfAnnotation(0, None, "start")]).write(file)
    assert {name: it.unit for name, it in describe_file(file).items()} == dict.fromkeys(
        ("V (1)", "V (2)"), "mV"
    )
    content = file.read_bytes().replace(b"EDF+C", b"EDF+D")  # gaps are possible, and there is none
    file.write_bytes(content)
    assert len(describe_file(file)) == 2
    file.write_bytes(content.replace(b"+1\x14\x14", b"+7\x14\x14"))
    with refused(r"the recording was interrupted \(EDF\+D\)"):
        describe_file(file)
