"""Describe a channel of a file: its unit and rate as the file states them, and its values."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import attrs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tvsysid.errors import InputError, printable

# Names, in lower case, of variables and attributes by which files state a sampling rate in Hz.
RATE_NAMES = {
    "sampling_rate", "samplingrate", "sample_rate", "samplerate", "sampling_frequency", "fs"
}  # fmt: skip
NO_UNITS = ("default units", "unknown", "none", "n/a")
MAX_JITTER = 0.1  # of a time step: computer clocks stay below it, a lost sample does not

Values = Any  # an array, an object with shape and dtype that becomes one, or a function


def stated_unit(unit: object) -> str:
    """Return a unit as a file states it, without brackets around; empty if it states none.

    Examples
    --------
    >>> stated_unit(" (rad) "), stated_unit(b"N m"), stated_unit("Default Units")
    ('rad', 'N m', '')
    """
    text = printable(_text(unit)).strip(" ()[]")
    return "" if text.lower() in NO_UNITS else text


def _text(value: object) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def stated_rate(value: object) -> float | None:
    """Return a sampling rate as a file states it; None if it is no positive number."""
    try:
        rate = float(np.asarray(value).item())
    except (ValueError, TypeError):
        return None
    return rate if 0 < rate < math.inf else None


@attrs.frozen
class Channel:
    """Variable or column of a file, with the unit and the rate that the file states.

    Parameters
    ----------
    shape
        Shape of the values; (time,) or (time, trial) for a signal.
    dtype
        NumPy's name for numbers; a word such as ``"text"`` for values that cannot be a signal.
    unit
        As the file states it, or empty.
    sampling_rate
        In Hz, as the file states it, or None.
    trial_starts
        First sample of each trial, where the file states trials that follow each other in one
        vector.
    values
        Values, or a function that reads them. None if they cannot be a signal.
    """

    shape: tuple[int, ...]
    dtype: str
    unit: str = attrs.field(default="", converter=stated_unit)
    sampling_rate: float | None = attrs.field(default=None, converter=stated_rate)
    trial_starts: tuple[int, ...] = ()
    values: Values = attrs.field(default=None, repr=False, eq=False)

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
            If the channel, which the message calls ``name``, holds no numbers or cannot be read.
        """
        if 0 in self.shape:
            raise InputError(f"{name}: expected samples, got an empty array of shape {self.shape}")
        if self.values is None:
            raise InputError(
                f"{name}: expected real numbers, got {self.dtype}; name another channel or convert "
                "it"
            )
        with explained(name):
            values = self.values() if callable(self.values) else self.values
            return np.asarray(values).reshape(self.shape)


def channel_of(
    values: Values,
    unit: object = "",
    sampling_rate: object = None,
    shape: tuple[int, ...] = (),
    dtype: Any = None,
) -> Channel:
    """Return a channel, with values if they are numbers.

    Where the values are a function that reads them, give their shape and type.
    """
    if dtype is None:
        shape, dtype = values.shape or (), values.dtype
    if dtype.kind in "biufc":
        return Channel(shape, str(dtype), unit, sampling_rate, values=values)
    return Channel(shape, "text, cells or records", unit, sampling_rate)


def stated(*attributes: Mapping[Any, object]) -> tuple[object, object]:
    """Return the unit in the first mapping, and the first sampling rate in any of them."""
    plain = [{_text(name).lower(): each[name] for name in each} for each in attributes]
    rates = [each[name] for each in plain for name in each if name in RATE_NAMES]
    return plain[0].get("units", plain[0].get("unit", "")), next(iter(rates), None)


def timed(channel: Channel, times: ArrayLike) -> Channel:
    """Return a channel with the rate of its times in s.

    It cannot be a signal if its time steps differ by over a tenth.

    Examples
    --------
    >>> emg = channel_of(np.arange(4.0))
    >>> timed(emg, [2.0, 2.01, 2.0199, 2.03]).sampling_rate
    100.0
    >>> timed(emg, [2.0, 2.01, 2.02, 2.04]).dtype
    'values without evenly spaced times'
    """
    steps = np.diff(np.asarray(times, dtype=float))
    step = float(steps.mean()) if len(steps) else 0.0
    if 0 < step < math.inf and np.abs(steps - step).max() <= MAX_JITTER * step:
        return attrs.evolve(channel, sampling_rate=round(1 / step, 9))
    return attrs.evolve(channel, values=None, dtype="values without evenly spaced times")


def numbered(labels: Sequence[str]) -> list[str]:
    """Return a name for each label: itself, with a number if it is empty or not unique.

    Examples
    --------
    >>> numbered(["emg", "V", "V", ""])
    ['emg', 'V (2)', 'V (3)', '(4)']
    """
    return [
        label if label and labels.count(label) == 1 else f"{label} ({number})".lstrip()
        for number, label in enumerate(labels, start=1)
    ]


def padded(texts: Sequence[str], count: int) -> list[str]:
    """Return ``count`` texts: cut the list, or fill it up with empty texts."""
    return [*texts, *[""] * count][:count]


@contextmanager
def explained(name: str) -> Iterator[None]:
    """Turn any error of a library that reads files into an InputError about a file or channel."""
    try:
        yield
    except InputError as error:
        text = str(error)
        raise InputError(text if name in text else f"{name}: {text}") from None
    except Exception as error:  # damaged files raise errors of all kinds
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0]
        remedy = "Is it whole and closed in other programs, and is its ending right?"
        if isinstance(error, ModuleNotFoundError):
            remedy = f"Install the library: pip install {error.name}"
        elif isinstance(error, MemoryError) or "bad_alloc" in reason:
            reason = "it asks for too much memory"
            remedy = "A small file is damaged: copy it again. Save a part of a large one"
        raise InputError(f"{name}: cannot be read ({reason}). {remedy}") from error
