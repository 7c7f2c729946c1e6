"""Methods by name: the package's own, those of installed packages, and ``module:Object`` of a user's own.

Settings typed as text get the types of their fields, whoever wrote the method. Systems, profiles
and perturbations of a user's own are found in the same way, and scenarios, which packages offer
as they do methods.
"""

from __future__ import annotations

import importlib
import inspect
import warnings
from collections.abc import Mapping
from contextlib import suppress
from importlib.metadata import EntryPoint, distributions
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from tvsysid.errors import InputError, describe_error, one_line
from tvsysid.methods.adaptive.adaptive import AdaptiveRegression
from tvsysid.methods.apply import Identifies
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
from tvsysid.methods.settings import converted, further_settings, parts
from tvsysid.methods.skirt import SkirtDecomposition
from tvsysid.methods.subspace_cascade import SubspaceCascade
from tvsysid.methods.tuning.evidence import Tuned
from tvsysid.validators import settings_of as setting_values

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

PAPER_METHODS = ("eirf", "sds", "birf", "esm", "kbr")  # those that van de Ruit et al. 2021 compare
DEFAULT_METHODS = (
    "adaptive",
    *PAPER_METHODS,
)  # what an ensemble is identified by; the first gives the answer
STUDIED_METHODS = (*PAPER_METHODS, "adaptive")  # what studies compare
CLOSED_LOOP = (
    "sds:reference=disturbance",
    "esm:stiffness=fit,reference=disturbance",
    "birf:reference=disturbance",
    "kbr:reference=disturbance,weighting=residual",
)  # methods as they serve a joint in closed loop, whose disturbance is the channel of this name
GROUPS = {
    "method": "tvsysid.methods",
    "scenario": "tvsysid.scenarios",
}  # of entry points that a package offers
VERBS = {  # what an object of each kind must have, and how it is written
    "method": (
        "identify",
        "identify(self, ensemble) that returns a model with stiffness and predict(ensemble)",
    ),
    "system": (
        "simulate",
        "simulate(self, duration, perturbation, snr_db, seed, rate) that returns a Simulation",
    ),
    "profile": ("__call__", "__call__(self, time) that returns a value for each time"),
    "perturbation": (
        "generate",
        "generate(self, samples, rate, random) that returns an angle for each sample",
    ),
}


def names() -> tuple[str, ...]:
    """Keys of all methods: the package's own, then those that installed packages offer.

    Nothing is loaded. A method that a package offers under one of the package's own keys is
    ignored; see
    :func:`clashes`.

    Examples
    --------
    >>> names()[:5]
    ('eirf', 'sds', 'birf', 'esm', 'kbr')
    """
    return (*METHODS, *(name for name in installed() if name not in METHODS))


def clashes() -> tuple[str, ...]:
    """What installed packages offer under one of the package's own keys, in a sentence each."""
    sentence = (
        "{!r} is offered by the installed package {} too; the package's own is used. Name "
        "the other {}"
    )
    return tuple(
        sentence.format(key, *_origin(point))
        for key, point in installed().items()
        if key in METHODS
    )


def installed(what: str = "method") -> dict[str, EntryPoint]:
    """Methods, or what else is in ``GROUPS``, of installed packages by name, sorted.

    None of them is loaded.
    """
    found: dict[str, EntryPoint] = {}
    for distribution in distributions():
        with suppress(
            Exception
        ):  # unreadable metadata of whatever package must not stop the others
            for point in distribution.entry_points.select(group=GROUPS[what]):
                found.setdefault(point.name, point)
    return dict(sorted(found.items()))


def origin_of(text: str) -> str:
    """Where a method as typed comes from: the package and its version, or the module.

    Examples
    --------
    >>> origin_of("mymodule:MyMethod:order=3")
    'mymodule'
    """
    key = key_of(text)
    point = None if key in METHODS else installed().get(key)
    if point is not None:
        return f"{_origin(point)[0]} {getattr(point.dist, 'version', '')}".rstrip()
    return "tvsysid" if key in METHODS else key.partition(":")[0]


def _origin(point: EntryPoint) -> tuple[str, str]:
    """Package that offers it, and where it is, as ``module:Class``."""
    return getattr(point.dist, "name", None) or "without a name", point.value.partition("[")[
        0
    ].replace(" ", "")


def create(key: str, **settings: Any) -> Identifies:
    """Method of this key, one of :func:`names` or ``module:Class``, with settings by name.

    The paper's otherwise.

    ``kbr`` also takes ``preset``, ``"simulation"`` or ``"experiment"``. With ``tuned=True`` a
    method of the package chooses its settings from the data, beginning with these: see
    :class:`Tuned`.

    Raises
    ------
    InputError
        For an unknown key or setting, or a value that does not fit.

    Examples
    --------
    >>> create("sds", window=0.2)
    ShortDataSegments(max_lag=0.12, window=0.2, reference=None)
    """
    made: Identifies = _made(key, target_of(key, "method"), settings, "method")
    return made


