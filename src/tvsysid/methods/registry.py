"""Find methods by name: the package's own, those of installed packages, and ``module:Class``.

User-defined systems, profiles, perturbations and scenarios are found in the same way.
"""

from __future__ import annotations

import importlib
from collections.abc import Container, Iterable, Mapping
from importlib.metadata import entry_points
from operator import attrgetter
from typing import Any

from tvsysid.errors import InputError, describe_error, one_line
from tvsysid.methods.adaptive.adaptive import AdaptiveRegression
from tvsysid.methods.base import Method
from tvsysid.methods.birf import BasisIRF
from tvsysid.methods.cascade.alternating import BasisCascade, EnsembleCascade, ParallelCascade
from tvsysid.methods.cascade.cascade import JointCascade
from tvsysid.methods.eirf import EnsembleIRF
from tvsysid.methods.esm import EnsembleSpectral
from tvsysid.methods.kbr.kbr import KernelRegression
from tvsysid.methods.modal import ModalDecomposition
from tvsysid.methods.scheduled.scheduled import ScheduledImpedance, ScheduledIRF
from tvsysid.methods.sds import ShortDataSegments
from tvsysid.methods.settings import settings_from_text
from tvsysid.methods.skirt import SkirtDecomposition
from tvsysid.methods.subspace_cascade import SubspaceCascade
from tvsysid.methods.tuning import Tuned
from tvsysid.validators import settings_of

METHODS: dict[str, type[Method]] = {
    method.key: method
    for method in (
        EnsembleIRF,
        ShortDataSegments,
        BasisIRF,
        EnsembleSpectral,
        KernelRegression,
        AdaptiveRegression,
        JointCascade,
        ParallelCascade,
        EnsembleCascade,
        BasisCascade,
        SubspaceCascade,
        ScheduledIRF,
        ScheduledImpedance,
        SkirtDecomposition,
        ModalDecomposition,
    )
}

PAPER_METHODS = ("eirf", "sds", "birf", "esm", "kbr")  # compared by van de Ruit et al. 2021
STUDIED_METHODS = (*PAPER_METHODS, "adaptive")  # of a study, by default
CLOSED_LOOP = (  # for a joint in closed loop; the channel "disturbance" holds the reference
    "sds:reference=disturbance",
    "esm:stiffness=fit,reference=disturbance",
    "birf:reference=disturbance",
    "kbr:reference=disturbance,weighting=residual",
)
# Attribute that an object of each kind must have.
ATTRIBUTES = {"system": "simulate", "profile": "__call__", "perturbation": "generate"}


def expand(methods: Iterable[Any]) -> list[Any]:
    """Return methods, with those of a group in its place: ``"published"`` or ``"all"``."""
    expanded: list[Any] = []
    for item in methods:
        if item == "published":
            expanded += PAPER_METHODS
        elif item == "all":
            expanded += [*METHODS, *installed()]
        else:
            expanded.append(item)
    return expanded


def installed() -> dict[str, str]:
    """Return ``module:Class`` of the methods of installed packages, by their keys."""
    points = entry_points(group="tvsysid.methods")
    return {point.name: point.value for point in points if point.name not in METHODS}


def parse(text: str) -> Method:
    """Create a method from a text: ``key`` or ``key:setting=value,setting=value``.

    A method of your own is ``"mymodule:MyMethod"`` or ``"mymodule:MyMethod:order=3"``. Settings
    that are left out have their defaults. With ``tuned=true``, the method chooses its settings
    from the data.

    Raises
    ------
    InputError
        For an unknown key or setting, a value that does not fit, or a module that cannot be used.

    Examples
    --------
    >>> parse("esm:window=0.4,stiffness=fit")
    EnsembleSpectral(window=0.4, stiffness='fit', reference=None)
    >>> parse("birf:basis=HaarWavelets(functions=8)").basis
    HaarWavelets(functions=8)
    >>> parse("kbr:gamma=(4.5, 0.1, 1e-4)").gamma
    (4.5, 0.1, 0.0001)
    >>> parse("birf:tuned=true").title
    'Basis impulse response function, tuned'
    >>> parse("tvsysid.methods:ShortDataSegments:window=0.2")
    ShortDataSegments(max_lag=0.12, window=0.2, reference=None)
    """
    method: Method = from_text(text, "method")
    return method


