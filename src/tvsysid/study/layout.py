"""How a store is laid out: its dimensions, what is known before, and what each task measures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np


class Variable(NamedTuple):
    """What is measured in each task.

    Parameters
    ----------
    dims
        Dimensions within a task.
    meaning
        In words.
    unit
        Empty for texts.
    """

    dims: tuple[str, ...]
    meaning: str
    unit: str = ""

    @property
    def is_text(self) -> bool:
        """Whether it holds texts; else numbers, with NaN where there is none."""
        return not self.unit


class Fixed(NamedTuple):
    """What is known before any task is done: the values along a dimension, or what the study itself says."""

    name: str
    dims: tuple[str, ...]
    values: Any
    attributes: Mapping[str, str] = {}


@dataclass(frozen=True)
class Layout:
    """What the store of a study holds.

    Parameters
    ----------
    title
        What it is; tells the stores of one kind of study from those of another.
    number
        Version of the layout of this kind.
    places
        The two dimensions along which tasks lie.
    fixed
        Among them, for each dimension, its values, under its name.
    measured
        By name, in the order in which they are written.
    coordinates
        Names of the fixed that are coordinates, beside those named as a dimension.
    identity
        Attributes that tell one study from another, as mappings, and how to name the difference.
    """

    title: str
    number: int
    places: tuple[str, str]
    fixed: tuple[Fixed, ...]
    measured: Mapping[str, Variable]
    coordinates: tuple[str, ...]
    identity: Mapping[str, tuple[Mapping[str, Any], str]] = field(default_factory=dict)

    @cached_property
    def lengths(self) -> dict[str, int]:
        """Of each dimension."""
        known = {item.name: len(item.values) for item in self.fixed if item.dims == (item.name,)}
        return known | {"variable": len(self.measured)}

    def shapes(self, along: str) -> dict[str, tuple[int, ...]]:
        """Shapes of the numbers that are measured along a dimension, of one place along it."""
        return {
            name: tuple(self.lengths[dim] for dim in variable.dims[1:])
            for name, variable in self.measured.items()
            if variable.dims[:1] == (along,) and not variable.is_text
        }

    @property
    def bytes_of_numbers(self) -> int:
        """About what it takes on a disk."""
        sizes = [
            8 * int(np.prod([self.lengths[dim] for dim in variable.dims]))
            for variable in self.measured.values()
            if not variable.is_text
        ]
        tasks = self.lengths[self.places[0]] * self.lengths[self.places[1]]
        return tasks * (sum(sizes) + 8 * len(self.measured))
