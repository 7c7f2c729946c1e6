"""Settings as they are typed: pieces of a text, and the value that each is."""

from __future__ import annotations

import ast
import json
from collections.abc import Iterator
from contextlib import suppress
from typing import TYPE_CHECKING, Any, get_type_hints

from tvsysid.errors import InputError
from tvsysid.methods.base import Method
from tvsysid.numerics.bases import BASES, Basis, basis_from_text

if TYPE_CHECKING:
    from pydantic import TypeAdapter

_EXPECTED = {
    "float_parsing": "a number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "bool_parsing": "true or false",
}
"""In the place of pydantic's own words."""


def parts(text: str) -> Iterator[str]:
    """Pieces between commas that stand outside of brackets."""
    depth, piece = 0, ""
    for sign in text:
        depth += (sign in "([{") - (sign in ")]}")
        if sign == "," and depth == 0:
            yield piece
            piece = ""
        else:
            piece += sign
    yield piece


def further_settings(target: type) -> dict[str, type]:
    """Settings of the package's own methods that are no fields."""
    if not issubclass(target, Method):
        return {}
    return ({"preset": str} if hasattr(target, "preset") else {}) | {"tuned": bool}


def converted(target: Any, name: str, text: str) -> Any:
    """Setting from how it is typed, or shows itself: what the text reads as, or else the text, as the field's type."""
    from pydantic import ValidationError  # noqa: PLC0415  # heavy

    own, hints = isinstance(target, type) and issubclass(target, Method), {}
    with suppress(Exception):  # names that are there for the type checker only
        hints = get_type_hints(target, include_extras=True)
    kind = (hints | (further_settings(target) if own else {})).get(name, Any)
    read, errors = _read(text, kind), []
    for value in (read, text):
        try:
            made = _adapter(kind).validate_python(value)
        except ValidationError as error:
            errors.append(error.errors()[0])
        else:
            if isinstance(made, bool) or not isinstance(value, bool):  # true is no number
                return made
    if own and errors[0]["type"] not in _EXPECTED:
        return read  # it checks its settings itself, and says more about them
    expected = _EXPECTED.get(errors[0]["type"], errors[0]["msg"].removeprefix("Input should be "))
    raise InputError(f"{name} must be {expected}, got {text!r}")


def _read(text: str, kind: object) -> Any:
    """Basis, JSON or Python literal; the text itself, if it is none of them."""
    if kind == Basis or text.partition("(")[0] in {basis.__name__ for basis in BASES}:
        return basis_from_text(text)
    for reader in (json.loads, ast.literal_eval):
        with suppress(ValueError, SyntaxError, TypeError):
            return reader(text)
    return text


def _adapter(kind: Any) -> TypeAdapter[Any]:
    from pydantic import ConfigDict, PydanticUserError, TypeAdapter  # noqa: PLC0415  # heavy

    for config in (ConfigDict(arbitrary_types_allowed=True), None):
        with suppress(
            PydanticUserError
        ):  # a class with a configuration of its own, or no type at all
            return TypeAdapter(kind, config=config)
    return TypeAdapter(Any)
