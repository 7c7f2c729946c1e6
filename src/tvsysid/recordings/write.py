"""Recordings, ensembles, simulations and models to files."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.io import loadmat, savemat
from scipy.io.matlab import MatWriteError

from tvsysid.errors import InputError
from tvsysid.models import Model
from tvsysid.recordings.atomic import whole_file
from tvsysid.recordings.find import describe_file
from tvsysid.recordings.signatures import seems
from tvsysid.signals import Ensemble, Recording

if TYPE_CHECKING:
    import xarray as xr

PLAIN_MAT = ("MAT file of version 5 or 7",)
LONGEST_NAME = 28
"""Letters of a variable; MATLAB's files of version 5 hold 31, with a number behind."""
RESERVED = (
    *("angle", "torque", "time", "realization", "trial", "trials", "trial_starts", "onsets"),
    *("sampling_rate", "start", "context", "left_out", "channels", "tvsysid"),
)


def write_simulation(path: str | Path, columns: Mapping[str, NDArray[np.float64]], sampling_rate: float) -> None:
    """Write signals of one length to a MAT file, or to a CSV or TSV file with a header line.

    Parameters
    ----------
    path
        Ending in .mat, .csv or .tsv.
    columns
        Signals by name, each of shape (time,); in a MAT file (time, trial) as well.
    sampling_rate
        In Hz; kept in a MAT file as ``sampling_rate``.

    Raises
    ------
    InputError
        For another ending.
    """
    file = Path(path)
    ending = file.suffix.lower()
    if ending not in (".mat", ".csv", ".tsv"):
        raise InputError(f"{file}: unknown ending {file.suffix!r}; give one of .mat, .csv, .tsv")
    with whole_file(file) as temporary:
        if ending == ".mat":
            matrices = {name: np.asarray(values).reshape(len(values), -1) for name, values in columns.items()}
            savemat(temporary, {**matrices, "sampling_rate": sampling_rate}, do_compression=True)
        else:
            separator = "," if ending == ".csv" else "\t"
            pd.DataFrame(dict(columns)).to_csv(temporary, sep=separator, index=False, float_format="%.9g")


def write_models(path: str | Path, models: Mapping[str, Model], ensemble: Ensemble | None = None) -> None:
    """Write models to a NetCDF file, one group for each; ``xarray.open_datatree`` reads it.

    NetCDF has no complex numbers: a frequency response becomes ``frequency_response_real`` and ``_imag``.

    Parameters
    ----------
    path
        File to write.
    models
        By name of the group.
    ensemble
        If given, the torque of each pathway for it is written too: ``torque_`` and the pathway's name.
    """
    import xarray as xr  # noqa: PLC0415  # heavy

    tree = xr.DataTree.from_dict({name: _without_complex(model.to_xarray(ensemble)) for name, model in models.items()})
    with whole_file(path) as temporary:
        tree.to_netcdf(temporary, engine="h5netcdf", mode="w")


def _without_complex(dataset: xr.Dataset) -> xr.Dataset:
    for name in [str(name) for name, values in dataset.data_vars.items() if np.iscomplexobj(values)]:
        dataset[f"{name}_real"], dataset[f"{name}_imag"] = dataset[name].real, dataset[name].imag
        for part in ("real", "imag"):
            dataset[f"{name}_{part}"].attrs = dict(dataset[name].attrs)
        dataset = dataset.drop_vars(name)
    return dataset


def write_recording(path: str | Path, recording: Recording) -> None:
    """Write a recording to a NetCDF or a MAT file; :func:`load_recording` reads it back unchanged.

    Any program reads the file: angle (rad), torque (N·m) and further channels are variables of their own names, as far
    as the format allows.

    Parameters
    ----------
    path
        Ending in .nc or .mat.
    recording
        To write.

    Raises
    ------
    InputError
        For another ending, or for more than a MAT file holds.

    Examples
    --------
    >>> import numpy as np, tempfile
    >>> angle = 0.02 * np.sin(np.arange(2000) / 50)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_recording(f"{folder}/ankle.nc", Recording(angle, 80 * angle, 100))
    ...     load_recording(f"{folder}/ankle.nc")
    Recording(20 s at 100 Hz; angle RMS 0.0142 rad, torque RMS 1.14 N·m)
    """
    about = {"sampling_rate": recording.sampling_rate, "start": float(recording.start)}
    extent = {"trial_starts": np.asarray(recording.trial_starts, dtype=np.int64)}
    _write(Path(path), "recording", recording, about, extent, ("time",), "trial")


def write_ensemble(path: str | Path, ensemble: Ensemble) -> None:
    """Write an ensemble to a NetCDF or a MAT file; :func:`load_ensemble` reads it back unchanged.

    Parameters
    ----------
    path
        Ending in .nc or .mat.
    ensemble
        To write; its signals become matrices of realization x time, context and all.

    Raises
    ------
    InputError
        For another ending, or for more than a MAT file holds.
    """
    assert ensemble.onsets is not None
    assert ensemble.trials is not None
    about = {
        "sampling_rate": ensemble.sampling_rate,
        "context": int(ensemble.context),
        "left_out": int(ensemble.left_out),
    }
    extent = {"onsets": ensemble.onsets, "trials": ensemble.trials}
    _write(Path(path), "ensemble", ensemble, about, extent, ("realization", "time"), "realization")


