"""A channel of a file: what the file states of it, and how its values are read."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from itertools import pairwise
from types import ModuleType
from typing import Any

import attrs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tvsysid.errors import InputError, printable

# Variables and attributes, in lower case, by which files state a sampling rate in Hz.
RATE_NAMES = {"sampling_rate", "samplingrate", "sample_rate", "samplerate", "sampling_frequency"}
RATE_NAMES |= {"fs"}
NO_UNITS = ("", "defaultunits", "unknown", "none")
MAX_JITTER = 0.1  # of a time step: clocks of computers leave that, and a lost sample more
UNEVEN = "values at times that are not evenly spaced"
COPIES = 3  # of values in memory: as read, one trial after the other, and in SI units
SAVE_PART = "save the part that is needed to a file of its own"
# Words of libraries' errors where there is not enough memory.
NO_MEMORY = ("bad_alloc", "malloc of size", "memory allocation failed", "Unable to allocate")

Values = NDArray[Any] | Callable[[], NDArray[Any]]


@attrs.frozen
class Channel:
    """A variable or column of a file, with what the file states of it.

    Parameters
    ----------
    shape
        As it is read; (time,) or (time, trial) for a signal.
    dtype
        NumPy's name for numbers; a word such as ``"text"`` for what cannot be a signal.
    unit
        As the file states it, or empty.
    sampling_rate
        In Hz, as the file states it, or None.
    trial_starts
        First sample of each trial, where the file states trials that follow each other in one
        vector.
    values
        The values, or a function that reads them; None for what cannot be a signal.
    """

    shape: tuple[int, ...]
    dtype: str
    unit: str = ""
    sampling_rate: float | None = None
    trial_starts: tuple[int, ...] = ()
    values: Values | None = attrs.field(default=None, repr=False, eq=False)

    @property
    def size(self) -> int:
        """Bytes of its values as float64."""
        return 8 * math.prod(self.shape)

    @property
    def described(self) -> str:
        """Shape in words, and type, unit and rate where they matter or are stated."""
        words = " x ".join(map(str, self.shape)) or "one value"
        words += f" of {self.dtype}" if self.values is None else ""
        words += f" in {len(self.trial_starts)} trials" if self.trial_starts else ""
        words += f", {self.unit}" if self.unit else ""
        return words + (f", {self.sampling_rate:g} Hz" if self.sampling_rate is not None else "")

    def read(self, name: str) -> NDArray[Any]:
        """Return the values, as the file has them.

        Raises
        ------
        InputError
            If the channel, which the message calls ``name``, holds no numbers, cannot be read, or
            holds more than there is memory for.
        """
        if 0 in self.shape:
            raise InputError(f"{name}: expected samples, got an empty array of shape {self.shape}")
        if self.values is None:
            raise InputError(
                f"{name}: expected real numbers, got {self.dtype}; name another channel or "
                "convert it"
            )
        check_memory(name, COPIES * self.size)
        with explained(name):
            return self.values() if callable(self.values) else self.values


def numeric(
    shape: tuple[int, ...],
    dtype: np.dtype[Any],
    values: Values,
    unit: str = "",
    sampling_rate: float | None = None,
) -> Channel:
    """Return a channel that has values if its type is numeric."""
    if dtype.kind in "biufc":
        return Channel(shape, str(dtype), unit, sampling_rate, values=values)
    kinds = {"m": "dates", "M": "dates"} | dict.fromkeys("USTO", "text")
    return Channel(shape, kinds.get(dtype.kind, "records"), unit, sampling_rate)


def in_memory(values: ArrayLike, unit: str = "", sampling_rate: float | None = None) -> Channel:
    """Return a channel of values that are read already."""
    array = np.asarray(values)
    return numeric(array.shape, array.dtype, array, unit, sampling_rate)


def stated_unit(unit: object) -> str:
    """Return a unit as a file states it, without brackets around; empty if it states none.

    Examples
    --------
    >>> stated_unit(" (rad) "), stated_unit(b"N m"), stated_unit("Default Units")
    ('rad', 'N m', '')
    """
    text = printable(unit.decode("utf-8", "replace") if isinstance(unit, bytes) else str(unit))
    text = re.sub(r"^\((.*)\)$|^\[(.*)\]$", r"\1\2", text.strip()).strip()
    return "" if re.sub(r"\W", "", text.lower()) in NO_UNITS and text not in ("%", "°") else text


def stated_rate(value: object) -> float | None:
    """Return a sampling rate as a file states it, or None for what is none."""
    try:
        rate = float(np.asarray(value).item())
    except (ValueError, TypeError):
        return None
    return rate if math.isfinite(rate) and rate > 0 else None


def even_rate(times: NDArray[Any]) -> float | None:
    """Return the rate of samples at these times in s; None if their steps differ by over a tenth.

    Examples
    --------
    >>> even_rate(np.array([2.0, 2.01, 2.0199, 2.03])), even_rate(np.array([2.0, 2.01, 2.03]))
    (100.0, None)
    """
    steps = np.diff(np.asarray(times, dtype=float))
    step = float(steps.mean()) if len(steps) else 0.0
    even = math.isfinite(step) and step > 0 and np.abs(steps - step).max() <= MAX_JITTER * step
    return round(1 / step, 9) if even else None


def stated(*attributes: Mapping[str, object]) -> tuple[str, float | None]:
    """Return the unit that the first attributes state, and the first sampling rate of all."""
    units = [value for name, value in attributes[0].items() if name.lower() in ("unit", "units")]
    rates = [
        stated_rate(value)
        for item in attributes
        for name, value in item.items()
        if name.lower() in RATE_NAMES
    ]
    return stated_unit(units[-1]) if units else "", next(filter(None, rates), None)


def numbered(labels: Sequence[str], count: int) -> list[str]:
    """Return a name for each of so many signals: its label, with a number if it is not unique.

    Examples
    --------
    >>> numbered(["emg", "V", "V"], 4)
    ['emg', 'V (2)', 'V (3)', '(4)']
    """
    padded = [*labels, *[""] * count][:count]
    return [
        label if label and labels.count(label) == 1 else f"{label} ({number})".lstrip()
        for number, label in enumerate(padded, 1)
    ]


def optional_library(module: str, extra: str) -> ModuleType:
    """Import a module of a library that only those install who need it."""
    try:
        return import_module(module)
    except ImportError as error:
        library = module.partition(".")[0]
        raise InputError(f"these files need {library}: pip install 'tvsysid[{extra}]'") from error


def available_memory() -> float:
    """Return the bytes of memory that the computer has, if it tells."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError):
        return math.inf


