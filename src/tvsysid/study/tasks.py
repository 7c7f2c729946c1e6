"""Cases give draws; a task identifies some draws by some methods, and its scores are one file."""

from __future__ import annotations

import hashlib
import inspect
import platform
import re
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Hashable, Mapping, Sequence
from contextlib import ExitStack, suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from zipfile import BadZipFile

import attrs
import cloudpickle
import numpy as np

from tvsysid import __version__
from tvsysid.errors import InputError, describe_error, library_folders, one_line
from tvsysid.numerics.threads import single_thread
from tvsysid.recordings import whole_file
from tvsysid.signals import Ensemble
from tvsysid.study.measure import TRUTH, Scores, Truth, measure, stack


@cache
def versions() -> dict[str, str]:
    """Return the versions of the software that decides the last bits of a result."""
    libraries = {name: version(name) for name in ("numpy", "scipy")}
    return {"tvsysid": __version__} | libraries | {"python": platform.python_version()}


@attrs.frozen(kw_only=True)
class Case(ABC):
    """Source of ensembles, such as a simulated scenario or a recording.

    Its representation shows all that the ensembles depend on.

    Parameters
    ----------
    label
        Name in messages.
    """

    label: str

    @abstractmethod
    def draw(self, number: int) -> tuple[Ensemble, Truth]:
        """Return an ensemble, and what its models are compared with."""

    def identity(self, number: int) -> Hashable:
        """Return a value that equal draws share."""
        return number


@attrs.frozen(kw_only=True)
class Task:
    """Some draws of a case, identified by some methods.

    Its representation shows all that its scores depend on.

    Parameters
    ----------
    case, draws
        Where the ensembles come from, and the numbers of the draws.
    methods
        Pickled methods by their label.
    digests
        What distinguishes methods with the same label, by label.
    row, columns
        Place of the case and of each method in the results.
    versions
        Software of the process that made the task.
    """

    case: Case
    draws: Sequence[int]
    methods: Mapping[str, bytes] = attrs.field(repr=False)
    digests: Mapping[str, str]
    row: int = attrs.field(repr=False)
    columns: Sequence[int] = attrs.field(repr=False)
    versions: Mapping[str, str] = attrs.field(factory=versions)

    @property
    def file_name(self) -> str:
        """Name of its file: a hash of all that the scores depend on."""
        return f"{hashlib.sha256(repr(self).encode()).hexdigest()[:24]}.npz"

    def scores(self) -> Scores:
        """Return scores over draws, and over methods after them. Equal draws are measured once."""
        identities = list(map(self.case.identity, self.draws))
        measured = {
            identity: self._measure(self.draws[identities.index(identity)])
            for identity in dict.fromkeys(identities)
        }
        return stack([measured[identity] for identity in identities])

    def _measure(self, number: int) -> Scores:
        started = time.perf_counter()
        ensemble, truth = self.case.draw(number)
        # Each identification gets a method of its own, so that it cannot remember another one.
        methods = map(cloudpickle.loads, self.methods.values())
        scores = stack([measure(method, ensemble, truth) for method in methods])
        known = {f"{TRUTH}/{name}": values for name, values in truth.quantities.items()}
        spent = time.perf_counter() - started - np.nansum(scores["seconds"])
        return scores | known | {"other_seconds": np.asarray(spent)}


_one_at_a_time = threading.Lock()


def run_task(task: Task) -> Scores:
    """Run a task on one thread."""
    if versions() != task.versions:
        raise InputError(
            f"run: a worker has other software ({versions()}) than this process "
            f"({dict(task.versions)}); install the same versions"
        )
    try:
        # Warnings are caught and BLAS is limited for a whole process: one task at a time in it.
        with _one_at_a_time, single_thread():
            return task.scores()
    except Exception as error:
        raise InputError(f"run: {task.case.label} failed: {describe_error(error)}") from error


def write_scores(scores: Scores, file: Path) -> None:
    """Write scores to a file, which appears whole or not at all."""
    with whole_file(file) as temporary, temporary.open("wb") as opened:
        np.savez(opened, allow_pickle=False, **scores)


def read_scores(file: Path) -> Scores:
    """Return the scores in a file; none if there is no such file, or it is damaged.

    The file is a ZIP archive, which has a checksum of each array.
    """
    try:
        with np.load(file) as archive:
            return dict(archive)
    except (OSError, ValueError, EOFError, KeyError, BadZipFile, NotImplementedError):
        return {}


def digest_of(item: object) -> str:
    """Return a digest of the attributes and the source code of an object of a user's class.

    It is empty for objects of the package, whose labels say all of them.
    """
    module = _module_of(item)
    if module is not None and module.__name__.startswith("tvsysid."):
        return ""
    with np.printoptions(threshold=sys.maxsize):
        state = re.sub(" at 0x[0-9a-f]+", "", repr(item.__getstate__()))
    file, code = Path(getattr(module, "__file__", None) or ""), b""
    if file.is_file():
        code = file.read_bytes()
    else:
        with suppress(OSError, TypeError):  # the source is known of a notebook's cells
            code = inspect.getsource(item if inspect.isroutine(item) else type(item)).encode()
    return hashlib.sha256(state.encode() + code).hexdigest()[:12]


def pickled(label: str, item: object, *parts: object) -> bytes:
    """Pickle an object for workers. A class from a script, notebook or loose file is sent whole.

    Parameters
    ----------
    parts
        Objects that the object is made of, whose classes are sent too.

    Raises
    ------
    InputError
        If the object cannot be pickled.
    """
    with ExitStack() as registered:
        for module in {_module_of(part) for part in (item, *parts)}:
            file = str(getattr(module, "__file__", None) or "")
            is_loose = file and not file.startswith(library_folders())
            if module is not None and is_loose and module.__name__ != "__main__":
                cloudpickle.register_pickle_by_value(module)
                registered.callback(cloudpickle.unregister_pickle_by_value, module)
        try:
            return bytes(cloudpickle.dumps(item))
        except Exception as error:
            reason = f"{type(error).__name__}: {one_line(str(error))}"
            raise InputError(f"{label}: cannot be sent to a worker: {reason}") from error


def _module_of(item: object) -> ModuleType | None:
    """Return the module of a class, a function or an object."""
    return sys.modules.get(getattr(item, "__module__", None) or type(item).__module__)
