"""Methods by key, with settings checked by name."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from dataclasses import fields
from typing import Any, NamedTuple

from pydantic import TypeAdapter, ValidationError

from tvsysid.errors import InputError
from tvsysid.methods import foreign
from tvsysid.methods.base import Method
from tvsysid.methods.birf import BasisIRF
from tvsysid.methods.eirf import EnsembleIRF
from tvsysid.methods.esm import EnsembleSpectral
from tvsysid.methods.foreign import Identifies
from tvsysid.methods.kbr.kbr import KernelRegression
from tvsysid.methods.sds import ShortDataSegments
from tvsysid.methods.tuning.tuning import Tuned
from tvsysid.numerics.bases import basis_from_text

METHODS: dict[str, type[Method]] = {
    method.key: method for method in (EnsembleIRF, ShortDataSegments, BasisIRF, EnsembleSpectral, KernelRegression)
}


class Description(NamedTuple):
    """What there is to say about a method."""

    title: str
    assumptions: tuple[str, ...]
    settings: tuple[str, ...]
    """As ``name = default``."""


def names() -> tuple[str, ...]:
    """Keys of all methods: the package's own, then those that installed packages offer.

    Nothing is loaded. A package that offers a method under one of the package's own keys is not heard; see
    :func:`clashes`.

    Examples
    --------
    >>> names()[:5]
    ('eirf', 'sds', 'birf', 'esm', 'kbr')
    """
    return (*METHODS, *(name for name in foreign.installed() if name not in METHODS))


def clashes() -> tuple[str, ...]:
    """What installed packages offer under one of the package's own keys, in a sentence each."""
    return tuple(
        f"{name!r} is offered by the installed package {item.package} too; the package's own is used. Name the other "
        f"{item.target}"
        for name, item in foreign.installed().items()
        if name in METHODS
    )


def create(key: str, **settings: Any) -> Identifies:
    """Method of this key.

    Parameters
    ----------
    key
        One of :func:`names`, or ``module:Class``.
    **settings
        Settings by name; the paper's otherwise. ``kbr`` also takes ``preset``, ``"simulation"`` or ``"experiment"``.
        With ``tuned=True`` the method chooses its settings from the data, beginning with these: see :class:`Tuned`.

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
        return foreign.make(key, _foreign(key), settings)
    method = METHODS[key]
    tuned = settings.pop("tuned", False)
    if not isinstance(tuned, bool):
        raise InputError(f"{key}: tuned must be true or false, got {tuned!r}")
    preset = settings.pop("preset", None) if method is KernelRegression else None
    _check_names(method, settings)
    made = method(**settings) if preset is None else KernelRegression.preset(preset, **settings)
    return Tuned(made) if tuned else made


def parse(text: str) -> Identifies:
    """Method from a word as typed on the command line: ``key`` or ``key:setting=value,setting=value``.

    Parameters
    ----------
    text
        For example ``"sds"``, ``"sds:window=0.2,max_lag=0.1"``, ``"kbr:tuned=true"``, or a method of one's own,
        ``"mypackage.mymodule:MyMethod"`` or ``"mypackage.mymodule:MyMethod:order=3"``. The package's own keys come
        first, then modules, then the names that installed packages offer.

    Raises
    ------
    InputError
        For an unknown key or setting, a value that does not fit, or a module that cannot be used.

    Examples
    --------
    >>> parse("esm:window=0.4,stiffness=fit")
    EnsembleSpectral(window=0.4, stiffness='fit')
    >>> parse("birf:basis=HaarWavelets(functions=8)").basis
    HaarWavelets(functions=8)
    >>> parse("kbr:gamma=(4.5, 0.1, 1e-4)").gamma
    (4.5, 0.1, 0.0001)
    >>> parse("birf:tuned=true").title
    'Basis impulse response function, tuned'
    >>> parse("tvsysid.methods:ShortDataSegments:window=0.2")
    ShortDataSegments(max_lag=0.12, window=0.2)
    """
    key, rest = _split(text)
    settings: dict[str, Any] = {}
    for part in filter(None, _parts(rest)):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals:
            raise InputError(f"method {text!r}: expected setting=value, got {part!r}")
        settings[name] = value
    if key not in METHODS:
        target = _foreign(key)
        return foreign.make(key, target, foreign.converted(key, target, settings))
    _check_names(METHODS[key], settings)
    for name, value in settings.items():
        try:
            settings[name] = _from_text(METHODS[key], name, value)
        except InputError as error:
            raise InputError(f"method {text!r}: {error}") from error
    if "tuned" in settings:
        try:
            settings["tuned"] = TypeAdapter(bool).validate_python(settings["tuned"])
        except ValidationError as error:
            raise InputError(f"method {text!r}: tuned must be true or false, got {settings['tuned']!r}") from error
    return create(key, **settings)


def typed(method: Method) -> str:
    """Word that :func:`parse` makes one of the package's own methods of: its key, and what differs from its defaults.

    Examples
    --------
    >>> typed(ShortDataSegments(window=0.2))
    'sds:window=0.2'
    >>> typed(KernelRegression())
    'kbr'
    """
    usual = type(method)()
    changed = {item.name: getattr(method, item.name) for item in fields(method)}
    words = [
        f"{name}={value if isinstance(value, str) else repr(value)}".replace(" ", "")
        for name, value in changed.items()
        if value != getattr(usual, name)
    ]
    return ":".join(filter(None, (method.key, ",".join(words))))


def _from_text(method: type[Method], name: str, text: str) -> Any:
    """Value of a setting of one of the package's own methods from how it is typed, or shows itself."""
    if name == "basis":
        return basis_from_text(text)
    default = getattr(method, name, None)
    several = text[:1] + text[-1:] in ("()", "[]")
    number = float if several or name in ("period", "band", "gamma") else type(default)
    if number not in (int, float):
        return text
    try:
        if several:
            return TypeAdapter(tuple[float, ...]).validate_python(tuple(text[1:-1].split(",")))
        return TypeAdapter(number).validate_python(text)
    except ValidationError as error:
        kind = "a whole number" if number is int else "a number"
        raise InputError(f"{name} must be {kind}, got {text!r}") from error


