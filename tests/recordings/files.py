"""The same two signals in files of every format, as laboratories' programs write them."""

import json
import warnings
from functools import partial

import h5py
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy.io import savemat
from scipy.io.matlab import MatlabObject

import tvsysid as tv

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # as below
    import matio
    from matio.utils import MatlabOpaque

NAMES = {"angle": "pos", "torque": "tq"}


def read(file, sampling_rate=200.0, **settings):
    return tv.read_recording(file, **(NAMES | settings), sampling_rate=sampling_rate)


def refused(match):
    return pytest.raises(tv.InputError, match=match)


def write_mat(file, angle, torque, **settings):
    savemat(file, {"pos": angle[:, None], "tq": torque[None, :], "fs": 200.0}, **settings)


def write_mat_73(file, angle, torque):
    run = np.empty((1, 1), dtype=[("pos", object)])
    run["pos"][0, 0] = np.stack([angle, -angle], axis=1)
    variables = {"pos": angle[:, None], "tq": torque[None, :], "fs": 200.0, "run": run}
    save_objects(file, variables | {"note": "hi"}, "v7.3")


def save_objects(file, variables, version):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of pandas, about options that the library sets
        matio.save_to_mat(str(file), variables, version=version)


def write_text(file, angle, torque):
    separator = "\t" if file.suffix == ".tsv" else ","
    pd.DataFrame({"pos": angle, "tq": torque}).to_csv(file, sep=separator, index=False)


def write_npz(file, angle, torque):
    np.savez_compressed(file, pos=angle, tq=torque, fs=200.0)


def write_hdf5(file, angle, torque):
    with h5py.File(file, "w") as root:
        root.attrs["sampling_rate"] = 200.0
        root.create_dataset("pos", data=angle, compression="gzip").attrs["units"] = "rad"
        root.create_dataset("tq", data=torque).attrs["units"] = "N m"
        root["run1/pos"] = angle


def write_netcdf(file, angle, torque, engine="h5netcdf"):
    signals = {"pos": ("time", angle, {"units": "rad"}), "tq": ("time", torque, {"units": "N m"})}
    signals["coarse"] = ("time", np.round(angle, 3))
    # From 2 bytes and a factor, as loggers store it, to the values that it stands for.
    encoding = {"coarse": {"dtype": "int16", "scale_factor": 0.001, "_FillValue": -32768}}
    dataset = xr.Dataset(signals, attrs={"sampling_rate": 200.0})
    dataset.to_netcdf(file, engine=engine, encoding=encoding)


def write_parquet(file, angle, torque):
    pyarrow = pytest.importorskip("pyarrow", reason="pyarrow is not installed")
    from pyarrow import parquet

    columns = [
        pyarrow.field(name, pyarrow.float64(), metadata={"unit": unit})
        for name, unit in (("pos", "rad"), ("tq", "Nm"))
    ]
    schema = pyarrow.schema(columns, metadata={"sampling_rate": "200"})
    parquet.write_table(pyarrow.table([angle, torque], schema=schema), file)


