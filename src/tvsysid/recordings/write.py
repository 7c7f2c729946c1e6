"""Write recordings, ensembles, simulations and models to files, and load them."""

from __future__ import annotations

import json
import re
import uuid
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeVar

import attrs
import numpy as np
from numpy.typing import NDArray

from tvsysid.dataset_layout import Variables, layout
from tvsysid.errors import InputError, printable
from tvsysid.models import Model
from tvsysid.recordings.channel import explained
from tvsysid.recordings.worker import run_isolated
from tvsysid.signals import Ensemble, Recording

if TYPE_CHECKING:
    import pandas as pd

VARIABLE = re.compile(r"[a-z](\w{,29}[^\W_])?", re.ASCII | re.IGNORECASE)  # of a MAT file
UNITS = {"angle": {"units": "rad"}, "torque": {"units": "N m"}}
RESERVED = {"time", "realization", "trial", "sample", "tvsysid"}
RESERVED |= {name for kind in (Recording, Ensemble) for name in attrs.fields_dict(kind)}

NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable.{:10d}"

Group = tuple[Variables, Mapping[str, Any]]  # of a NetCDF file, with its attributes
Written = TypeVar("Written", Recording, Ensemble)


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """Return a temporary path beside a file, which replaces the file if the block has no error.

    The file appears complete or not at all. Its folder is created if it is missing.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.with_name(f".{target.stem}-{uuid.uuid4().hex[:8]}{target.suffix}")
    try:
        yield temporary
        temporary.replace(target)
    except OSError as error:
        error.filename = error.filename or str(target)  # the system may not name the file
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
    file = checked(path, ".mat", ".csv", ".tsv")
    if file.suffix.lower() == ".mat":
        _save_mat(file, {**columns, "sampling_rate": sampling_rate})
        return
    import pandas as pd  # noqa: PLC0415  # heavy

    write_table(file, pd.DataFrame(columns), digits=9)


def write_table(path: str | Path, table: pd.DataFrame, digits: int = 6, missing: str = "") -> None:
    """Write a table to a CSV or TSV file, with ``digits`` significant digits.

    ``missing`` is written for NaN.
    """
    file = checked(path, ".csv", ".tsv")
    separator, form = "," if file.suffix.lower() == ".csv" else "\t", f"%.{digits}g"
    with whole_file(file) as temporary:
        table.to_csv(temporary, sep=separator, index=False, float_format=form, na_rep=missing)


def write_models(
    path: str | Path,
    models: Mapping[str, Model],
    ensemble: Ensemble | None = None,
    about: Mapping[str, str | float] = MappingProxyType({}),
) -> None:
    """Write models to a NetCDF file, one group for each; ``xarray.open_datatree`` reads it.

    A group holds what :meth:`tvsysid.Model.to_xarray` returns: every estimate, its standard error,
    degrees of freedom and 95 % limits, and other results of the method. If an ensemble is given,
    it also holds the torque of each pathway. NetCDF has no complex numbers: a frequency
    response becomes ``frequency_response_real`` and ``_imag``.

    Parameters
    ----------
    path, models, ensemble
        File to write; models by name of the group; the ensemble whose torque is written too.
    about
        Attributes of the file.

    Examples
    --------
    >>> import tvsysid as tv, tempfile, xarray
    >>> noise = tv.simulate.FilteredNoise()
    >>> simulation = tv.simulate.Joint().simulate(40, perturbation=noise, snr_db=10, seed=1)
    >>> recording = tv.preprocess.decimate(simulation.recording, 100)
    >>> ensemble = tv.preprocess.segment(recording, period=2.0)
    >>> models = {"birf": tv.BasisIRF().identify(ensemble)}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_models(f"{folder}/models.nc", models, ensemble)
    ...     tree = xarray.open_datatree(f"{folder}/models.nc", engine="h5netcdf").load()
    ...     tree.close()
    >>> sorted(name for name in tree["birf"].data_vars if name.startswith("stiffness"))
    ['stiffness', 'stiffness_freedom', 'stiffness_lower', 'stiffness_standard_error',
    'stiffness_upper']
    >>> dict(tree["birf"].torque_intrinsic.sizes)
    {'realization': 20, 'time': 200}
    """
    texts = {name: printable(value) for name, value in about.items() if isinstance(value, str)}
    groups: dict[str, Group] = {"/": ({}, {**about, **texts})}
    for name, model in models.items():
        variables, coordinates, attributes = layout(model, ensemble)
        plain: Variables = {}
        for each, (axes, values, units) in {**coordinates, **variables}.items():
            is_complex = np.iscomplexobj(values)
            parts = {"_real": values.real, "_imag": values.imag} if is_complex else {"": values}
            plain |= {f"{each}{end}": (axes, part, units) for end, part in parts.items()}
        groups[name] = plain, attributes
    _save_netcdf(path, groups)


def _save_netcdf(path: str | Path, groups: Mapping[str, Group]) -> None:
    """Write a NetCDF file: HDF5 whose dimensions are scales, which variables are attached to.

    It is made in memory, because HDF5 crashes where a disk is full.
    """
    import h5py  # noqa: PLC0415  # heavy; h5netcdf takes four times as long to write

    stream = BytesIO()
    with h5py.File(stream, "w", track_order=True) as root:
        for name, (variables, attributes) in groups.items():
            group = root if name == "/" else root.create_group(name, track_order=True)
            group.attrs.update(attributes)
            sizes: dict[str, int] = {}
            for each, (axes, values, units) in variables.items():
                kind = h5py.string_dtype() if values.dtype.kind == "U" else values.dtype
                group.create_dataset(each, data=values.astype(kind)).attrs.update(units)
                sizes |= dict(zip(axes, values.shape, strict=True))
            for axis, size in sizes.items():
                if axis not in variables:
                    group.create_dataset(axis, (size,), ">f4")
                group[axis].make_scale(axis if axis in variables else NO_VARIABLE.format(size))
            for each, (axes, *_) in variables.items():
                for place, axis in enumerate(axes):
                    if axis != each:
                        group[each].dims[place].attach_scale(group[axis])
    _save(path, stream)


def _save_mat(path: str | Path, content: Mapping[str, object]) -> None:
    from scipy.io.matlab import savemat  # noqa: PLC0415  # heavy

    stream = BytesIO()
    savemat(stream, dict(content), do_compression=True, oned_as="column")
    _save(path, stream)


def _save(path: str | Path, stream: BytesIO) -> None:
    with whole_file(path) as temporary:
        temporary.write_bytes(stream.getvalue())


def write_recording(path: str | Path, recording: Recording) -> None:
    """Write a recording to a NetCDF or a MAT file; :func:`load_recording` reads it back unchanged.

    Any program reads the file: angle (rad), torque (N·m) and further channels are variables of
    their own names, as far as the format allows. An InputError is raised for an ending that is not
    .nc or .mat.

    Examples
    --------
    >>> import numpy as np, tempfile
    >>> angle = 0.02 * np.sin(np.arange(2000) / 50)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_recording(f"{folder}/ankle.nc", Recording(angle, 80 * angle, 100))
    ...     load_recording(f"{folder}/ankle.nc")
    Recording(20 s at 100 Hz; angle RMS 0.0142 rad, torque RMS 1.14 N·m)
    """
    _write(path, recording)


def load_recording(path: str | Path) -> Recording:
    """Load a recording that :func:`write_recording` wrote, with its rate, trials and channels.

    An InputError is raised for any other file. Read such a file by :func:`tvsysid.read_recording`.
    """
    return _load(path, Recording)


def write_ensemble(path: str | Path, ensemble: Ensemble) -> None:
    """Write an ensemble to a NetCDF or a MAT file; :func:`load_ensemble` reads it back unchanged.

    Its signals become matrices of realization x time, context and all; otherwise as
    :func:`write_recording`.
    """
    _write(path, ensemble)


def load_ensemble(path: str | Path) -> Ensemble:
    """Load an ensemble that :func:`write_ensemble` wrote; errors as of :func:`load_recording`."""
    return _load(path, Ensemble)


def _write(path: str | Path, signals: Recording | Ensemble) -> None:
    """Write arrays as variables, and the other fields as text in JSON."""
    file, names = checked(path, ".nc", ".mat"), _variables(signals.channels)
    settings = attrs.asdict(signals, recurse=False)
    arrays = {names[own]: each for own, each in settings.pop("channels").items()}
    for name in [name for name, each in settings.items() if isinstance(each, np.ndarray)]:
        arrays[name] = settings.pop(name)
    shapes = {name: each.shape for name, each in arrays.items()}  # MATLAB has two axes or more
    kept = {"settings": settings, "channels": names, "shapes": shapes}
    text = json.dumps({type(signals).__name__: kept}, default=lambda number: number.item())
    about = {"tvsysid": text, "sampling_rate": signals.sampling_rate}
    if file.suffix.lower() == ".mat":
        _save_mat(file, {**arrays, **about})
        return
    axes = (*signals.AXES, "sample")
    variables = {
        name: (axes[: each.ndim], each, UNITS.get(name, {})) for name, each in arrays.items()
    }
    _save_netcdf(file, {"/": (variables, about)})


def _load(path: str | Path, kind: type[Written]) -> Written:
    file, name = checked(path, ".nc", ".mat"), kind.__name__
    with explained(str(file)):
        found = run_isolated(_contents, file.absolute())
        kept = json.loads(np.ravel(found.get("tvsysid", "{}"))[0]).get(name)
        if kept is None:
            raise InputError(
                f"not written by write_{name.lower()}; what others wrote is read by read_recording"
            )
        arrays = {key: np.reshape(found[key], shape) for key, shape in kept["shapes"].items()}
        channels = {own: arrays.pop(variable) for own, variable in kept["channels"].items()}
        fields: dict[str, Any] = {**kept["settings"], **arrays}
        if kind is Recording:
            fields["trial_starts"] = tuple(fields["trial_starts"])
        return kind(**fields, channels=channels)


def _contents(file: Path) -> dict[str, Any]:
    """Return variables and attributes of a file that this package wrote."""
    if file.suffix.lower() == ".mat":
        from scipy.io.matlab import loadmat  # noqa: PLC0415  # heavy

        return dict(loadmat(file))
    import h5py  # noqa: PLC0415  # heavy

    from tvsysid.recordings.hdf5 import check_whole  # noqa: PLC0415

    check_whole(file)
    with h5py.File(file, "r") as root:
        return {**root.attrs, **{name: item[()] for name, item in root.items()}}


def checked(path: str | Path, *endings: str) -> Path:
    """Return a path if it has one of the endings."""
    file = Path(path)
    if file.suffix.lower() not in endings:
        raise InputError(
            f"{file}: unknown ending {file.suffix!r}; give one of {', '.join(endings)}"
        )
    return file


def _variables(names: Iterable[str]) -> dict[str, str]:
    """Return the name of each channel's variable: its own where MATLAB allows it, or a number.

    Examples
    --------
    >>> _variables(["emg", "sv.Ankle (rad)", "angle"])
    {'emg': 'emg', 'sv.Ankle (rad)': 'channel_2_', 'angle': 'channel_3_'}
    """
    return {
        name: name if VARIABLE.fullmatch(name) and name not in RESERVED else f"channel_{number}_"
        for number, name in enumerate(names, start=1)
    }
