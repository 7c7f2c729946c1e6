"""Write recordings, ensembles, simulations and models to files, and load them."""

from __future__ import annotations

import json
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

from tvsysid.errors import InputError, printable
from tvsysid.models import Model
from tvsysid.recordings.channel import explained
from tvsysid.recordings.worker import run_isolated
from tvsysid.signals import Ensemble, Recording

if TYPE_CHECKING:
    import pandas as pd

UNITS = {"angle": {"units": "rad"}, "torque": {"units": "N m"}}
RESERVED = {"time", "realization", "trial", "sample", "tvsysid"}
RESERVED |= {name for kind in (Recording, Ensemble) for name in attrs.fields_dict(kind)}

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

    Columns are signals by name, of shape (time,). A MAT file also takes (time, trial), and keeps
    the ``sampling_rate``. An InputError is raised for a path with another ending.
    """
    file = checked(path, ".mat", ".csv", ".tsv")
    if file.suffix.lower() == ".mat":
        from scipy.io.matlab import savemat  # noqa: PLC0415  # heavy

        stream = BytesIO()
        savemat(
            stream,
            {**columns, "sampling_rate": sampling_rate},
            do_compression=True,
            oned_as="column",
        )
        _save(file, stream.getbuffer())
        return
    import pandas as pd  # noqa: PLC0415  # heavy

    write_table(file, pd.DataFrame(columns), digits=9)


def write_table(path: str | Path, table: pd.DataFrame, digits: int = 6) -> None:
    """Write a table to a CSV or TSV file, with ``digits`` significant digits."""
    file = checked(path, ".csv", ".tsv")
    separator, form = "," if file.suffix.lower() == ".csv" else "\t", f"%.{digits}g"
    with whole_file(file) as temporary:
        table.to_csv(temporary, sep=separator, index=False, float_format=form)


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
    import xarray as xr  # noqa: PLC0415  # heavy

    texts = {name: printable(value) for name, value in about.items() if isinstance(value, str)}
    groups = {"/": xr.Dataset(attrs={**about, **texts})}
    for name, model in models.items():
        dataset = model.to_xarray(ensemble)
        for each, values in dataset.items():
            if np.iscomplexobj(values):
                dataset[f"{each}_real"], dataset[f"{each}_imag"] = values.real, values.imag
                dataset = dataset.drop_vars([each])
        groups[name] = dataset
    _save(path, xr.DataTree.from_dict(groups).to_netcdf(engine="h5netcdf"))


def _save(path: str | Path, content: bytes | memoryview) -> None:
    """Write a file that was made in memory, because HDF5 crashes where a disk is full."""
    with whole_file(path) as temporary:
        temporary.write_bytes(content)


def write_recording(path: str | Path, recording: Recording) -> None:
    """Write a recording to a NetCDF file; :func:`load_recording` reads it back unchanged.

    Any program reads the file: angle (rad), torque (N·m) and further channels are variables of
    their own names, if these are plain words. An InputError is raised for an ending that is not
    .nc.

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
    """Write an ensemble to a NetCDF file; :func:`load_ensemble` reads it back unchanged.

    Its signals become matrices of realization x time, context and all; otherwise as
    :func:`write_recording`.
    """
    _write(path, ensemble)


def load_ensemble(path: str | Path) -> Ensemble:
    """Load an ensemble that :func:`write_ensemble` wrote; errors as of :func:`load_recording`."""
    return _load(path, Ensemble)


def _write(path: str | Path, signals: Recording | Ensemble) -> None:
    """Write arrays as variables, and the other fields as text in JSON."""
    import xarray as xr  # noqa: PLC0415  # heavy

    file, names = checked(path, ".nc"), _variables(signals.channels)
    settings = attrs.asdict(signals, recurse=False)
    arrays = {names[own]: each for own, each in settings.pop("channels").items()}
    for name in [name for name, each in settings.items() if isinstance(each, np.ndarray)]:
        arrays[name] = settings.pop(name)
    axes = (*signals.AXES, "sample")
    variables = {
        name: (axes[: each.ndim], each, UNITS.get(name, {})) for name, each in arrays.items()
    }
    kept = {"settings": settings, "channels": names, "variables": [*arrays]}
    text = json.dumps({type(signals).__name__: kept}, default=lambda number: number.item())
    about = {"tvsysid": text, "sampling_rate": signals.sampling_rate}
    _save(file, xr.Dataset(variables, attrs=about).to_netcdf(engine="h5netcdf"))


def _load(path: str | Path, kind: type[Written]) -> Written:
    file, name = checked(path, ".nc"), kind.__name__
    with explained(str(file)):
        found = run_isolated(_contents, file.absolute())
        kept = json.loads(found.get("tvsysid", "{}")).get(name)
        if kept is None:
            raise InputError(
                f"not written by write_{name.lower()}; what others wrote is read by read_recording"
            )
        arrays = {key: found[key] for key in kept["variables"]}
        channels = {own: arrays.pop(variable) for own, variable in kept["channels"].items()}
        fields: dict[str, Any] = {**kept["settings"], **arrays}
        if kind is Recording:
            fields["trial_starts"] = tuple(fields["trial_starts"])
        return kind(**fields, channels=channels)


def _contents(file: Path) -> dict[str, Any]:
    """Return variables and attributes of a file that this package wrote."""
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
    """Return the name of each channel's variable: its own if it is a plain word, or a number.

    Examples
    --------
    >>> _variables(["emg", "sv.Ankle (rad)", "angle"])
    {'emg': 'emg', 'sv.Ankle (rad)': 'channel_2_', 'angle': 'channel_3_'}
    """
    return {
        name: name
        if name.isascii() and name.isidentifier() and name not in RESERVED
        else f"channel_{number}_"
        for number, name in enumerate(names, start=1)
    }