def parse(text: str) -> Identifies:
    """Method from a word as typed on the command line: ``key`` or ``key:setting=value,setting=value``.

    A method of one's own is ``"mypackage.mymodule:MyMethod"`` or
    ``"mypackage.mymodule:MyMethod:order=3"``. The package's own keys come first, then modules, then
    the names that installed packages offer.

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
    made: Identifies = from_text(text, "method")
    return made


def from_text(text: str, what: str, usual: Any = None) -> Any:
    """Object from ``module:Object`` or ``module:Class:setting=value``, as :func:`parse`.

    An instance, if it is a class.

    ``what`` it is to be is one of :data:`VERBS`; errors are those of :func:`parse`. Settings may
    change a ``usual`` dataclass, whatever its name.
    """
    if not text.isprintable():
        raise InputError(
            f"{what} {text!r}: expected a name and settings without control characters"
        )
    key, rest = _split(text)
    target, settings = target_of(key, what) if usual is None else type(usual), {}
    for part in filter(None, parts(rest)):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals:
            raise InputError(f"{what} {text!r}: expected setting=value, got {part!r}")
        settings[name] = value
    try:
        values = {name: converted(target, name, value) for name, value in settings.items()}
    except InputError as error:
        raise InputError(f"{what} {text!r}: {error}") from error
    if usual is not None:
        values = setting_values(usual) | values
    return _made(key, target, values, what)


def found_as(value: object, known: Mapping[str, object], what: str) -> Any:
    """Object that a setting stands for: a known name or ``module:Object``, with settings if need be, or itself."""
    if not isinstance(value, str):
        return value
    if value in known:
        return known[value]
    key, _, rest = value.partition(":")
    if not rest or (key not in known and "=" in rest.partition(":")[0]):
        raise InputError(
            f"unknown {what} {key!r}; expected one of {', '.join(known)}, or your own as "
            "module:Object"
        )
    return from_text(value, what, known.get(key))


def load(name: str, what: str = "object") -> Any:
    """Class or object ``package.module:Object``, as it is; imports its module.

    ``what`` it is to be is for messages. Raises :class:`tvsysid.InputError` if there is no such
    module, if it fails while it is imported, or if it has no such name.
    """
    where, _, path = name.partition(":")
    label = f"{what} {name!r}"
    if where.endswith(".py") or "/" in where or "\\" in where:
        stem = Path(where.replace("\\", "/")).name.removesuffix(".py")
        raise InputError(
            f"{label}: expected the name of a module, got a file; go to its folder and give "
            f"{stem}:{path}"
        )
    if not all(word.isidentifier() for word in (*where.split("."), *path.split("."))):
        raise InputError(
            f"{label}: expected module:Class, as in mypackage.mymodule:My{what.title()}"
        )
    importlib.invalidate_caches()  # the file may have been written a moment ago
    try:
        with (
            np.errstate(),
            warnings.catch_warnings(),
        ):  # what it changes there is no business of other methods
            module = importlib.import_module(where)
    except (Exception, SystemExit, GeneratorExit) as error:
        absent = error.name if isinstance(error, ModuleNotFoundError) else None
        if absent is not None and f"{where}.".startswith(f"{absent}."):
            raise InputError(
                f"{label}: there is no module {absent!r}; the current folder and the installed "
                "packages were searched. "
                "Go to the folder that holds it, or install its package"
            ) from error
        raise InputError(
            f"{label}: module {where!r} fails while it is imported: {describe_error(error)}"
        ) from error
    target: object = module
    for word in path.split("."):
        if not hasattr(target, word):
            raise InputError(
                f"{label}: module {where!r} has no {path!r}; {_contents(module, what)}"
            )
        target = getattr(target, word)
    return target


def typed(method: Method) -> str:
    """Word that :func:`parse` makes one of the package's own methods of: its key, and what differs from its defaults.

    Examples
    --------
    >>> typed(ShortDataSegments(window=0.2)), typed(KernelRegression())
    ('sds:window=0.2', 'kbr')
    """
    usual, values = type(method)(), setting_values(method)
    changed = {name: value for name, value in values.items() if value != getattr(usual, name)}
    words = [
        f"{name}={value if isinstance(value, str) else repr(value)}"
        for name, value in changed.items()
    ]
    return ":".join(filter(None, (method.key, ",".join(words).replace(" ", ""))))


def label_of(item: object) -> str:
    """Name in results: as typed, the repr, or the name of the class where the repr shows an address only."""
    if isinstance(item, str):
        return item
    return type(item).__name__ if " at 0x" in repr(item) else one_line(repr(item))


def key_of(text: str) -> str:
    """Key of a method as typed on the command line, without its settings.

    Examples
    --------
    >>> key_of("sds:window=0.2"), key_of("mymodule:MyMethod:order=3")
    ('sds', 'mymodule:MyMethod')
    """
    return _split(text)[0]


def target_of(key: str, what: str) -> Any:
    """Class or object of a key; of a method, the package's own come first."""
    if what == "method" and key in METHODS:
        return METHODS[key]
    if what not in GROUPS or ":" in key:
        return load(key, what)
    point = installed(what).get(key)
    if point is None:
        known = (
            ", ".join(names() if what == "method" else installed(what))
            or "none, for no installed package has any"
        )
        own = "module:Class" if what == "method" else "module:name"
        raise InputError(
            f"unknown {what} {key!r}; the {what}s are {known}; a {what} of your own is named {own}"
        )
    package, place = _origin(point)
    try:
        return load(place, what)
    except InputError as error:
        raise InputError(
            f"{what} {key!r} of the installed package {package} cannot be loaded: {error}"
        ) from error