def check_memory(name: str, size: int) -> None:
    """Raise an InputError if so many bytes are more than there is memory for."""
    if size > (available := available_memory()):
        raise InputError(
            f"{name}: reading it takes {size / 1e9:.3g} GB, and the computer has "
            f"{available / 1e9:.3g} GB of memory; {SAVE_PART}"
        )


@contextmanager
def explained(name: str) -> Iterator[None]:
    """Turn any error of a library that reads files into an InputError about a file or channel."""
    try:
        yield
    except InputError as error:
        raise error if name in str(error) else InputError(f"{name}: {error}") from None
    except (PermissionError, BlockingIOError) as error:
        raise InputError(
            f"{name}: cannot be opened ({error.strerror or error}); close it in other programs, or "
            "change its permissions"
        ) from error
    except Exception as error:  # damage brings forth errors of all kinds
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0]
        if isinstance(error, MemoryError) or any(words in reason for words in NO_MEMORY):
            raise InputError(
                f"{name}: reading it takes more memory than there is, or than what it holds "
                f"accounts for; if it is whole, {SAVE_PART}, else copy it again"
            ) from error
        raise InputError(
            f"{name}: cannot be read ({reason}); is it whole? Copy it again"
        ) from error


def outline(values: NDArray[Any], blocks: int = 2000) -> tuple[NDArray[np.int64], NDArray[Any]]:
    """Return positions and values of the lowest and highest sample of each block, for a drawing.

    Signals of shape (time,) that are shorter than two samples for each block come out whole.
    """
    if len(values) <= 2 * blocks:
        return np.arange(len(values)), values
    edges = np.linspace(0, len(values), blocks + 1).astype(np.int64)
    # NaN counts as the lowest, so that a gap is seen.
    known = np.nan_to_num(values, nan=-np.inf)
    lowest = [np.argmin(values[first:end]) for first, end in pairwise(edges)]
    highest = [np.argmax(known[first:end]) for first, end in pairwise(edges)]
    positions = np.unique([edges[:-1] + lowest, edges[:-1] + highest])
    return positions, values[positions]