def from_text(text: str, kind: str, known: Mapping[str, object] | None = None) -> Any:
    """Create an object from a text: ``key`` or ``module:object``, perhaps with ``:setting=value``.

    Parameters
    ----------
    text
        As for :func:`parse`, which raises the same errors.
    kind
        ``"method"``, ``"system"``, ``"profile"`` or ``"perturbation"``.
    known
        Classes, or objects whose settings can be changed, by key. By default the package's own
        methods.
    """
    known = METHODS if known is None else known
    key, rest = _split(text, known)
    if kind == "method" and key not in known:  # reading the entry points takes milliseconds
        key = installed().get(key, key)
    if key not in known and ":" not in key:
        raise InputError(
            f"unknown {kind} {key!r}; expected one of {', '.join(known)}, or your own as "
            "module:Object"
        )
    target = known[key] if key in known else load(key, kind)
    label = f"{kind} {text!r}"
    if kind == "method" and not _is_method(target):
        raise InputError(f"{label} is no tvsysid.Method")
    if not hasattr(target, attribute := ATTRIBUTES.get(kind, "__doc__")):
        raise InputError(f"{label} has no {attribute}")
    own = {}
    if not isinstance(target, type):
        if not rest:
            return target
        target, own = type(target), settings_of(target)
    try:
        return _made(target, **own | settings_from_text(rest, target))
    except Exception as error:
        raise InputError(f"{label}: {describe_error(error)}") from error


def _is_method(value: object) -> bool:
    return isinstance(value, Method) or (isinstance(value, type) and issubclass(value, Method))


def _made(target: Any, tuned: bool = False, **settings: Any) -> Any:
    """Create an object from settings. ``tuned`` adds tuning."""
    made = target(**settings)
    return Tuned(made) if tuned else made


def resolve(value: object, known: Mapping[str, object], kind: str) -> Any:
    """Return the object for a known name or a text with settings. Return other values unchanged."""
    return from_text(value, kind, known) if isinstance(value, str) else value


def load(name: str, kind: str = "object") -> Any:
    """Import the class or object ``package.module:Name``. The ``kind`` is for messages.

    Raises
    ------
    InputError
        If there is no such module or name, or the module fails while it is imported.
    """
    where, _, path = name.partition(":")
    importlib.invalidate_caches()  # the file may have been written a moment ago
    try:
        return attrgetter(path)(importlib.import_module(where))
    except (Exception, SystemExit) as error:
        is_missing = isinstance(error, (ModuleNotFoundError, TypeError))
        hint = "; a module is named without its folder and without .py" * is_missing
        raise InputError(f"{kind} {name!r}: {describe_error(error)}{hint}") from error


def to_text(method: Method) -> str:
    """Return the text of a built-in method, as :func:`parse` reads it, without default settings.

    Examples
    --------
    >>> to_text(ShortDataSegments(window=0.2)), to_text(KernelRegression())
    ('sds:window=0.2', 'kbr')
    """
    default = type(method)()
    words = [
        f"{name}={value if isinstance(value, str) else repr(value)}"
        for name, value in settings_of(method).items()
        if value != getattr(default, name)
    ]
    return ":".join(filter(None, (method.key, ",".join(words).replace(" ", ""))))


def label_of(item: object) -> str:
    """Return the label of a method or of a part of a simulation in results: its text or its repr.

    An object without a repr of its own has the name of its class.
    """
    if isinstance(item, str):
        return item
    return type(item).__name__ if " at 0x" in repr(item) else one_line(repr(item))


def key_of(text: str) -> str:
    """Return the key in a method's text, without the settings.

    Examples
    --------
    >>> key_of("sds:window=0.2"), key_of("mymodule:MyMethod:order=3")
    ('sds', 'mymodule:MyMethod')
    """
    return _split(text, METHODS)[0]


def _split(text: str, known: Container[str]) -> tuple[str, str]:
    """Split a text into key and settings. A word without equals sign after a colon is a class."""
    head, _, rest = text.partition(":")
    first, _, after = rest.partition(":")
    if head not in known and first and "=" not in first:
        return f"{head}:{first}", after
    return head, rest
