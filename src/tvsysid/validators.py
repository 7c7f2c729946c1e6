"""Validators for fields of attrs classes and for arguments of functions; they raise InputError."""

from __future__ import annotations

import inspect
import math
import numbers
from collections.abc import Callable
from typing import Any, TypeVar, get_args

import attrs

from tvsysid.errors import InputError

Item = TypeVar("Item")


@attrs.frozen
class Validator:
    """Rule for a value, as a validator of an attrs field: ``attrs.field(validator=positive)``.

    Parameters
    ----------
    expected
        Description of valid values, which completes "must be …".
    is_valid
        Function that tells whether a value is valid. It may be given any object.

    Examples
    --------
    >>> positive.check("segment", "period", -2.0)
    Traceback (most recent call last):
    tvsysid.errors.InputError: segment: period must be a positive number, got -2.0
    """

    expected: str
    is_valid: Callable[[Any], bool]

    def __call__(self, item: object, attribute: attrs.Attribute[Any], value: object) -> None:
        """Check a field of an attrs class."""
        self.check(type(item).__name__, attribute.name, value)

    def check(self, owner: str, name: str, value: object) -> None:
        """Check an argument of a function, or an item of a field.

        Raises
        ------
        InputError
            If the value is not valid.
        """
        if not self.is_valid(value):
            raise InputError(f"{owner}: {name} must be {self.expected}, got {value!r}")


def is_whole(value: object) -> bool:
    """Return whether a value is a whole number. True and False are not."""
    return isinstance(value, numbers.Integral) and not isinstance(value, bool)


def is_number(value: Any) -> bool:
    """Return whether a value is a finite real number. True and False are not."""
    is_real = isinstance(value, numbers.Real) and not isinstance(value, bool)
    return is_real and math.isfinite(value)


def between(low: float, high: float) -> Validator:
    """Return a validator for numbers from ``low`` to ``high``."""
    return Validator(
        f"a number from {low:g} to {high:g}",
        lambda value: is_number(value) and low <= value <= high,
    )


def at_least(least: int) -> Validator:
    """Return a validator for whole numbers of ``least`` or more."""
    return Validator(
        f"a whole number of {least} or more", lambda value: is_whole(value) and value >= least
    )


def one_of(literal: object) -> Validator:
    """Return a validator for the values of a ``typing.Literal``."""
    choices = get_args(literal)
    return Validator(f"one of {', '.join(map(repr, choices))}", lambda value: value in choices)


def optional(validator: Validator) -> Validator:
    """Return a validator that accepts None in addition to the values of ``validator``."""
    return Validator(
        f"{validator.expected}, or None", lambda value: value is None or validator.is_valid(value)
    )


finite = Validator("a finite number", is_number)
positive = Validator("a positive number", lambda value: is_number(value) and value > 0)
frequency = Validator("a positive number of hertz", positive.is_valid)
not_negative = Validator("a number of zero or more", lambda value: is_number(value) and value >= 0)
boolean = Validator("True or False", lambda value: isinstance(value, bool))
text = Validator("a text", lambda value: isinstance(value, str))


def to_float(value: Any) -> float:
    """Convert a number to float. Return other values unchanged, for the validator to reject."""
    return float(value) if is_number(value) else value


def settings_of(item: object) -> dict[str, Any]:
    """Return an object's settings by name: constructor arguments that are also attributes."""
    names = inspect.signature(type(item)).parameters
    return {name: getattr(item, name) for name in names if hasattr(item, name)}


def with_settings(item: Item, **changes: object) -> Item:
    """Return an object of the same class with some settings changed."""
    return type(item)(**settings_of(item) | changes)
