"""Checks of what systems, perturbations and profiles are made with."""

from __future__ import annotations

import math

import numpy as np

from tvsysid.errors import InputError


def is_number(value: object) -> bool:
    """Whether a value is a finite number."""
    return isinstance(value, (int, float, np.number)) and math.isfinite(value)


def finite(owner: str, **values: object) -> None:
    """Raise InputError for a setting that is not a finite number."""
    _check(owner, values, -math.inf, "a finite number")


def positive(owner: str, **values: object) -> None:
    """Raise InputError for a setting that is not a positive number."""
    _check(owner, values, math.ulp(0.0), "a positive number")


def not_negative(owner: str, **values: object) -> None:
    """Raise InputError for a setting that is not a number of zero or more."""
    _check(owner, values, 0.0, "a number of zero or more")


def _check(owner: str, values: dict[str, object], lowest: float, expected: str) -> None:
    for name, value in values.items():
        if not is_number(value) or value < lowest:  # type: ignore[operator]
            raise InputError(f"{owner}: {name} must be {expected}, got {value!r}")
