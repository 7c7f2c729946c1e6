"""Read-only arrays: converters and checks for the fields of signals and models."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tvsysid.errors import InputError
from tvsysid.numerics import Array


def read_only(values: ArrayLike) -> NDArray[Any]:
    """Return values as a read-only array, copied if the caller can still change them."""
    array = np.asarray(values)
    array = array.copy(order="K") if array.flags.writeable else array.view()
    array.flags.writeable = False
    return array


def to_array(values: ArrayLike) -> Array:
    """Convert real numbers to a read-only, C-ordered array. A validator checks other values."""
    if isinstance(values, np.ma.MaskedArray):
        values = np.ma.filled(values.astype(np.float64), np.nan)
    try:
        array = np.asarray(values)
    except ValueError:  # rows of different length
        array = np.asarray(values, dtype=object)
    return read_only(
        np.asarray(array, np.float64, order="C") if array.dtype.kind in "iuf" else array
    )


def to_arrays(values: Mapping[str, ArrayLike]) -> dict[str, Array]:
    """Convert each item of a mapping by :func:`to_array`."""
    return {name: to_array(each) for name, each in values.items()}


def check_finite(name: str, array: NDArray[Any], axes: tuple[str, ...]) -> None:
    """Check that an array holds finite real numbers over the ``axes``.

    Raises
    ------
    InputError
        For other values or axes.
    """
    if array.dtype.kind not in "if":
        raise InputError(f"{name}: expected real numbers, got values of type {array.dtype}")
    if array.ndim != len(axes) or not array.size:
        raise InputError(
            f"{name}: expected samples over {' and '.join(axes)}, got an array of shape "
            f"{array.shape}"
        )
    if not (is_finite := np.isfinite(array)).all():
        places = np.argwhere(~is_finite)
        first = ", ".join(map("{} {}".format, axes, places[0]))
        raise InputError(
            f"{name}: {len(places)} of {array.size} values are NaN or infinite, the first at "
            f"{first}; cut them out or interpolate them before"
        )
