"""A channel of a file: what is known of it before it is read, and how it is read."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any

import attrs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tvsysid.errors import InputError, printable
from tvsysid.recordings.limits import check_fits

# Variables and attributes, in lower case, by which files state a sampling rate in Hz, and a unit.
RATE_NAMES = (
    "sampling_rate",
    "samplingrate",
    "sample_rate",
    "samplerate",
    "sampling_frequency",
    "fs",
)
UNIT_NAMES = ("units", "unit")
NUMBERS = "biufc"
NO_UNITS = ("", "defaultunits", "unknown", "none")
MOST_CHANNELS = 10_000  # of a file
# of a step in time: what clocks of computers and times of 32 bits leave; a lost sample is more
MOST_JITTER = 0.1
UNEVEN = "values at times that are not evenly spaced"
TIMES_ITS_SIZE = 3  # values as read, as columns of trials one after the other, and in SI units


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
        Reads the values; None for what cannot be a signal.
    held
        Whether the values are in memory already.
    """

    shape: tuple[int, ...]
    dtype: str
    unit: str = ""
    sampling_rate: float | None = None
    trial_starts: tuple[int, ...] = ()
    values: Callable[[], NDArray[Any]] | None = attrs.field(default=None, repr=False, eq=False)
    held: bool = attrs.field(default=False, repr=False, eq=False)

    @property
    def size(self) -> int:
        """Bytes that its values take as float64."""
        return 8 * math.prod(self.shape)

    @property
    def needed(self) -> int:
        """Bytes of memory that reading, converting and checking it takes beyond what is taken already."""
        return (TIMES_ITS_SIZE - self.held) * self.size

    @property
    def described(self) -> str:
        """Shape, and unit and rate where they are stated, in words."""
        words = " x ".join(map(str, self.shape)) or "one value"
        words += f" of {self.dtype}" if self.values is None else ""
        words += f" in {len(self.trial_starts)} trials" if self.trial_starts else ""
        words += f", {self.unit}" if self.unit else ""
        return words + (f", {self.sampling_rate:g} Hz" if self.sampling_rate is not None else "")

    def read(self, name: str) -> NDArray[Any]:
        """Values, as the file has them; ``name`` is what an InputError calls the channel.

        One is raised if it holds no numbers, or more than there is memory for.
        """
        if 0 in self.shape:
            raise InputError(f"{name}: expected samples, got an empty array of shape {self.shape}")
        if self.values is None:
            raise InputError(
                f"{name}: expected real numbers, got {self.dtype}; name another channel or "
                "convert it"
            )
        check_fits(name, self.needed)
        return self.values()


def stored(
    shape: tuple[int, ...],
    dtype: np.dtype[Any],
    read: Callable[[], NDArray[Any]],
    unit: str = "",
    sampling_rate: float | None = None,
) -> Channel:
    """Channel whose values are read when they are asked for."""
    return Channel(
        shape, _kind_of(dtype), unit, sampling_rate, values=read if dtype.kind in NUMBERS else None
    )


def in_memory(values: ArrayLike, unit: str = "", sampling_rate: float | None = None) -> Channel:
    """Channel of values that are read already."""
    array = np.asarray(values)
    return attrs.evolve(
        stored(array.shape, array.dtype, lambda: array, unit, sampling_rate), held=True
    )


def _kind_of(dtype: np.dtype[Any]) -> str:
    """Name of a type in words."""
    if dtype.kind in NUMBERS:
        return str(dtype)
    if dtype.kind in "mM":
        return "dates"
    return "text" if dtype.kind in "USTO" else "records"


def stated_unit(unit: object) -> str:
    """Unit as a file states it, without brackets around; empty if it states none.

    Examples
    --------
    >>> stated_unit(" (rad) "), stated_unit(b"N m"), stated_unit("Default Units")
    ('rad', 'N m', '')
    """
    text = printable(
        unit.decode("utf-8", "replace") if isinstance(unit, bytes) else str(unit)
    ).strip()
    text = re.sub(r"^\((.*)\)$|^\[(.*)\]$", r"\1\2", text).strip()
    return "" if re.sub(r"\W", "", text.lower()) in NO_UNITS and text not in ("%", "°") else text


def stated_rate(value: object) -> float | None:
    """Sampling rate as a file states it, or None for what is none."""
    try:
        rate = float(np.asarray(value).item())
    except (ValueError, TypeError):
        return None
    return rate if math.isfinite(rate) and rate > 0 else None


def even_rate(times: NDArray[Any]) -> float | None:
    """Rate of samples at these times in s, of shape (time,).

    None if their steps differ by more than a tenth.

    Examples
    --------
    >>> even_rate(np.array([2.0, 2.01, 2.0199, 2.03])), even_rate(np.array([2.0, 2.01, 2.03]))
    (100.0, None)
    """
    steps = np.diff(np.asarray(times, dtype=float))
    step = float(steps.mean()) if len(steps) else 0.0
    even = math.isfinite(step) and step > 0 and np.abs(steps - step).max() <= MOST_JITTER * step
    return round(1 / step, 9) if even else None


def stated(*attributes: Mapping[str, object]) -> tuple[str, float | None]:
    """Unit and sampling rate that attributes state.

    Those of the first mapping go before those of the next.
    """
    unit, rate = "", None
    for item in attributes:
        for name, value in item.items():
            if name.lower() in UNIT_NAMES and item is attributes[0]:
                unit = stated_unit(value)
            elif name.lower() in RATE_NAMES and rate is None:
                rate = stated_rate(value)
    return unit, rate


def with_rates(channels: Mapping[str, Channel]) -> dict[str, Channel]:
    """Channels with the rate that a variable such as ``sampling_rate`` beside them, or above all, states."""
    rates = {}
    for name, channel in channels.items():
        place, own = _split(name)
        if (
            own.lower() in RATE_NAMES
            and channel.values is not None
            and math.prod(channel.shape) == 1
        ):
            rates[place] = stated_rate(channel.values())
    return {
        name: channel
        if channel.sampling_rate is not None or math.prod(channel.shape) <= 1
        else attrs.evolve(channel, sampling_rate=rates.get(_split(name)[0], rates.get("")))
        for name, channel in channels.items()
    }


def _split(name: str) -> tuple[str, str]:
    """Group or structure that a channel is in, and its own name."""
    cut = max(name.rfind("/"), name.rfind(".")) + 1
    return name[:cut], name[cut:]


def outline(values: NDArray[Any], blocks: int = 2000) -> tuple[NDArray[np.int64], NDArray[Any]]:
    """Positions and values of the lowest and the highest sample of each block: what is seen of a long signal.

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
