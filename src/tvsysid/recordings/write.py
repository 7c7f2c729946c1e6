"""Recordings, ensembles, simulations and models to files, and back."""

from __future__ import annotations

import csv
import json
import math
import os
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError, printable
from tvsysid.models import Content, Model, Variables
from tvsysid.recordings.process import contents_of
from tvsysid.signals import Ensemble, Recording

LONGEST_NAME = (
    28  # letters of a variable; MATLAB's files of version 5 hold 31, with a number behind
)
UNITS = {"angle": "rad", "torque": "N m"}
RESERVED = {"time", "realization", "trial", "tvsysid"}
RESERVED |= {item.name for kind in (Recording, Ensemble) for item in attrs.fields(kind)}


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """Temporary path beside a file, which takes the file's place when the block ends without an error.

    So a file appears whole or not at all. Its folder is made if need be.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(
        dir=target.parent, prefix=f".{target.stem}-", suffix=target.suffix
    )
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        os.umask(mask := os.umask(0))
        temporary.chmod(0o666 & ~mask)
        temporary.replace(target)
    except OSError as error:
        error.filename = error.filename or str(
            target
        )  # the system does not say which file it could not write
        raise
    finally:
        temporary.unlink(missing_ok=True)


def write_simulation(
    path: str | Path, columns: Mapping[str, NDArray[np.float64]], sampling_rate: float
) -> None:
    """Write signals of one length to a MAT file, or to a CSV or TSV file with a header line.

    Columns are signals by name, each of shape (time,), in a MAT file (time, trial) as well,
    which also keeps the ``sampling_rate``. An InputError is raised for a path with another
    ending.
    """
    file = _checked(path, ".mat", ".csv", ".tsv")
    with whole_file(file) as temporary:
        if file.suffix.lower() == ".mat":
            from scipy.io import savemat  # noqa: PLC0415  # heavy

            matrices = {
                name: np.asarray(values).reshape(len(values), -1)
                for name, values in columns.items()
            }
            savemat(temporary, {**matrices, "sampling_rate": sampling_rate}, do_compression=True)
        else:
            import pandas as pd  # noqa: PLC0415  # heavy

            separator = "," if file.suffix.lower() == ".csv" else "\t"
            pd.DataFrame(dict(columns)).to_csv(
                temporary, sep=separator, index=False, float_format="%.9g"
            )


def write_table(path: str | Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows to a CSV file: numbers with six digits, nothing where they are NaN or a row has no such column."""
    names = dict.fromkeys(name for row in rows for name in row)
    with whole_file(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        for row in rows:
            cells = (row.get(name, math.nan) for name in names)
            texts = (f"{cell:.6g}" if isinstance(cell, float) else cell for cell in cells)
            writer.writerow("" if text == "nan" else text for text in texts)


def write_models(
    path: str | Path, models: Mapping[str, Model], ensemble: Ensemble | None = None
) -> None:
    """Write models to a NetCDF file, one group for each; ``xarray.open_datatree`` reads it.

    A group holds what :meth:`tvsysid.Model.to_xarray` returns: every estimate, its standard error,
    degrees of freedom and 95 % limits, and what the method has identified besides; the torque of
    each pathway for an ensemble, if one is given. NetCDF has no complex numbers: a frequency
    response becomes ``frequency_response_real`` and ``_imag``.

    Parameters
    ----------
    path, models, ensemble
        File to write; models by name of the group; the ensemble whose torque is written too.

    Examples
    --------
    >>> import tvsysid as tv, tempfile, xarray
    >>> noise = tv.simulate.FilteredNoise()
    >>> recording = tv.simulate.Joint().simulate(40, perturbation=noise, snr_db=10, seed=1).recording
    >>> ensemble = tv.preprocess.segment(tv.preprocess.decimate(recording, 100), period=2.0)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_models(f"{folder}/models.nc", {"birf": tv.BasisIRF().identify(ensemble)}, ensemble)
    ...     tree = xarray.open_datatree(f"{folder}/models.nc", engine="h5netcdf").load()
    ...     tree.close()
    >>> sorted(name for name in tree["birf"].data_vars if name.startswith("stiffness"))
    ['stiffness', 'stiffness_freedom', 'stiffness_lower', 'stiffness_standard_error',
    'stiffness_upper']
    >>> dict(tree["birf"].torque_intrinsic.sizes)
    {'realization': 20, 'time': 200}
    """
    content = _netcdf({name: model.content(ensemble) for name, model in models.items()})
    with whole_file(path) as temporary:
        temporary.write_bytes(content)


def describe_models(path: str | Path, about: Mapping[str, str | float]) -> None:
    """Add what is known of models to their file, which stays whole or as it was.

    Parameters
    ----------
    path, about
        File of :func:`write_models`, and its attributes by name.
    """
    import h5py  # noqa: PLC0415  # heavy

    content = BytesIO(Path(path).read_bytes())
    with h5py.File(content, "r+") as root:
        root.attrs.update(
            {
                name: printable(each) if isinstance(each, str) else each
                for name, each in about.items()
            }
        )
    with whole_file(path) as temporary:
        temporary.write_bytes(content.getvalue())


def _netcdf(groups: Mapping[str, Content]) -> bytes:
    """Return the content of a NetCDF file with these groups.

    To import xarray would take longer than to write it.
    """
    import h5netcdf  # noqa: PLC0415  # heavy
    import h5py  # noqa: PLC0415  # heavy

    content = BytesIO()  # HDF5 itself crashes where a disk is full
    with h5netcdf.File(content, "w") as root:
        for path, (variables, coordinates, attributes) in groups.items():
            group = root if path == "/" else root.create_group(path)
            group.attrs.update(attributes)
            for name, (axes, values, about) in {
                **coordinates,
                **_without_complex(variables),
            }.items():
                for axis, length in zip(axes, values.shape, strict=True):
                    if axis not in group.dimensions:
                        group.dimensions[axis] = length
                kind = values.dtype if values.dtype.kind in "fiu" else h5py.string_dtype()
                if (
                    values.dtype.kind == "b"
                ):  # NetCDF has none; xarray reads them by their attribute
                    kind = np.dtype(np.int8)
                missing = np.nan if values.dtype.kind == "f" else None
                variable = group.create_variable(
                    name, axes, kind, values.astype(kind), fillvalue=missing
                )
                variable.attrs.update(
                    about | ({"dtype": "bool"} if values.dtype.kind == "b" else {})
                )
    return content.getvalue()


def _without_complex(variables: Variables) -> Variables:
    """Variables whose complex ones are split into a real and an imaginary part."""
    found: Variables = {}
    for name, (axes, values, about) in variables.items():
        parts = (
            {"_real": values.real, "_imag": values.imag}
            if np.iscomplexobj(values)
            else {"": values}
        )
        found |= {f"{name}{ending}": (axes, part, about) for ending, part in parts.items()}
    return found


def write_recording(path: str | Path, recording: Recording) -> None:
    """Write a recording to a NetCDF or a MAT file; :func:`load_recording` reads it back unchanged.

    Any program reads the file: angle (rad), torque (N·m) and further channels are variables of
    their own names, as far as the format allows. An InputError is raised for an ending that is not
    .nc or .mat, or for more than a MAT file holds.

    Examples
    --------
    >>> import numpy as np, tempfile
    >>> angle = 0.02 * np.sin(np.arange(2000) / 50)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_recording(f"{folder}/ankle.nc", Recording(angle, 80 * angle, 100))
    ...     load_recording(f"{folder}/ankle.nc")
    Recording(20 s at 100 Hz; angle RMS 0.0142 rad, torque RMS 1.14 N·m)
    """
    about = {
        name: getattr(recording, name)
        for name in ("sampling_rate", "start", "origin", "delay_removed")
    }
    _write(
        path,
        recording,
        ("time",),
        about,
        "trial",
        {"trial_starts": np.array(recording.trial_starts)},
    )


def load_recording(path: str | Path) -> Recording:
    """Recording that :func:`write_recording` wrote, with its sampling rate, trials and channels.

    An InputError is raised for a file of other origin; read that by :func:`tvsysid.read_recording`.
    """
    with _loaded(path, "recording") as (found, channels):
        return Recording(
            np.ravel(found["angle"]),
            np.ravel(found["torque"]),
            float(found["sampling_rate"]),
            float(found["start"]),
            {name: np.ravel(values) for name, values in channels.items()},
            tuple(np.ravel(found["trial_starts"]).astype(np.int64).tolist()),
            float(found.get("origin", 0.0)),
            float(found.get("delay_removed", 0.0)),
            _recorded(found, (-1,)),
        )


def write_ensemble(path: str | Path, ensemble: Ensemble) -> None:
    """Write an ensemble to a NetCDF or a MAT file; :func:`load_ensemble` reads it back unchanged.

    Its signals become matrices of realization x time, context and all; otherwise as
    :func:`write_recording`.
    """
    names = ("sampling_rate", "context", "left_out", "origin", "delay_removed")
    about = {name: getattr(ensemble, name) for name in names}
    about["mean_subtracted"] = int(ensemble.mean_subtracted)  # neither format has truth values
    vectors = {"onsets": np.asarray(ensemble.onsets), "trials": np.asarray(ensemble.trials)}
    _write(path, ensemble, ("realization", "time"), about, "realization", vectors)


def load_ensemble(path: str | Path) -> Ensemble:
    """Ensemble that :func:`write_ensemble` wrote; errors as of :func:`load_recording`."""
    with _loaded(path, "ensemble") as (found, channels):
        return Ensemble(
            found["angle"],
            found["torque"],
            float(found["sampling_rate"]),
            context=int(found["context"]),
            onsets=np.ravel(found["onsets"]),
            trials=np.ravel(found["trials"]).astype(np.int64),
            channels=channels,
            left_out=int(found["left_out"]),
            mean_subtracted=bool(found["mean_subtracted"]),
            origin=float(found.get("origin", 0.0)),
            delay_removed=float(found.get("delay_removed", 0.0)),
            recorded_angle=_recorded(found, found["angle"].shape),
        )


def _write(
    path: str | Path,
    signals: Recording | Ensemble,
    dims: tuple[str, ...],
    about: Mapping[str, float],
    vector_dim: str,
    vectors: Mapping[str, NDArray[Any]],
) -> None:
    """Signals with these dimensions, numbers about them, and vectors along a dimension of their own."""
    file = _checked(path, ".nc", ".mat")
    variables = _variables(list(signals.channels))
    # As text, so that names that are no names of variables come back unchanged.
    labels = {"tvsysid": type(signals).__name__.lower(), "channels": json.dumps(variables)}
    arrays = {"angle": signals.angle, "torque": signals.torque}
    arrays |= {variable: signals.channels[name] for name, variable in variables.items()}
    if signals.recorded_angle is not None:
        arrays["recorded_angle"] = signals.recorded_angle
    with whole_file(file) as temporary:
        if file.suffix.lower() == ".mat":
            from scipy.io import savemat  # noqa: PLC0415  # heavy
            from scipy.io.matlab import MatWriteError  # noqa: PLC0415

            try:
                savemat(
                    temporary,
                    {**arrays, **vectors, **about, **labels},
                    do_compression=True,
                    oned_as="column",
                )
            except MatWriteError as error:
                raise InputError(
                    f"{file}: a MAT file cannot hold this ({error}); write a NetCDF file (.nc)"
                ) from error
        else:
            axes, units = (*dims, "sample"), {name: {"units": unit} for name, unit in UNITS.items()}
            content = {
                name: (axes[: each.ndim], each, units.get(name, {}))
                for name, each in arrays.items()
            }
            content |= {name: ((vector_dim,), values, {}) for name, values in vectors.items()}
            temporary.write_bytes(_netcdf({"/": Content(content, {}, {**about, **labels})}))


@contextmanager
def _loaded(
    path: str | Path, kind: str
) -> Iterator[tuple[dict[str, Any], dict[str, NDArray[np.float64]]]]:
    """What a file holds by the names of variables, and its channels by theirs.

    Errors in using it name the file.
    """
    file = _checked(path, ".nc", ".mat")
    found = contents_of(file)
    if str(found.get("tvsysid", "")) != kind:
        raise InputError(
            f"{file}: not written by write_{kind}; what others wrote is read by read_recording"
        )
    try:
        yield (
            found,
            {
                name: found[variable]
                for name, variable in json.loads(str(found["channels"])).items()
            },
        )
    except InputError as error:
        raise InputError(f"{file}: {error}") from error
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(
            f"{file}: not as write_{kind} wrote it ({error!r}); copy it again"
        ) from error


def _recorded(found: Mapping[str, Any], shape: tuple[int, ...]) -> NDArray[np.float64] | None:
    """Angle at the recorded rate; MATLAB drops a last axis of one sample."""
    values = found.get("recorded_angle")
    return (
        None if values is None else np.reshape(values, (*shape, values.size // found["angle"].size))
    )


def _checked(path: str | Path, *endings: str) -> Path:
    file = Path(path)
    if file.suffix.lower() not in endings:
        raise InputError(
            f"{file}: unknown ending {file.suffix!r}; give one of {', '.join(endings)}"
        )
    return file


def _variables(names: Sequence[str]) -> dict[str, str]:
    """Variable for each channel: its own name where MATLAB and NetCDF allow that, and one like it where not.

    Examples
    --------
    >>> _variables(["emg", "sv.Ankle (rad)", "angle"])
    {'emg': 'emg', 'sv.Ankle (rad)': 'sv_Ankle_rad', 'angle': 'angle_2'}
    """
    taken = set(RESERVED)
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
