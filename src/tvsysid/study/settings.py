"""Settings that studies of both kinds share: conversion, checks and TOML files."""

from __future__ import annotations

import difflib
import hashlib
import tomllib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Self, TypeVar

import attrs

from tvsysid.errors import InputError
from tvsysid.methods import Method, label_of, parse

Item = TypeVar("Item")


@attrs.frozen(slots=False, kw_only=True)
class Settings:
    """Settings of a study that a TOML file can hold."""

    @classmethod
    def from_toml(cls, path: str | Path, **settings: Any) -> Self:
        """Read a study from a TOML file whose keys are the settings.

        Settings that are given here replace those of the file, in its further scenarios too. Files
        that the study names are sought beside the TOML file.

        Raises
        ------
        InputError
            For a file that is missing or no TOML, or a wrong study. It names the file and the key.
        """
        known = [field.name for field in attrs.fields(cls)]
        beside = {"folder": Path(path).parent} if "folder" in known else {}
        try:
            with Path(path).open("rb") as file:
                table = tomllib.load(file)
            return from_table(cls, beside | replace_settings(table, settings))
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise InputError(f"{path}: not a TOML file: {error}") from error
        except OSError as error:
            raise InputError(f"{path}: {error.strerror}; give a TOML file") from error
        except InputError as error:
            raise InputError(f"{path}: {error}") from error


def from_table(kind: type[Item], table: Any, where: str = "") -> Item:
    """Return an object of an attrs class from a table of its settings.

    Parameters
    ----------
    where
        Name of the table in a message.

    Raises
    ------
    InputError
        For a value that is no table, or an unknown key.
    """
    check_keys(table, [field.name for field in attrs.fields(kind)], where)  # type: ignore[arg-type]
    return kind(**table)


def check_keys(table: Any, names: Iterable[str], where: str) -> None:
    """Raise for a value that is no table, or a key that is none of the names."""
    if not isinstance(table, Mapping):
        raise InputError(f"{where} must be a table of settings, got {table!r}")
    known = [name for name in names if name != "folder"]
    for name in table.keys() - {*known, "folder"}:
        close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
        hint = f"; did you mean {close[0]}?" if close else ""
        path = f"{where}.{name}" if where else name
        raise InputError(f"{path}: unknown key{hint} (known: {', '.join(known)})")


def table_converter(kind: type[Item], name: str) -> Callable[[Any], Any]:
    """Return a converter of a table to an attrs class; other values stay as they are."""
    return lambda value: from_table(kind, value, name) if isinstance(value, Mapping) else value


def replace_settings(
    settings: Mapping[str, object], others: Mapping[str, object]
) -> dict[str, Any]:
    """Return settings with some replaced, in further scenarios (``also``) too."""
    merged = dict(settings) | dict(others)
    further = settings.get("also", ())
    if "also" not in others and isinstance(further, (list, tuple)):
        kept = [
            {name: value for name, value in item.items() if name not in others}
            if isinstance(item, Mapping)
            else item
            for item in further
        ]
        merged |= {"also": [item for item in kept if item]} if kept else {}
    return merged


def to_tuple(value: Any) -> Any:
    """Return a tuple; one value becomes a tuple of one, None stays None."""
    if value is None:
        return None
    return tuple(value) if isinstance(value, (list, tuple)) else (value,)


def check_distinct(settings: object, field: attrs.Attribute[Any], values: Iterable[object]) -> None:
    """Raise for values that are empty, or of which one is given twice."""
    values = list(values)
    if not values:
        raise InputError(f"{field.name}: it is empty; give at least 1 value")
    if twice := first_repeated(list(map(repr, values))):
        raise InputError(f"{field.name}: {twice} is given twice; give it once")


def first_repeated(labels: list[str]) -> str:
    """Return the first label that occurs twice, or nothing."""
    return next((label for number, label in enumerate(labels) if label in labels[:number]), "")


def to_method(value: Any) -> Method:
    """Return the method of a text, or a method as it is."""
    if isinstance(value, str):
        return parse(value)
    if not isinstance(value, Method):
        raise InputError(
            f"methods: expected the key of a method, or a tvsysid.Method; got {value!r}"
        )
    return value


def labels_of(values: Iterable[object]) -> list[str | float]:
    """Return values of a setting as text or numbers."""
    return [value if isinstance(value, float) else label_of(value) for value in values]


def in_words(value: object) -> str:
    """Return a setting as text, like "1, eirf, none" or "alignment 2"."""
    if isinstance(value, list):
        return ", ".join(map(in_words, value))
    if isinstance(value, dict):
        return ", ".join(f"{name} {in_words(item)}" for name, item in value.items())
    if value is None:
        return "none"
    return f"{value:g}" if isinstance(value, float) else str(value)


def spawn_key(text: str) -> list[int]:
    """Return the spawn key of independent random numbers."""
    digest = hashlib.sha256(text.encode()).digest()
    return [int.from_bytes(digest[i : i + 4], "little") for i in range(0, 16, 4)]
