"""Find methods by name: the package's own, those of installed packages, and ``module:Class``.

User-defined systems, profiles, perturbations and scenarios are found in the same way.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from contextlib import suppress
from importlib.metadata import EntryPoint, distributions
from operator import attrgetter
from typing import Any

from tvsysid.errors import InputError, describe_error, one_line
from tvsysid.methods.adaptive.adaptive import AdaptiveRegression
from tvsysid.methods.base import Method
from tvsysid.methods.basis_cascade import BasisCascade
from tvsysid.methods.birf import BasisIRF
from tvsysid.methods.cascade.cascade import JointCascade
from tvsysid.methods.eirf import EnsembleIRF
from tvsysid.methods.ensemble_cascade import EnsembleCascade
from tvsysid.methods.esm import EnsembleSpectral
from tvsysid.methods.kbr.kbr import KernelRegression
from tvsysid.methods.modal import ModalDecomposition
from tvsysid.methods.parallel_cascade import ParallelCascade
from tvsysid.methods.scheduled.methods import ScheduledImpedance, ScheduledIRF
from tvsysid.methods.sds import ShortDataSegments
from tvsysid.methods.settings import converted, further_settings, names_of_settings, split_settings
from tvsysid.methods.skirt import SkirtDecomposition
from tvsysid.methods.subspace_cascade import SubspaceCascade
from tvsysid.methods.tuning.evidence import Tuned
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
DEFAULT_METHODS = ("adaptive", *PAPER_METHODS)  # of `identify`
STUDIED_METHODS = (*PAPER_METHODS, "adaptive")  # of a study, by default
CLOSED_LOOP = (  # for a joint in closed loop; the channel "disturbance" holds the reference
    "sds:reference=disturbance",
    "esm:stiffness=fit,reference=disturbance",
    "birf:reference=disturbance",
    "kbr:reference=disturbance,weighting=residual",
)
ENTRY_POINTS = {"method": "tvsysid.methods", "scenario": "tvsysid.scenarios"}
# Attribute that an object of each kind must have.
ATTRIBUTES = {"system": "simulate", "profile": "__call__", "perturbation": "generate"}


def names() -> tuple[str, ...]:
    """Return the keys of all methods: the package's own, then those of installed packages.

    Nothing is loaded. An installed method that has one of the package's own keys is ignored.

    Examples
    --------
    >>> names()[:5]
    ('eirf', 'sds', 'birf', 'esm', 'kbr')
    """
    return (*METHODS, *(name for name in installed() if name not in METHODS))


def installed(kind: str = "method") -> dict[str, EntryPoint]:
    """Return the methods or scenarios of installed packages by name, sorted. Nothing is loaded."""
    found: dict[str, EntryPoint] = {}
    for distribution in distributions():
        with suppress(Exception):  # unreadable metadata of one package must not stop the others
            for point in distribution.entry_points.select(group=ENTRY_POINTS[kind]):
                found.setdefault(point.name, point)
    return dict(sorted(found.items()))


def origin_of(text: str) -> str:
    """Return the package and version, or the module, that defines a method.

    Examples
    --------
    >>> origin_of("mymodule:MyMethod:order=3")
    'mymodule'
    """
    key = key_of(text)
    if key in METHODS:
        return "tvsysid"
    distribution = getattr(installed().get(key), "dist", None)
    return f"{distribution.name} {distribution.version}" if distribution else key.partition(":")[0]


def parse(text: str) -> Method:
    """Create a method from a text: ``key`` or ``key:setting=value,setting=value``.

    A method of your own is ``"mymodule:MyMethod"`` or ``"mymodule:MyMethod:order=3"``. Settings
    that are left out have their defaults. With ``tuned=true``, the method chooses its settings
    from the data. ``kbr`` also takes ``preset=simulation`` or ``preset=experiment``.

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


def from_text(text: str, kind: str, default: object = None) -> Any:
    """Create an object from a text: ``key`` or ``module:object``, perhaps with ``:setting=value``.

    Parameters
    ----------
    text
        As for :func:`parse`, which raises the same errors.
    kind
        ``"method"``, ``"system"``, ``"profile"`` or ``"perturbation"``.
    default
        Object whose settings are changed. The key is then ignored.
    """
    key, rest = _split(text)
    target = find(key, kind) if default is None else type(default)
    label = f"{kind} {text!r}"
    if not _is_a(kind, target):
        name = getattr(target, "__name__", type(target).__name__)
        expected = f"has no {ATTRIBUTES[kind]}" if kind in ATTRIBUTES else "is no tvsysid.Method"
        raise InputError(f"{label}: {name} {expected}")
    if not isinstance(target, type):
        if rest:
            raise InputError(
                f"{label}: an object takes no settings; name its class {type(target).__name__}"
            )
        return target
    try:
        given = split_settings(rest)
        _check_names(given, target)
        values = {name: converted(target, name, value) for name, value in given.items()}
        return _made(target, **({} if default is None else settings_of(default)) | values)
    except InputError as error:
        raise InputError(f"{label}: {error}") from error
    except (Exception, SystemExit) as error:
        raise InputError(f"{label}: {describe_error(error)}") from error