def write_c3d(file, angle, torque):
    ezc3d = pytest.importorskip("ezc3d", reason="ezc3d is not installed")
    content = ezc3d.c3d()
    content.add_parameter("ANALOG", "LABELS", ["pos", "tq"])
    content.add_parameter("ANALOG", "UNITS", ["rad", "Nm"])
    content["parameters"]["ANALOG"]["RATE"]["value"] = [200.0]
    content["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    content["parameters"]["POINT"]["LABELS"]["value"] = ["ankle"]
    content["data"]["points"] = np.ones((4, 1, len(angle) // 2))
    content["data"]["analogs"] = np.stack([angle, torque])[None]
    content.write(str(file))


def write_series(root, path, values, unit, rate=200.0, timestamps=None, **attributes):
    """One time series as NWB has it."""
    group = root.create_group(path)
    group.create_dataset("data", data=values).attrs.update(
        {"unit": unit, "conversion": 1.0, "offset": 0.0} | attributes
    )
    if timestamps is None:
        group.create_dataset("starting_time", data=0.0).attrs.update(
            {"rate": rate, "unit": "seconds"}
        )
    else:
        group["timestamps"] = timestamps


def write_nwb(file, angle, torque):
    with h5py.File(file, "w") as root:
        write_series(root, "pos", angle, "rad")
        write_series(root, "tq", torque, "N m", timestamps=3 + np.arange(len(torque)) / 200)


def write_motion(file, angle, torque):
    """Motion-BIDS, and what describes it beside it."""
    stem = file.name.removesuffix("motion.tsv")
    rows = ["name\ttype\tunits", "pos\tJNTANG\trad", "tq\tMISC\tN m"]
    np.savetxt(file, np.stack([angle, torque], axis=1), fmt="%.17g", delimiter="\t")
    (file.parent / f"{stem}channels.tsv").write_text("\n".join(rows))
    (file.parent / f"{stem}motion.json").write_text(json.dumps({"SamplingFrequency": 200}))


def write_edf(file, angle, torque):
    edfio = pytest.importorskip("edfio", reason="edfio is not installed")
    bdf = file.suffix == ".bdf"
    signal, recording = (edfio.BdfSignal, edfio.Bdf) if bdf else (edfio.EdfSignal, edfio.Edf)
    kinds = (("pos", "rad", angle), ("tq", "Nm", torque))
    signals = [
        signal(each, 200.0, label=name, physical_dimension=unit) for name, unit, each in kinds
    ]
    recording(signals, data_record_duration=0.1).write(file)


def cells(*texts):
    array = np.empty((1, len(texts)), dtype=object)
    array[0] = [np.array([text]) for text in texts]
    return array


def nldat(signals, **changes):
    """Properties of the toolbox's object of two channels."""
    return {
        "chanNames": cells("pos", "tq"),
        "chanUnits": cells("(deg)", "Nm"),
        "domainIncr": np.array([[0.005]]),
        "domainName": np.array(["Time (s)"]),
        "dataSet": np.stack(signals, axis=1),
    } | changes


def write_object(file, values, age):
    if age == "old":  # as @nldat was, a class made of a structure
        record = np.empty((1, 1), dtype=[(name, object) for name in values])
        for name, item in values.items():
            record[name][0, 0] = item
        savemat(file, {"io": MatlabObject(record, "nldat")})
        return
    save_objects(file, {"io": MatlabOpaque(values, "nldat")}, age)


def write_gait(file, angle, torque):
    """As models of the body are stored: in points, in degrees and N·mm."""
    ezc3d = pytest.importorskip("ezc3d", reason="ezc3d is not installed")
    content = ezc3d.c3d()
    about = content["parameters"]["POINT"]
    about["RATE"]["value"], about["UNITS"]["value"] = [200.0], ["mm"]
    about["LABELS"]["value"] = ["LANK", "LAnkleAngles", "LAnkleMoment"]
    for name, value in {
        "ANGLES": "LAnkleAngles",
        "ANGLE_UNITS": "deg",
        "MOMENTS": "LAnkleMoment",
        "MOMENT_UNITS": "Nmm",
    }.items():
        content.add_parameter("POINT", name, [value])
    points = np.ones((4, 3, len(angle)))
    points[0, 1], points[2, 2] = np.degrees(angle), 1000 * torque
    content["data"]["points"] = points
    content.write(str(file))


def parameters(**values):
    """Return objects of the toolbox's class `param`, in cells: matio writes no arrays of them."""
    items = np.empty((1, len(values)), dtype=object)
    for number, (name, value) in enumerate(values.items()):
        box = np.empty((1, 1), dtype=object)
        box[0, 0] = np.array([[np.nan]]) if value is None else np.atleast_2d(value).astype(float)
        about = {
            "paramName": np.array([name]),
            "paramValue": box,
            "paramDefault": np.array([[1.0]]),
        }
        items[0, number] = MatlabOpaque(about, "param")
    return items


def write_segdat(file, signals, kind, onsets, lengths):
    if kind == "struct":
        savemat(
            file, {"io": nldat(signals, onsetPointer=np.array(onsets), segLength=np.array(lengths))}
        )
        return
    values = nldat(signals, parameterSet=parameters(onsetPointer=onsets, segLength=lengths))
    save_objects(file, {"io": MatlabOpaque(values, "segdat")}, kind)


WRITERS = {
    "v5.mat": write_mat,
    "v73.mat": write_mat_73,
    "plain.mat": write_hdf5,
    "ankle.csv": write_text,
    "ankle.tsv": write_text,
    "ankle.npz": write_npz,
    "ankle.h5": write_hdf5,
    "ankle.hdf5": write_hdf5,
    "ankle.nc": write_netcdf,
    "classic.nc": partial(write_netcdf, engine="scipy"),
    "ankle.parquet": write_parquet,
    "ankle.c3d": write_c3d,
    "ankle.nwb": write_nwb,
    "sub-1_motion.tsv": write_motion,
    "ankle.edf": write_edf,
    "ankle.bdf": write_edf,
}
