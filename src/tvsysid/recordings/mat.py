"""MAT files of version 5 and 7."""

from __future__ import annotations

import warnings
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat
from scipy.io.matlab import MatlabOpaque, MatReadError, MatReadWarning

from tvsysid.errors import InputError

HDF5_SIGNATURE = b"\x89HDF"
VERSION_73 = b"MATLAB 7.3"


def read_mat(file: Path) -> dict[str, NDArray[Any]]:
    """Variables of a MAT file by name, matrices as time x trial."""
    with file.open("rb") as stream:
        head = stream.read(128)
    if head.startswith((HDF5_SIGNATURE, VERSION_73)):
        raise InputError(f"{file}: MAT version 7.3 is not read yet; save it in MATLAB with save(..., '-v7')")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MatReadWarning)  # of objects, which are left out below
            variables = loadmat(file, mat_dtype=True)
    except (MatReadError, ValueError, TypeError, KeyError, IndexError, EOFError, NotImplementedError, OSError) as error:
        raise InputError(f"{file}: not a MAT file that can be read ({error})") from error
    except (zlib.error, MemoryError) as error:
        raise InputError(f"{file}: the MAT file is damaged ({error}); copy it again") from error
    channels = {name: values for name, values in variables.items() if not name.startswith("__")}
    objects = [name for name, values in channels.items() if isinstance(values, MatlabOpaque)]
    if objects and len(objects) == len(channels):
        raise InputError(f"{file}: it holds only MATLAB objects, which are not read yet; save their data as matrices")
    return {name: np.asarray(values) for name, values in channels.items() if name not in objects}
