"""Tasks of a study: a worker runs one, and its scores are kept in one file."""

from __future__ import annotations

import hashlib
import platform
import re
import sys
import threading
from abc import ABC, abstractmethod
from collections.abc import Mapping
from contextlib import ExitStack
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
from tvsysid.study.measure import Scores, Truth, measure


@cache
def versions() -> dict[str, str]:
    """Return the versions of the software that decides the last bits of a result."""
    libraries = {name: version(name) for name in ("numpy", "scipy")}
    return {"tvsysid": __version__} | libraries | {"python": platform.python_version()}


@attrs.frozen(kw_only=True)
class Task(ABC):
    """Part of a study whose scores are stored in one file.

    Its representation shows all that the scores depend on.

    Parameters
    ----------
    label
        Name in messages.
    digests
        What tells apart methods, and parts of a simulation, with the same label, by label.
    methods
        Pickled methods by their label.
    versions
        Software of the process that made the task.
    """

    label: str
    digests: Mapping[str, str]
    methods: Mapping[str, bytes] = attrs.field(repr=False)
    versions: Mapping[str, str] = attrs.field(factory=versions)

    @property
    def file_name(self) -> str:
        """Name of its file: a hash of all that the scores depend on."""
        return f"{hashlib.sha256(repr(self).encode()).hexdigest()[:24]}.npz"

    @abstractmethod
    def scores(self) -> Scores:
        """Do the work."""

    def measure(self, label: str, ensemble: Ensemble, truth: Truth) -> Scores:
        """Identify an ensemble by one of the methods, and compare it with the truth."""
        # Each identification gets a method of its own, so that it cannot remember another one.
        return measure(cloudpickle.loads(self.methods[label]), ensemble, truth)


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
        raise InputError(f"run: {task.label} failed: {describe_error(error)}") from error


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


def digests_of(items: Mapping[str, object]) -> dict[str, str]:
    """Return a digest of the attributes and the source file of each object of a user's class.

    It is empty for objects of the package, whose labels say all of them.
    """
    digests = dict.fromkeys(items, "")
    for label, item in items.items():
        module = _module_of(item)
        if module is None or not module.__name__.startswith("tvsysid."):
            state = re.sub(" at 0x[0-9a-f]+", "", repr(getattr(item, "__dict__", "")))
            file = Path(getattr(module, "__file__", None) or "")
            code = file.read_bytes() if file.is_file() else b""
            digests[label] = hashlib.sha256(state.encode() + code).hexdigest()[:12]
    return digests


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
