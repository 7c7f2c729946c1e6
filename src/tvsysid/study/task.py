"""A unit of work: what is sent to a worker, and what comes back."""

from __future__ import annotations

import hashlib
import platform
import sys
import threading
import warnings
from abc import ABC, abstractmethod
from collections.abc import Mapping
from contextlib import AbstractContextManager
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

import cloudpickle
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from tvsysid import __version__
from tvsysid.errors import DataQualityWarning, InputError, library_folders
from tvsysid.methods.apply import apply
from tvsysid.models import Model
from tvsysid.signals import Ensemble

Outcome = dict[str, NDArray[Any]]
"""What a task measured: an array for each variable of its study's layout."""


@cache
def versions() -> dict[str, str]:
    """What the last bits of a result depend on; looked up once, for every task carries it."""
    libraries = {name: version(name) for name in ("numpy", "scipy", "zarr")}
    return {"tvsysid": __version__} | libraries | {"python": platform.python_version()}


class Task(ABC):
    """One unit of work of a study.

    A frozen dataclass with the attributes below, which travels to a worker as it is.

    Attributes
    ----------
    methods
        Pickled methods by label. Each is unpickled by itself, so that one that cannot be spoils no other.
    versions
        Software of the process that sends it; a worker with another is refused.
    left_out
        Methods not to be tried, and why.
    """

    methods: Mapping[str, bytes]
    versions: Mapping[str, str]
    left_out: Mapping[str, str]

    @abstractmethod
    def work(self) -> Outcome:
        """Do it."""

    @abstractmethod
    def all_failed(self, reason: str) -> Outcome:
        """Outcome where no method gave a result."""


def carry_out(task: Task) -> Outcome:
    """Do a task; one at a time in a process.

    Raises
    ------
    InputError
        If this process has other versions of the software than the one that sent the task.
    """
    if (here := versions()) != task.versions:
        raise InputError(f"run: a worker has other software: {differences(task.versions, here)}")
    # Warnings are caught and BLAS is limited for a whole process: one task at a time in it.
    with _ONE_AT_A_TIME, single_thread():
        return task.work()


def single_thread() -> AbstractContextManager[Any]:
    """BLAS with one thread, for the last bits of what it gives depend on their number."""
    limited: AbstractContextManager[Any] = _blas().limit(limits=1)
    return limited


_blas = cache(ThreadpoolController)
_ONE_AT_A_TIME = threading.Lock()


def digests(methods: Mapping[str, Any]) -> dict[str, str]:
    """Digest of the file that holds each method of somebody else's: a method that was changed is another one."""
    found = {}
    for label, method in methods.items():
        module = sys.modules.get(type(method).__module__)
        file = getattr(module, "__file__", None)
        if file and not type(method).__module__.startswith("tvsysid.") and Path(file).is_file():
            found[label] = hashlib.sha256(Path(file).read_bytes()).hexdigest()[:12]
    return found


def _is_loose(module: ModuleType) -> bool:
    """Whether a module is a file of the user's, not an installed package."""
    file = getattr(module, "__file__", None)
    return bool(file) and not str(file).startswith(library_folders()) and module.__name__ != "__main__"


def pickled(methods: Mapping[str, Any]) -> dict[str, bytes]:
    """Methods as they travel; a class from a script, notebook or loose file travels whole, for workers lack that.

    Raises
    ------
    InputError
        If one cannot be pickled.
    """
    travelling = {}
    for label, method in methods.items():
        module = sys.modules.get(type(method).__module__)
        by_value = module is not None and _is_loose(module)
        if by_value:
            cloudpickle.register_pickle_by_value(module)
        try:
            travelling[label] = cloudpickle.dumps(method)
        except Exception as error:
            raise InputError(f"method {label}: cannot be sent to a worker: {type(error).__name__}: {error}") from error
        finally:
            if by_value:
                cloudpickle.unregister_pickle_by_value(module)
    return travelling


def identified(method: Any, ensemble: Ensemble) -> tuple[Model, list[str]]:
    """Model that a method finds, whoever's it is, and the doubts that it tells.

    Raises
    ------
    InputError
        If what it returns is no model, or holds no stiffness at any time. Its own errors pass.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataQualityWarning)
        model = apply(method, ensemble, type(method).__name__)
    if not np.isfinite(model.stiffness).any():
        raise InputError("it found no stiffness at any time")
    return model, [str(item.message) for item in caught if issubclass(item.category, DataQualityWarning)]


def differences(theirs: Mapping[str, Any], ours: Mapping[str, Any]) -> str:
    """What differs between two mappings, in words."""
    return "; ".join(
        f"{name}: {theirs.get(name, 'nothing')} there, {ours.get(name, 'nothing')} here"
        for name in dict.fromkeys([*theirs, *ours])
        if theirs.get(name) != ours.get(name)
    )