def _made(target: Any, tuned: bool = False, preset: str | None = None, **settings: Any) -> Any:
    """Create an object from settings. ``preset`` names other defaults, ``tuned`` adds tuning."""
    made = target(**settings) if preset is None else target.preset(preset, **settings)
    return Tuned(made) if tuned else made


def _check_names(given: Mapping[str, str], target: type) -> None:
    """Raise for a setting that a class does not have."""
    known = [*names_of_settings(target), *further_settings(target)]
    for name in given:
        if name not in known:
            others = [key for key, each in METHODS.items() if name in names_of_settings(each)]
            hint = f"; methods with that setting are {', '.join(others)}" if others else ""
            raise InputError(
                f"unknown setting {name!r}; its settings are {', '.join(known) or 'none'}{hint}"
            )


def resolve(value: object, known: Mapping[str, object], kind: str) -> Any:
    """Return the object for a known name or a text with settings. Return other values unchanged."""
    if not isinstance(value, str):
        return value
    if value in known:
        return known[value]
    key, _, rest = value.partition(":")
    if not rest or (key not in known and "=" in rest.partition(":")[0]):
        raise InputError(
            f"unknown {kind} {key!r}; expected one of {', '.join(known)}, or your own as "
            "module:Object"
        )
    return from_text(value, kind, known.get(key))


def find(key: str, kind: str) -> Any:
    """Return the class or object of a key. The package's own methods take precedence."""
    if kind == "method" and key in METHODS:
        return METHODS[key]
    if kind not in ENTRY_POINTS or ":" in key:
        return load(key, kind)
    points = installed(kind)
    if key not in points:
        known = ", ".join(names() if kind == "method" else points) or "none"
        raise InputError(
            f"unknown {kind} {key!r}; the {kind}s are {known}; your own is module:Name"
        )
    return load(points[key].value.partition("[")[0].replace(" ", ""), kind)


def load(name: str, kind: str = "object") -> Any:
    """Import the class or object ``package.module:Name``. The ``kind`` is for messages.

    Raises
    ------
    InputError
        If there is no such module or name, or the module fails while it is imported.
    """
    where, _, path = name.partition(":")
    label = f"{kind} {name!r}"
    if not all(word.isidentifier() for word in (*where.split("."), *path.split("."))):
        raise InputError(
            f"{label}: expected module:Class, as in mypackage.mymodule:My{kind.title()}; a module "
            "is named without its folder and without .py"
        )
    importlib.invalidate_caches()  # the file may have been written a moment ago
    try:
        module = importlib.import_module(where)
    except (Exception, SystemExit) as error:
        missing = error.name if isinstance(error, ModuleNotFoundError) else None
        if missing is not None and f"{where}.".startswith(f"{missing}."):
            raise InputError(
                f"{label}: there is no module {missing!r} in the current folder or among the "
                "installed packages; go to its folder, or install its package"
            ) from error
        raise InputError(
            f"{label}: module {where!r} fails while it is imported: {describe_error(error)}"
        ) from error
    try:
        return attrgetter(path)(module)
    except AttributeError as error:
        found = [
            each
            for each, value in vars(module).items()
            if _is_a(kind, value) and not each.startswith("_")
        ]
        raise InputError(
            f"{label}: module {where!r} has no {path!r}; its {kind}s are "
            f"{', '.join(found) or 'none'}"
        ) from error


def _is_a(kind: str, value: object) -> bool:
    """Return whether an object is a method, or has the attribute that another kind needs."""
    if kind == "method":
        return isinstance(value, Method) or (isinstance(value, type) and issubclass(value, Method))
    return hasattr(value, ATTRIBUTES.get(kind, "__doc__"))


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
    return _split(text)[0]


def _split(text: str) -> tuple[str, str]:
    """Split a text into key and settings. A word without equals sign after a colon is a class."""
    head, _, rest = text.partition(":")
    first, _, after = rest.partition(":")
    if head not in METHODS and first and "=" not in first:
        return f"{head}:{first}", after
    return head, rest