def key_of(text: str) -> str:
    """Key of a method as typed on the command line, without its settings.

    Examples
    --------
    >>> key_of("sds:window=0.2"), key_of("mymodule:MyMethod:order=3")
    ('sds', 'mymodule:MyMethod')
    """
    return _split(text)[0]


def describe(key: str) -> Description:
    """Title, assumptions and settings of a method, as far as it tells them.

    Parameters
    ----------
    key
        One of :func:`names`, or ``module:Class``.

    Raises
    ------
    InputError
        If the method cannot be loaded.
    """
    target = METHODS[key] if key in METHODS else _foreign(key)
    kind = target if isinstance(target, type) else type(target)
    assumptions = getattr(target, "assumptions", ())
    try:
        told = (assumptions,) if isinstance(assumptions, str) else tuple(str(text) for text in assumptions)
    except TypeError:
        told = (str(assumptions),)
    return Description(str(getattr(target, "title", kind.__name__)), told, tuple(_defaults(key, target)))


def _defaults(key: str, target: Any) -> Iterator[str]:
    if not isinstance(target, type):
        return
    settings = foreign.settings_of(target)
    try:
        made: Any = create(key)
    except InputError:  # it needs settings that have no default
        made = None
    for name, default in settings.items():
        needed = default is inspect.Parameter.empty
        yield f"{name} (must be given)" if needed else f"{name} = {getattr(made, name, default)!r}"


def _split(text: str) -> tuple[str, str]:
    """Key and settings of a method: what stands behind a colon is a class if it has no equals sign."""
    head, _, rest = text.partition(":")
    first, _, after = rest.partition(":")
    if head not in METHODS and first and "=" not in first:
        return f"{head}:{first}", after
    return head, rest


def _parts(text: str) -> Iterator[str]:
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


def _foreign(key: str) -> Any:
    if ":" in key:
        return foreign.load(key)
    found = foreign.installed().get(key)
    if found is None:
        raise InputError(
            f"unknown method {key!r}; the methods are {', '.join(names())}; a method of your own is named module:Class"
        )
    try:
        return foreign.load(found.target)
    except InputError as error:
        raise InputError(
            f"method {key!r} of the installed package {found.package} cannot be loaded: {error}"
        ) from error


def _check_names(method: type[Method], settings: dict[str, Any]) -> None:
    known = [item.name for item in fields(method)] + (["preset"] if method is KernelRegression else []) + ["tuned"]
    for name in settings:
        if name not in known:
            raise InputError(f"{method.key}: unknown setting {name!r}; its settings are {', '.join(known)}")
