"""Methods of other people: named as ``module:Class``, or installed as an entry point."""

from __future__ import annotations

import importlib
import inspect
import json
import math
from collections.abc import Callable
from dataclasses import dataclass, is_dataclass
from importlib.metadata import distributions
from types import ModuleType
from typing import Any, NamedTuple, Protocol, get_type_hints

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, PydanticUserError, TypeAdapter, ValidationError

from tvsysid.errors import InputError, describe_error, library_folders
from tvsysid.models import Diagnostics, Model
from tvsysid.signals import Ensemble

Array = NDArray[np.float64]

GROUP = "tvsysid.methods"
"""Group of entry points under which a package offers its methods."""


class Identifies(Protocol):
    """What every method is: an object with one verb."""

    def identify(self, ensemble: Ensemble) -> Any:
        """Model with ``stiffness``, shape (time,), and ``predict(ensemble)``, shape (realization, time)."""


class Installed(NamedTuple):
    """A method that an installed package offers."""

    target: str
    """As ``module:Class``."""
    package: str


def installed() -> dict[str, Installed]:
    """Methods of installed packages by name, sorted; none of them is loaded."""
    found: dict[str, Installed] = {}
    for distribution in distributions():
        try:
            points = distribution.entry_points.select(group=GROUP)
            package = str(distribution.metadata["Name"] or "a package without a name")
            for point in points:
                found.setdefault(point.name, Installed(point.value.partition("[")[0].replace(" ", ""), package))
        except Exception:  # unreadable metadata of whatever package must not stop the others
            continue
    return dict(sorted(found.items()))


def load(name: str) -> Any:
    """Class or object of this name; imports its module.

    Parameters
    ----------
    name
        As ``package.module:Class``.

    Raises
    ------
    InputError
        If there is no such module, it fails while it is imported, or it has no such name.
    """
    where, _, path = name.partition(":")
    if where.endswith(".py") or "/" in where or "\\" in where:
        stem = where.replace("\\", "/").rpartition("/")[2].removesuffix(".py")
        raise InputError(
            f"method {name!r}: expected the name of a module, got a file; go to its folder and give {stem}:{path}"
        )
    if not all(word.isidentifier() for word in (*where.split("."), *path.split("."))):
        raise InputError(f"method {name!r}: expected module:Class, as in mypackage.mymodule:MyMethod")
    importlib.invalidate_caches()  # the file may have been written a moment ago
    try:
        module = importlib.import_module(where)
    except (Exception, SystemExit) as error:
        absent = error.name if isinstance(error, ModuleNotFoundError) else None
        if absent is not None and f"{where}.".startswith(f"{absent}."):
            raise InputError(
                f"method {name!r}: there is no module {absent!r}; the current folder and the installed packages were "
                "searched. Go to the folder that holds it, or install its package"
            ) from error
        raise InputError(
            f"method {name!r}: module {where!r} fails while it is imported: {describe_error(error)}"
        ) from error
    target: Any = module
    for word in path.split("."):
        if not hasattr(target, word):
            others = _methods_of(module)
            has = f"what it has with identify: {', '.join(others)}" if others else "nothing in it has identify"
            raise InputError(f"method {name!r}: module {where!r} has no {path!r}; {has}")
        target = getattr(target, word)
    return target


def make(label: str, target: Any, settings: dict[str, Any]) -> Identifies:
    """Object with ``identify``, from a class and its settings or as it is.

    Parameters
    ----------
    label
        What the user called it, for messages.
    target
        A class, or an object that already has ``identify``.
    settings
        By name.

    Raises
    ------
    InputError
        If it has no ``identify``, a setting is unknown or missing, or the class does not take their values.
    """
    kind = type(target).__name__
    what = f"class {target.__name__}" if isinstance(target, type) else f"an object of type {kind}"
    if not callable(getattr(target, "identify", None)):
        raise InputError(
            f"method {label!r}: {what} has no identify; a method is a class with identify(self, ensemble) that returns "
            "a model with stiffness and predict(ensemble)"
        )
    if not isinstance(target, type):
        if settings:
            raise InputError(
                f"method {label!r}: it is an object that is there already, and takes no settings, got "
                f"{', '.join(settings)}; name its class {kind} instead"
            )
        return target  # type: ignore[no-any-return]
    _check_settings(label, target, settings)
    try:
        return target(**settings)  # type: ignore[no-any-return]
    except (Exception, SystemExit) as error:
        raise InputError(
            f"method {label!r}: {what} cannot be made with these settings: {describe_error(error)}"
        ) from error


def converted(label: str, target: Any, texts: dict[str, str]) -> dict[str, Any]:
    """Settings typed as text, as the class wants them.

    Each text is read as JSON where it is JSON. A dataclass then has it converted to the type of the field; the text
    itself serves where that does not fit.

    Raises
    ------
    InputError
        For an unknown setting, or a value that does not fit its field.
    """
    if not isinstance(target, type):
        return dict(texts)
    _check_known(label, target, texts)
    types = _types_of(target)
    return {
        name: _converted(label, name, text, types[name]) if name in types else _read(text)
        for name, text in texts.items()
    }


