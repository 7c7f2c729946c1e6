"""Methods by key, with settings checked by name."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from pydantic import TypeAdapter, ValidationError

from tvsysid.errors import InputError
from tvsysid.methods.base import Method
from tvsysid.methods.birf import BasisIRF
from tvsysid.methods.eirf import EnsembleIRF
from tvsysid.methods.esm import EnsembleSpectral
from tvsysid.methods.kbr import KernelRegression
from tvsysid.methods.sds import ShortDataSegments

METHODS: dict[str, type[Method]] = {
    method.key: method for method in (EnsembleIRF, ShortDataSegments, BasisIRF, EnsembleSpectral, KernelRegression)
}


def names() -> tuple[str, ...]:
    """Keys of all methods.

    Examples
    --------
    >>> names()
    ('eirf', 'sds', 'birf', 'esm', 'kbr')
    """
    return tuple(METHODS)


def create(key: str, **settings: Any) -> Method:
    """Method of this key.

    Parameters
    ----------
    key
        One of :func:`names`.
    **settings
        Settings by name; the paper's otherwise. ``kbr`` also takes ``preset``, ``"simulation"`` or ``"experiment"``.

    Raises
    ------
    InputError
        For an unknown key or setting, or a value that does not fit.

    Examples
    --------
    >>> create("sds", window=0.2)
    ShortDataSegments(max_lag=0.12, window=0.2)
    """
    if key not in METHODS:
        raise InputError(f"unknown method {key!r}; the methods are {', '.join(METHODS)}")
    method = METHODS[key]
    preset = settings.pop("preset", None) if method is KernelRegression else None
    _check_names(method, settings)
    return method(**settings) if preset is None else KernelRegression.preset(preset, **settings)


def parse(text: str) -> Method:
    """Method from a word as typed on the command line: ``key`` or ``key:setting=value,setting=value``.

    Parameters
    ----------
    text
        For example ``"sds"`` or ``"sds:window=0.2,max_lag=0.1"``.

    Raises
    ------
    InputError
        For an unknown key or setting, or a value that does not fit.

    Examples
    --------
    >>> parse("esm:window=0.4,stiffness=fit")
    EnsembleSpectral(window=0.4, stiffness='fit')
    """
    key, _, rest = text.partition(":")
    settings: dict[str, Any] = {}
    for part in filter(None, rest.split(",")):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals:
            raise InputError(f"method {text!r}: expected setting=value, got {part!r}")
        settings[name] = value
    if key not in METHODS:
        return create(key)
    _check_names(METHODS[key], settings)
    for name in ("basis", "band"):
        if name in settings:
            raise InputError(f"method {text!r}: {name} can be set from Python only, with tvsysid.methods.create")
    for name, value in settings.items():
        if isinstance(getattr(METHODS[key], name, None), float) or name == "period":
            try:
                settings[name] = TypeAdapter(float).validate_python(value)
            except ValidationError as error:
                raise InputError(f"method {text!r}: {name} must be a number, got {value!r}") from error
    return create(key, **settings)


def _check_names(method: type[Method], settings: dict[str, Any]) -> None:
    known = [item.name for item in fields(method)] + (["preset"] if method is KernelRegression else [])
    for name in settings:
        if name not in known:
            raise InputError(f"{method.key}: unknown setting {name!r}; its settings are {', '.join(known)}")
