"""Tasks of a study: a worker gets one, runs it, and writes its scores to one file."""

from __future__ import annotations

import hashlib
import json
import platform
import re
import sys
import threading
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any
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

    Parameters
    ----------
    label
        Name in messages.
    methods
        Pickled methods by their label.
    settings
        All that the scores depend on beside the versions of the software, as JSON has it.
    versions
        Software of the process that made the task.
    """

    label: str
    methods: Mapping[str, bytes]
    settings: Mapping[str, Any]
    versions: Mapping[str, str] = attrs.field(factory=versions)

    @property
    def file_name(self) -> str:
        """Name of its file: a hash of all that the scores depend on."""
        text = json.dumps([self.settings, self.versions], sort_keys=True, default=str)
        return f"{hashlib.sha256(text.encode()).hexdigest()[:24]}.npz"

    @abstractmethod
    def scores(self) -> Scores:
        """Do the work."""

    def measure(self, label: str, ensemble: Ensemble, truth: Truth) -> Scores:
        """Identify an ensemble by one of the methods, and compare it with the truth."""
        _note(f"{self.label}, method {label}")
        # Each identification gets a method of its own, so that it cannot remember another one.
        return measure(cloudpickle.loads(self.methods[label]), ensemble, truth)


def run_task(task: Task, file: Path | None = None) -> Scores | None:
    """Run a task on one thread; write its scores to a file, or return them."""
    if versions() != task.versions:
        raise InputError(
            f"run: a worker has other software ({versions()}) than this process "
            f"({dict(task.versions)}); install the same versions"
        )
    _note(task.label)
    try:
        # Warnings are caught and BLAS is limited for a whole process: one task at a time in it.
        with _one_at_a_time, single_thread():
            scores = task.scores()
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"run: {task.label} failed: {describe_error(error)}") from error
    if file is None:
        return scores
    write_scores(scores, file)
    return None


def write_scores(scores: Scores, file: Path) -> None:
    """Write scores to a file, which appears whole or not at all."""
    with whole_file(file) as temporary, temporary.open("wb") as opened:
        plain = {
            name: values.astype(str) if values.dtype.kind == "O" else values
            for name, values in scores.items()
        }
        np.savez(opened, allow_pickle=False, **plain)


def read_scores(file: Path) -> Scores | None:
    """Return the scores in a file; None if there is no such file, or it is damaged.

    The file is a ZIP archive, which has a checksum of each array.
    """
    try:
        with np.load(file) as archive:
            return dict(archive)
    except (OSError, ValueError, EOFError, KeyError, BadZipFile, NotImplementedError):
        return None


_one_at_a_time = threading.Lock()
_note_file: Path | None = None


def note_tasks_in(file: Path) -> None:
    """Write the current task of this process to a file."""
    global _note_file  # noqa: PLW0603  # one for a process
    _note_file = file


def _note(text: str) -> None:
    """Write what this process does, for a message in case it dies."""
    if _note_file is not None:
        _note_file.write_text(text, encoding="utf-8")


def digests_of(items: Mapping[str, object]) -> dict[str, str]:
    """Return a digest of the attributes and the source file of each object of a user's class.

    The labels of objects of the package say all of them.
    """
    digests = {}
    for label, item in items.items():
        if _module_name(item).startswith("tvsysid."):
            continue
        state = re.sub(" at 0x[0-9a-f]+", "", repr(getattr(item, "__dict__", "")))
        digest = hashlib.sha256(state.encode())
        file = getattr(_module_of(item), "__file__", None)
        if file and Path(file).is_file():
            digest.update(Path(file).read_bytes())
        digests[label] = digest.hexdigest()[:12]
    return digests


def pickled(label: str, item: object, parts: Sequence[object] = ()) -> bytes:
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
            if module is not None and _is_loose(module):
                cloudpickle.register_pickle_by_value(module)
                registered.callback(cloudpickle.unregister_pickle_by_value, module)
        try:
            return bytes(cloudpickle.dumps(item))
        except Exception as error:
            reason = f"{type(error).__name__}: {one_line(str(error))}"
            raise InputError(f"{label}: cannot be sent to a worker: {reason}") from error


def _module_name(item: object) -> str:
    """Return the name of the module of a class, a function or an object."""
    return str(getattr(item, "__module__", None) or type(item).__module__)


def _module_of(item: object) -> ModuleType | None:
    return sys.modules.get(_module_name(item))


def _is_loose(module: ModuleType) -> bool:
    """Return whether a module is a file of the user's, not of an installed package."""
    file = getattr(module, "__file__", None)
    return (
        bool(file) and not str(file).startswith(library_folders()) and module.__name__ != "__main__"
    )
