"""Simulations and models to files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.io import savemat

from tvsysid.errors import InputError
from tvsysid.models import Model
from tvsysid.recordings.atomic import whole_file

if TYPE_CHECKING:
    import xarray as xr


def write_simulation(path: str | Path, columns: Mapping[str, NDArray[np.float64]], sampling_rate: float) -> None:
    """Write signals of one length to a MAT file, or to a CSV or TSV file with a header line.

    Parameters
    ----------
    path
        Ending in .mat, .csv or .tsv.
    columns
        Signals by name, each of shape (time,).
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
            matrices = {name: np.asarray(values)[:, None] for name, values in columns.items()}
            savemat(temporary, {**matrices, "sampling_rate": sampling_rate}, do_compression=True)
        else:
            separator = "," if ending == ".csv" else "\t"
            pd.DataFrame(dict(columns)).to_csv(temporary, sep=separator, index=False, float_format="%.9g")


def write_models(path: str | Path, models: Mapping[str, Model]) -> None:
    """Write models to a NetCDF file, one group for each; ``xarray.open_datatree`` reads it.

    NetCDF has no complex numbers: a frequency response becomes ``frequency_response_real`` and ``_imag``.

    Parameters
    ----------
    path
        File to write.
    models
        By name of the group.
    """
    import xarray as xr  # noqa: PLC0415  # heavy

    tree = xr.DataTree.from_dict({name: _without_complex(model.to_xarray()) for name, model in models.items()})
    with whole_file(path) as temporary:
        tree.to_netcdf(temporary, engine="h5netcdf", mode="w")


def _without_complex(dataset: xr.Dataset) -> xr.Dataset:
    for name in [str(name) for name, values in dataset.data_vars.items() if np.iscomplexobj(values)]:
        dataset[f"{name}_real"], dataset[f"{name}_imag"] = dataset[name].real, dataset[name].imag
        for part in ("real", "imag"):
            dataset[f"{name}_{part}"].attrs = dict(dataset[name].attrs)
        dataset = dataset.drop_vars(name)
    return dataset