def load_recording(path: str | Path) -> Recording:
    """Recording that :func:`write_recording` wrote, with its sampling rate, trials and channels.

    Parameters
    ----------
    path
        Ending in .nc or .mat.

    Raises
    ------
    InputError
        If the file is of other origin; read that by :func:`tvsysid.read_recording`.
    """
    found, signals = _loaded(Path(path), "recording", 1)
    return Recording(
        **signals,
        sampling_rate=float(found["sampling_rate"]),
        start=float(found["start"]),
        trial_starts=tuple(int(first) for first in np.ravel(found["trial_starts"])),
    )


def load_ensemble(path: str | Path) -> Ensemble:
    """Ensemble that :func:`write_ensemble` wrote.

    Parameters
    ----------
    path
        Ending in .nc or .mat.

    Raises
    ------
    InputError
        If the file is of other origin.
    """
    found, signals = _loaded(Path(path), "ensemble", 2)
    return Ensemble(
        **signals,
        sampling_rate=float(found["sampling_rate"]),
        context=int(found["context"]),
        left_out=int(found["left_out"]),
        onsets=np.ravel(found["onsets"]),
        trials=np.ravel(found["trials"]).astype(np.int64),
    )


def _write(
    file: Path,
    kind: str,
    signals: Recording | Ensemble,
    about: Mapping[str, float],
    extent: Mapping[str, NDArray[Any]],
    dims: tuple[str, ...],
    extent_dim: str,
) -> None:
    """Write signals, single numbers about them, and vectors along a dimension of their own."""
    _checked_ending(file)
    variables = _variables(list(signals.channels))
    # As text, so that names that are no names of variables come back unchanged.
    labels = {"tvsysid": kind, "channels": json.dumps(variables)}
    arrays = {"angle": signals.angle, "torque": signals.torque}
    arrays |= {variable: signals.channels[name] for name, variable in variables.items()}
    with whole_file(file) as temporary:
        if file.suffix.lower() == ".mat":
            try:
                savemat(temporary, {**arrays, **extent, **about, **labels}, do_compression=True, oned_as="column")
            except MatWriteError as error:
                raise InputError(f"{file}: a MAT file cannot hold this ({error}); write a NetCDF file (.nc)") from error
        else:
            import xarray as xr  # noqa: PLC0415  # heavy

            units = {"angle": "rad", "torque": "N m"}
            content: dict[str, Any] = {
                name: (dims, values, {"units": units[name]} if name in units else {}) for name, values in arrays.items()
            }
            content |= {name: (extent_dim, values) for name, values in extent.items()}
            xr.Dataset(content, attrs={**about, **labels}).to_netcdf(temporary, engine="h5netcdf", mode="w")


def _loaded(file: Path, kind: str, axes: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """What a file holds by name, and the signals in it as arguments of their class."""
    _checked_ending(file)
    describe_file(file)  # whether it can be read at all, and is what its ending says
    if file.suffix.lower() == ".mat":
        found = loadmat(file, mat_dtype=True, chars_as_strings=True) if seems(file) in PLAIN_MAT else {}
        found = {
            name: values.ravel()[0] if np.size(values) == 1 else values
            for name, values in found.items()
            if not name.startswith("__")
        }
    else:
        import xarray as xr  # noqa: PLC0415  # heavy

        dataset = xr.load_dataset(file, decode_times=False)
        found = {**{str(name): values.values for name, values in dataset.variables.items()}, **dataset.attrs}
    if str(found.get("tvsysid", "")) != kind:
        raise InputError(f"{file}: not written by write_{kind}; what others wrote is read by read_recording")

    def signal(name: str) -> NDArray[np.float64]:
        values = np.asarray(found[name], dtype=np.float64)
        return values.ravel() if axes == 1 else values

    names = json.loads(str(found["channels"]))
    channels = {name: signal(variable) for name, variable in names.items()}
    return found, {"angle": signal("angle"), "torque": signal("torque"), "channels": channels}


def _checked_ending(file: Path) -> None:
    if file.suffix.lower() not in (".nc", ".mat"):
        raise InputError(f"{file}: unknown ending {file.suffix!r}; give one of .nc, .mat")


def _variables(names: Sequence[str]) -> dict[str, str]:
    """Variable for each channel: its own name where MATLAB and NetCDF allow that, and one like it where not.

    Examples
    --------
    >>> _variables(["emg", "sv.Ankle (rad)", "angle"])
    {'emg': 'emg', 'sv.Ankle (rad)': 'sv_Ankle_rad', 'angle': 'angle_2'}
    """
    taken = {name.lower() for name in RESERVED}
    variables = {}
    for name in names:
        plain = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_")[:LONGEST_NAME]
        plain = plain if re.match("[A-Za-z]", plain) else f"channel_{plain}".rstrip("_")
        number, free = 1, plain
        while free.lower() in taken:
            number += 1
            free = f"{plain}_{number}"
        taken.add(free.lower())
        variables[name] = free
    return variables
