"""What a value must be: arrays of finite numbers, rates, mappings that nobody changes."""

from __future__ import annotations

import math
from collections.abc import Mapping

import attrs
import numpy as np
from numpy.typing import ArrayLike

from tvsysid.errors import InputError
from tvsysid.numerics import Array


def checked_array(name: str, values: ArrayLike, axes: tuple[str, ...]) -> Array:
    """Read-only float64 view of numbers that are all finite and have the axes expected, or an error that says why not.

    C-ordered; shares memory only with an array that is read-only itself.
    """
    try:
        array = np.asarray(values)
    except ValueError as error:  # ragged nested lists
        raise InputError(
            f"{name}: expected an array of numbers, got rows of different length"
        ) from error
    if array.size == 0:
        raise InputError(f"{name}: expected samples, got an empty array of shape {array.shape}")
    if array.dtype.kind not in "iuf":
        raise InputError(
            f"{name}: expected real numbers, got values of type {array.dtype}; convert them first"
        )
    expected = (
        f"{len(axes)} axis ({axes[0]})"
        if len(axes) == 1
        else f"{len(axes)} axes ({', '.join(axes)})"
    )
    if array.ndim != len(axes):
        raise InputError(
            f"{name}: expected {expected}, got an array of shape {array.shape}; reshape or index it"
        )
    given, array = array, np.ascontiguousarray(array, dtype=np.float64)
    # What the caller can still write to is copied; what nobody can is shared.
    array = (
        array.copy()
        if array.flags.writeable and np.may_share_memory(array, given)
        else array.view()
    )
    finite = np.isfinite(array)
    if not finite.all():
        first = np.argwhere(~finite)[0]
        where = ", ".join(f"{axis} {index}" for axis, index in zip(axes, first, strict=True))
        raise InputError(
            f"{name}: {int(np.count_nonzero(~finite))} of {array.size} values are NaN or "
            "infinite, the first at "
            f"{where}; cut them out or interpolate them before"
        )
    array.flags.writeable = False
    return array


def checked_rate(sampling_rate: float) -> float:
    """Return the sampling rate as a float, if it is a positive finite number of hertz."""
    if isinstance(sampling_rate, bool):
        raise InputError(f"sampling_rate: expected a number of hertz, got {sampling_rate!r}")
    try:
        rate = float(sampling_rate)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"sampling_rate: expected a number of hertz, got {sampling_rate!r}"
        ) from error
    if not (math.isfinite(rate) and rate > 0):
        raise InputError(
            f"sampling_rate: expected a positive number of hertz, got {sampling_rate!r}"
        )
    return rate


class Frozen:
    """Class that keeps copies of its mappings."""

    def __attrs_post_init__(self) -> None:
        for item in attrs.fields(type(self)):  # type: ignore[arg-type]
            if isinstance(value := getattr(self, item.name), Mapping):
                object.__setattr__(self, item.name, dict(value))
