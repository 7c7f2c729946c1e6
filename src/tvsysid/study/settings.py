"""Settings that studies of both kinds share, read from TOML files and checked."""

from __future__ import annotations

import difflib
import hashlib
import tomllib
from abc import abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self, TypeVar, get_args

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, ValidationError

from tvsysid.dataset_layout import UNITS
from tvsysid.errors import InputError, one_line
from tvsysid.methods import Method, parse

Value = TypeVar("Value")


class Settings(BaseModel):
    """Settings that belong together; unknown ones are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)


class StudySettings(Settings):
    """All settings of a study; what is wrong is explained as an InputError."""

    noun: ClassVar[str]

    def __init__(self, **settings: Any) -> None:
        try:
            super().__init__(**settings)
        except ValidationError as error:
            raise InputError(f"{self.noun}: {_explained(error, type(self))}") from error

    @property
    @abstractmethod
    def named_methods(self) -> dict[str, Method]:
        """Method objects by the name that they have in results."""

    def said(self, attribute: str, *names: str) -> tuple[str, ...]:
        """Return the names, and those that methods state in an attribute, each once."""
        methods = self.named_methods.values()
        said = [name for method in methods for name in getattr(method, attribute)]
        return tuple(dict.fromkeys([*names, *said]))

    @property
    def units(self) -> dict[str, str]:
        """Units by quantity, of the package and of methods that state them in ``quantities``."""
        said = [method.quantities for method in self.named_methods.values()]
        return {
            name: one_line(str(unit))
            for each in said
            if isinstance(each, Mapping)
            for name, unit in each.items()
        } | UNITS

    @property
    def scheduled(self) -> dict[str, int]:
        """Quantities that methods estimate over variables, and the largest number of values."""
        every = [method.scheduled_quantities for method in self.named_methods.values()]
        return {
            name: max(each.get(name, 0) for each in every)
            for name in self.said("scheduled_quantities")
        }

    @classmethod
    def from_toml(cls, path: str | Path, **settings: Any) -> Self:
        """Read a study from a TOML file whose keys are the settings.

        Files that it names are sought beside it.

        Settings that are given here take the place of the file's, in its further scenarios too.

        Raises
        ------
        InputError
            For a file that is missing or no TOML, or a wrong study; names the file and the key.
        """
        found: dict[str, Any] = (
            {"folder": Path(path).parent} if "folder" in cls.model_fields else {}
        )
        try:
            with Path(path).open("rb") as file:
                found |= tomllib.load(file)
            return cls(**overridden(found, settings))
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise InputError(f"{path}: not a TOML file: {error}") from error
        except OSError as error:
            raise InputError(f"{path}: {error.strerror}; give a TOML file") from error
        except InputError as error:
            raise InputError(f"{path}: {error}") from error


def overridden(settings: dict[str, object], others: dict[str, object]) -> dict[str, Any]:
    """Return settings with changes.

    Further scenarios follow where they are of the kind expected.
    """
    merged = settings | others
    further = settings.get("also", ())
    if (
        "also" not in others
        and isinstance(further, (list, tuple))
        and all(isinstance(item, dict) for item in further)
    ):
        kept = [
            {name: value for name, value in item.items() if name not in others} for item in further
        ]
        merged |= {"also": [item for item in kept if item]} if kept else {}
    return merged


def listed(value: Any) -> Any:
    """Return a list; one value becomes a list of one."""
    return value if isinstance(value, (list, tuple)) else (value,)


Listed = BeforeValidator(listed)


def unique(values: tuple[Value, ...]) -> tuple[Value, ...]:
    """Return the values, after a check that none is given twice."""
    if len(set(map(repr, values))) < len(values):
        raise ValueError("the same value is given twice")
    return values


def _identifies(value: Any) -> Any:
    if isinstance(value, str):
        parse(value)
    elif not isinstance(value, Method):
        raise ValueError("expected the key of a method, or a tvsysid.Method")
    return value


def _whole(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError("expected a whole number")
    return value


AnyMethod = Annotated[Any, AfterValidator(_identifies)]  # key of a method, or a method
Whole = Annotated[int, BeforeValidator(_whole)]


def in_words(value: object) -> str:
    """Return a setting as text, like "1, eirf, none" or "alignment 2"."""
    if isinstance(value, list):
        return ", ".join(map(in_words, value))
    if isinstance(value, dict):
        return ", ".join(f"{name} {in_words(each)}" for name, each in value.items())
    if value is None:
        return "none"
    return f"{value:g}" if isinstance(value, float) else str(value)


def differences(theirs: Mapping[str, object], ours: Mapping[str, object], of: str = "") -> str:
    """Describe the differences between two mappings.

    Examples
    --------
    >>> differences({"trials": 9, "methods": [{"name": "sds", "realizations": [75]}]},
    ...             {"seed": 1, "methods": [{"name": "sds", "realizations": [75, 150]}]})
    'trials: 9 there, nothing here; methods sds realizations: 75 there, 75, 150 here; seed:
    nothing there, 1 here'
    """
    found = []
    for name in dict.fromkeys([*theirs, *ours]):
        there, here = (_by_name(each.get(name, "nothing")) for each in (theirs, ours))
        if isinstance(there, Mapping) and isinstance(here, Mapping):
            found.append(differences(there, here, f"{of}{name} "))
        elif there != here:
            found.append(f"{of}{name}: {in_words(there)} there, {in_words(here)} here")
    return "; ".join(filter(None, found))


def _by_name(value: object) -> object:
    """Return a value; mappings in a list by their names, or by their numbers from 1."""
    if (
        not isinstance(value, list)
        or not value
        or not all(isinstance(each, Mapping) for each in value)
    ):
        return value
    return {
        str(each.get("name", place)): {key: kept for key, kept in each.items() if key != "name"}
        for place, each in enumerate(value, start=1)
    }


def spawn_key(text: str) -> list[int]:
    """Return the spawn key of independent random numbers."""
    digest = hashlib.sha256(text.encode()).digest()
    return [int.from_bytes(digest[i : i + 4], "little") for i in range(0, 16, 4)]


def _explained(error: ValidationError, kind: type[BaseModel]) -> str:
    """Describe the first fault: the key, the value and the expected value."""
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        known = [
            name for name in _model_at(kind, first["loc"][:-1]).model_fields if name != "folder"
        ]
        close = difflib.get_close_matches(str(first["loc"][-1]), known, n=1, cutoff=0.5)
        return (
            f"{where}: unknown key{f'; did you mean {close[0]}?' if close else ''} (known: "
            f"{', '.join(known)})"
        )
    if first["type"] == "missing":
        return f"{where}: this is missing; give it"
    message = str(first["msg"]).removeprefix("Value error, ")
    field = kind.model_fields.get(str(first["loc"][0])) if first["loc"] else None
    described = field.description if field and first["type"] != "value_error" else None
    expected = f" (expected {described})" if described else ""
    return f"{where}: {message}; got {first['input']!r}{expected}" if where else message


def _model_at(kind: type[BaseModel], place: tuple[int | str, ...]) -> type[BaseModel]:
    """Return the settings at a place within others."""
    for part in place:
        if part in kind.model_fields:
            kind = _model_within(kind.model_fields[str(part)].annotation) or kind
    return kind


def _model_within(annotation: object) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(filter(None, map(_model_within, get_args(annotation))), None)