def _made(key: str, target: object, settings: Mapping[str, Any], what: str) -> Any:
    """Object from a class and its settings, or the object itself."""
    label, kind = f"{what} {key!r}", type(target).__name__
    said = f"class {target.__name__}" if isinstance(target, type) else f"an object of type {kind}"
    verb, written = VERBS[what]
    if not callable(getattr(target, verb, None)):
        raise InputError(f"{label}: {said} has no {verb}; a {what} is a class with {written}")
    if not isinstance(target, type):
        if settings:
            raise InputError(
                f"{label}: it is an object that is there already, and takes no settings, got "
                f"{', '.join(settings)}; "
                f"name its class {kind} instead"
            )
        return target
    fields_of, takes_any = settings_of(target)
    known = [*fields_of, *further_settings(target)]
    unknown = [name for name in settings if name not in known and not takes_any]
    if unknown:
        has = f"its settings are {', '.join(known)}" if fields_of else "it has none"
        others = [
            name
            for name, method in METHODS.items()
            if what == "method" and unknown[0] in settings_of(method)[0]
        ]
        with_it = f"; methods with that setting are {', '.join(others)}" if others else ""
        raise InputError(f"{label}: unknown setting {unknown[0]!r}; {has}{with_it}")
    missing = [
        name
        for name, item in fields_of.items()
        if item.default is item.empty and name not in settings
    ]
    if missing:
        raise InputError(
            f"{label}: {said} needs {', '.join(missing)}; give a value, as in "
            f"{key}:{','.join(f'{name}=…' for name in missing)}, or a default in the class"
        )
    try:
        return _own(target, **settings) if issubclass(target, Method) else target(**settings)
    except InputError:
        raise
    except (Exception, SystemExit) as error:
        raise InputError(
            f"{label}: {said} cannot be made with these settings: {describe_error(error)}"
        ) from error


def _own(
    kind: Any, tuned: bool = False, preset: str | None = None, **settings: Any
) -> Method | Tuned:
    """One of the package's own methods."""
    if not isinstance(tuned, bool):
        raise InputError(f"{kind.key}: tuned must be true or false, got {tuned!r}")
    made: Method = kind(**settings) if preset is None else kind.preset(preset, **settings)
    return Tuned(made) if tuned else made


def settings_of(target: type) -> tuple[dict[str, inspect.Parameter], bool]:
    """Settings that a class takes by name, and whether it takes any others."""
    found: dict[str, inspect.Parameter] = {}
    with suppress(TypeError, ValueError):  # compiled classes may not say
        found = dict(inspect.signature(target).parameters)
    named = {
        name: item
        for name, item in found.items()
        if item.kind not in (item.VAR_POSITIONAL, item.VAR_KEYWORD)
    }
    return named, any(item.kind is item.VAR_KEYWORD for item in found.values())


def _contents(module: ModuleType, what: str) -> str:
    """What a module has that could be meant."""
    verb = VERBS[what][0] if what in VERBS else "__call__"
    found = [
        name
        for name, value in vars(module).items()
        if not name.startswith("_") and verb in dir(value) and not inspect.isabstract(value)
    ]
    return f"what it has with {verb}: {', '.join(found)}" if found else f"nothing in it has {verb}"


def _split(text: str) -> tuple[str, str]:
    """Key and settings of a method: what stands behind a colon is a class if it has no equals sign."""
    head, _, rest = text.partition(":")
    first, _, after = rest.partition(":")
    if head not in METHODS and first and "=" not in first:
        return f"{head}:{first}", after
    return head, rest
