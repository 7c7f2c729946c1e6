"""Settings that studies of both kinds share: tables, TOML files, labels and random seeds."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Self, TypeVar

import attrs
import numpy as np

from tvsysid.errors import InputError
from tvsysid.methods import Method, label_of, parse
from tvsysid.recordings import Reading

Item = TypeVar("Item")


@attrs.frozen(slots=False, kw_only=True)
class StudySettings:
    """Settings of a study that a TOML file can hold."""

    @classmethod
    def from_toml(cls, path: str | Path, **settings: Any) -> Self:
        """Read a study from a TOML file whose keys are the settings.

        ``settings`` replace those of the file, and those of its table ``also``. Files that the
        study names are relative to the TOML file.

        Raises
        ------
        InputError
            For a file that is no TOML, or a wrong study. It names the file and the key.
        """
        try:
            table = tomllib.loads(Path(path).read_text(encoding="utf-8"))
            if "folder" in attrs.fields_dict(cls):
                table = {"folder": str(Path(path).resolve().parent)} | table
            return from_table(cls, table).replaced(**settings)
        except ValueError as error:
            raise InputError(f"{path}: {error}") from error

    def replaced(self, **settings: Any) -> Self:
        """Return the study with other values of some settings."""
        return attrs.evolve(self, **settings)

    def to_json(self) -> str:
        """Return settings as JSON, without empty ones; methods and parts by their labels."""
        settings = attrs.asdict(
            self, recurse=False, filter=lambda _, value: value not in ((), None, {})
        )
        return json.dumps(
            settings,
            default=lambda value: (
                attrs.asdict(value) if isinstance(value, Reading) else label_of(value)
            ),
        )


def from_table(kind: type[Item], table: Any, where: str = "") -> Item:
    """Return an object of an attrs class from a table of its settings.

    ``where`` is the name of the table in messages. An InputError is raised for a value that is no
    table, and for an unknown key.
    """
    check_keys(table, attrs.fields_dict(kind), where)  # type: ignore[arg-type]
    return kind(**table)


def check_keys(table: Any, names: Iterable[str], where: str = "") -> None:
    """Raise an InputError for a value that is no table, or a key that is none of the names."""
    if not isinstance(table, Mapping):
        raise InputError(f"{where} must be a table of settings, got {table!r}")
    for name in table.keys() - set(names):
        path = f"{where}.{name}" if where else name
        raise InputError(f"{path}: unknown key (known: {', '.join(names)})")


def to_tuple(value: Any) -> Any:
    """Return a tuple; one value becomes a tuple of one, None stays None."""
    if value is None:
        return None
    return tuple(value) if isinstance(value, (list, tuple)) else (value,)


def to_method(value: Any) -> Method:
    """Return the method of a text, or a method as it is."""
    method = parse(value) if isinstance(value, str) else value
    if not isinstance(method, Method):
        raise InputError(
            f"methods: expected the key of a method, or a tvsysid.Method; got {value!r}"
        )
    return method


def spawn_key(text: str) -> list[int]:
    """Turn a text into a spawn key for a random seed."""
    digest = hashlib.sha256(text.encode()).digest()
    return list(map(int, np.frombuffer(digest[:16], "<u4")))
