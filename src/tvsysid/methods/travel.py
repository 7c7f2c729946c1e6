"""What may travel between processes: methods as bytes, and results made of the package's own classes alone."""

from __future__ import annotations

import io
import pickle
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from types import ModuleType
from typing import Any

import cloudpickle

from tvsysid.errors import InputError, library_folders, plain_text

PLAIN = {"builtins": {"complex", "set", "frozenset", "bytearray", "range", "slice"}, "collections": {"OrderedDict"}}
"""Names of the standard library that what comes back may be made of."""


def pickled(items: Mapping[str, object], what: str = "method", parts: Sequence[object] = ()) -> dict[str, bytes]:
    """Methods as they travel; a class from a script, notebook or loose file travels whole, for workers lack that.

    So do the classes of what they are made of, if it is named as ``parts``. Raises an InputError if one cannot be
    pickled.
    """
    travelling = {}
    for label, item in items.items():
        with ExitStack() as registered:
            for module in {module_of(part) for part in (item, *parts)}:
                if module is not None and _is_loose(module):
                    cloudpickle.register_pickle_by_value(module)
                    registered.callback(cloudpickle.unregister_pickle_by_value, module)
            try:
                travelling[label] = cloudpickle.dumps(item)
            except Exception as error:
                reason = f"{type(error).__name__}: {plain_text(error)}"
                raise InputError(f"{what} {label}: cannot be sent to a worker: {reason}") from error
    return travelling


def name_of_module(item: object) -> str:
    """Of the class, or of a function itself."""
    return str(getattr(item, "__module__", None) or type(item).__module__)


def module_of(item: object) -> ModuleType | None:
    """Module that the class, or a function, is written in."""
    return sys.modules.get(name_of_module(item))


def _is_loose(module: ModuleType) -> bool:
    """Whether a module is a file of the user's, not an installed package."""
    file = getattr(module, "__file__", None)
    return bool(file) and not str(file).startswith(library_folders()) and module.__name__ != "__main__"


class _Plain(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if module.partition(".")[0] in ("numpy", "tvsysid") or name in PLAIN.get(module, ()):
            return super().find_class(module, name)
        raise pickle.UnpicklingError(f"it holds an object of {module}.{name}")


def plain(content: bytes | bytearray) -> Any:
    """Object that holds nothing but the package's own classes, numbers and text; raises if it holds anything else."""
    return _Plain(io.BytesIO(content)).load()