def settings_of(target: Any) -> dict[str, Any]:
    """Settings that a class takes, with their defaults; ``inspect.Parameter.empty`` for those that must be given."""
    return {item.name: item.default for item in _parameters(target) if item.kind in _BY_NAME}


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class ForeignModel(Model):
    """What a method of other people found, with NaN for what it does not say.

    Parameters
    ----------
    found
        Its own model.
    """

    found: Any

    def _predict(self, ensemble: Ensemble) -> Array:
        predicted = np.asarray(self.found.predict(ensemble), dtype=np.float64)
        if predicted.shape != (len(ensemble), ensemble.samples):
            raise InputError(
                f"{self.method}: predict(ensemble) must be of shape (realization, time), here ({len(ensemble)}, "
                f"{ensemble.samples}), it is {predicted.shape}"
            )
        return predicted

    def _given_band(self, name: str, level: float) -> tuple[Array, Array] | None:
        own = getattr(self.found, name, None)
        if not callable(own):
            return None
        edges = np.asarray(own(level), dtype=np.float64)
        if edges.shape != (2, len(self.time)):
            raise InputError(
                f"{self.method}: {name}(level) must be a lower and an upper edge of shape ({len(self.time)},) each, it "
                f"is of shape {edges.shape}"
            )
        return edges[0], edges[1]


def adopted(found: Any, label: str, ensemble: Ensemble) -> Model:
    """Model of the package from what a method found.

    Parameters
    ----------
    found
        A model of the package, which is returned as it is, or anything with ``stiffness`` and ``predict(ensemble)``.
    label
        The method and its settings, in words.
    ensemble
        That it was identified from.

    Raises
    ------
    InputError
        If it has no ``stiffness`` or ``predict``, or its stiffness is not one number for each time.
    """
    if isinstance(found, Model):
        return found
    for name in ("stiffness", "predict"):
        if not hasattr(found, name):
            raise InputError(f"{label}: identify returned an object of type {type(found).__name__} without {name}")
    count = ensemble.samples
    stiffness = np.array(found.stiffness, dtype=np.float64)
    if stiffness.shape != (count,):
        raise InputError(f"{label}: the model's stiffness must be of shape ({count},), it is {stiffness.shape}")

    def optional(name: str) -> Array:
        values = np.array(getattr(found, name, np.nan), dtype=np.float64)
        return np.array(np.broadcast_to(values, count)) if values.shape in ((), (count,)) else np.full(count, np.nan)

    return ForeignModel(
        method=label,
        sampling_rate=ensemble.sampling_rate,
        time=ensemble.time,
        stiffness=stiffness,
        viscosity=optional("viscosity"),
        inertia=optional("inertia"),
        diagnostics=Diagnostics(parameters=math.nan),
        found=found,
    )


def is_loose(module: ModuleType) -> bool:
    """Whether a module is a file of the user's, not an installed package."""
    file = getattr(module, "__file__", None)
    return bool(file) and not str(file).startswith(library_folders()) and module.__name__ != "__main__"


_BY_NAME = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
_GATHERED = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


def _methods_of(module: Any) -> list[str]:
    return [
        name
        for name, value in vars(module).items()
        if not name.startswith("_") and callable(getattr(value, "identify", None)) and not inspect.isabstract(value)
    ]


def _parameters(target: Any) -> list[inspect.Parameter]:
    try:
        return list(inspect.signature(target).parameters.values())
    except (TypeError, ValueError):  # compiled classes may not say
        return []


def _check_known(label: str, target: type, settings: dict[str, Any]) -> None:
    if any(item.kind is inspect.Parameter.VAR_KEYWORD for item in _parameters(target)):
        return
    known = settings_of(target)
    for name in settings:
        if name not in known:
            has = f"its settings are {', '.join(known)}" if known else "it has no settings"
            raise InputError(f"method {label!r}: unknown setting {name!r}; {has}")


def _check_settings(label: str, target: type, settings: dict[str, Any]) -> None:
    _check_known(label, target, settings)
    missing = [
        item.name
        for item in _parameters(target)
        if item.default is item.empty and item.kind not in _GATHERED and item.name not in settings
    ]
    if missing:
        raise InputError(
            f"method {label!r}: class {target.__name__} needs {', '.join(missing)}; give a value, as in "
            f"{label}:{','.join(f'{name}=…' for name in missing)}, or a default in the class"
        )


def _types_of(target: type) -> dict[str, Any]:
    if not is_dataclass(target):
        return {}
    try:
        return get_type_hints(target, include_extras=True)
    except Exception:  # names that are there for the type checker only
        return {}


def _read(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return text


def _converted(label: str, name: str, text: str, kind: Any) -> Any:
    validate = _validator(kind)
    if validate is None:
        return _read(text)
    try:
        return validate(_read(text))
    except ValidationError:
        pass
    try:
        return validate(text)
    except ValidationError as error:
        reason = str(error.errors()[0]["msg"])
        raise InputError(f"method {label!r}: {name} cannot be {text!r}: {reason[:1].lower()}{reason[1:]}") from error


def _validator(kind: Any) -> Callable[[Any], Any] | None:
    try:
        return TypeAdapter(kind, config=ConfigDict(arbitrary_types_allowed=True)).validate_python
    except PydanticUserError:  # a class with a configuration of its own, or no type at all
        pass
    try:
        return TypeAdapter(kind).validate_python
    except PydanticUserError:
        return None
