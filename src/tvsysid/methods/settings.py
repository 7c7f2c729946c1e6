"""Settings as text: their names, and their values by the type hints of a class."""

from __future__ import annotations

import ast
import inspect
import json
import re
from contextlib import suppress
from types import UnionType
from typing import Any, get_args, get_origin, get_type_hints

from tvsysid.errors import InputError
from tvsysid.methods.base import Method
from tvsysid.numerics.bases import Basis, basis_from_text

EXPECTED = {float: "a number", int: "a whole number", bool: "true or false"}


def split_settings(text: str) -> dict[str, str]:
    """Return the settings of ``name=value,name=value`` as texts; commas in brackets do not count.

    Examples
    --------
    >>> split_settings("band=(1, 20),order=2")
    {'band': '(1, 20)', 'order': '2'}
    """
    found = {}
    for piece in filter(None, re.split(r",(?![^(\[{]*[)\]}])", text)):
        name, equals, value = piece.partition("=")
        if not equals:
            raise InputError(f"expected setting=value, got {piece!r}")
        found[name.strip()] = value.strip()
    return found


def settings_from_text(text: str, target: Any) -> dict[str, Any]:
    """Return the values of settings that were given as text, by the type hints of a class.

    Raises
    ------
    InputError
        If the class has no such setting, or the text is no number, whole number or truth value
        where one is expected. All else is left to the class.
    """
    hints: dict[str, Any] = {}
    for source in (target.__init__, target):
        with suppress(Exception):  # names that exist for type checkers only
            hints |= get_type_hints(source)
    known = [*inspect.signature(target).parameters]
    if issubclass(target, Method) and target.can_be_tuned:  # a setting that is no field
        hints["tuned"] = bool
        known.append("tuned")
    given = split_settings(text)
    if unknown := [name for name in given if name not in known]:
        raise InputError(
            f"unknown setting {unknown[0]!r}; its settings are {', '.join(known) or 'none'}"
        )
    return {name: _converted(name, value, hints.get(name)) for name, value in given.items()}


def _converted(name: str, text: str, hint: Any) -> Any:
    """Return the value of a setting that was given as text."""
    if hint == Basis:
        return basis_from_text(text)
    value: Any = text
    for read in (json.loads, ast.literal_eval):
        with suppress(ValueError, SyntaxError, TypeError):
            value = read(text)
            break
    kinds = get_args(hint) if isinstance(hint, UnionType) else (hint,)
    if str in kinds and value is not None:
        return text
    if float in kinds and type(value) is int:
        value = float(value)
    if hint in EXPECTED and type(value) is not hint:
        raise InputError(f"{name} must be {EXPECTED[hint]}, got {text!r}")
    wants_tuple = any(get_origin(kind) is tuple for kind in kinds)
    return tuple(value) if wants_tuple and type(value) is list else value
