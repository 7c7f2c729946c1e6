"""Task of a study: what a worker gets, how it runs and measures a method, what it returns."""

from __future__ import annotations

import hashlib
import platform
import sys
import threading
import time
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

import attrs
import cloudpickle
import numpy as np
from numpy.typing import NDArray

from tvsysid import __version__, metrics
from tvsysid.errors import (
    DataQualityWarning,
    InputError,
    describe_error,
    library_folders,
    one_line,
    printable,
)
from tvsysid.methods.base import SkippedError
from tvsysid.models import Model
from tvsysid.numerics.bands import mean_known
from tvsysid.numerics.threads import single_thread
from tvsysid.signals import Array, Ensemble
from tvsysid.study.settings import differences

Outcome = dict[
    str, NDArray[Any]
]  # what a task measured: an array for each variable of its study's layout
Row = dict[str, Any]
"""Result of one identification: numbers by name, ``warnings``, ``failure``, ``spent`` (s)."""
Known = Mapping[str, Array | None]
"""Noiseless torque of each measured pathway, shape (realization, time), if it is known."""
SKIPPED = "skipped: "  # what the warning begins with of a method that cannot serve the data
Shapes = Mapping[
    str, tuple[int, ...]
]  # numbers that are measured of each identification, and their shapes


@cache
def versions() -> dict[str, str]:
    """Return the software that decides the last bits of a result. Every task carries it."""
    libraries = {name: version(name) for name in ("numpy", "scipy", "zarr")}
    return {"tvsysid": __version__} | libraries | {"python": platform.python_version()}


@attrs.frozen(kw_only=True)
class Task(ABC):
    """One unit of work of a study, which travels to a worker as it is; its label is for messages.

    ``methods`` are pickled by label, each by itself, so that one that cannot be unpickled spoils
    no other; ``shapes`` are those of what is measured of each identification; ``versions`` tell
    of the software of the process that sends it, and a worker with another is refused.
    """

    label: str
    methods: Mapping[str, bytes]
    shapes: Shapes
    versions: Mapping[str, str] = attrs.field(factory=versions)

    @abstractmethod
    def work(self) -> Outcome:
        """Do it."""

    @abstractmethod
    def all_failed(self, reason: str) -> Outcome:
        """Return the outcome without any result."""

    def attempt(self, name: str, ensemble: Ensemble, measure: Callable[[Model], Row]) -> Row:
        """Identify an ensemble by one of the methods and measure the model.

        A failure is kept as a text.
        """
        note(f"{self.label}, method {name}")
        started = time.perf_counter()
        try:
            # Unpickled each time, so that nothing that it remembers passes from one identification
            # to the next.
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always", DataQualityWarning)
                method, begun = cloudpickle.loads(self.methods[name]), time.perf_counter()
                model = method.identify(ensemble)
                seconds = time.perf_counter() - begun
            _check_found(model)
            told = [
                str(item.message)
                for item in caught
                if issubclass(item.category, DataQualityWarning)
            ]
            row = {"seconds": seconds, "spent": seconds, "warnings": told, "failure": ""}
            return row | {"parameters": model.diagnostics.parameters} | measure(model)
        except SkippedError as error:
            return failed("") | {"warnings": [f"{SKIPPED}{error.reason}"]}
        except (Exception, SystemExit) as error:
            return failed(describe_error(error)) | {"spent": time.perf_counter() - started}


def carry_out(task: Task) -> Outcome:
    """Do a task, one at a time in a process, with the same software as the sender."""
    if (here := versions()) != task.versions:
        raise InputError(f"run: a worker has other software: {differences(task.versions, here)}")
    # Warnings are caught and BLAS is limited for a whole process: one task at a time in it.
    with _ONE_AT_A_TIME, single_thread():
        note(task.label)
        return task.work()


def note_tasks_in(file: Path) -> None:
    """Write the current task of this process to a file."""
    global _NOTES  # noqa: PLW0603  # one for a process
    _NOTES = file


def note(text: str) -> None:
    """Write what this process works on, for a message in case that it dies."""
    if _NOTES is not None:
        _NOTES.write_text(text, encoding="utf-8")


_ONE_AT_A_TIME = threading.Lock()
_NOTES: Path | None = None


class Clock:
    """Seconds that the stages of a task took."""

    def __init__(self, stages: Sequence[str]) -> None:
        self.seconds = dict.fromkeys(stages, 0.0)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count what the block takes."""
        started = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] += time.perf_counter() - started


def failed(reason: str) -> Row:
    """Return a row without numbers."""
    return {"warnings": [], "failure": reason, "spent": 0.0}


def _check_found(model: Model) -> None:
    main = [estimate for name, estimate in model.estimates.items() if name == "stiffness"]
    if not any(np.isfinite(estimate.values).any() for estimate in main or model.estimates.values()):
        raise InputError(
            "it found no stiffness at any time" if main else "it found nothing at any time"
        )


def stacked(rows: Sequence[Row], shapes: Shapes) -> Outcome:
    """Return the numbers of all rows, NaN where a row has none."""
    return {
        name: np.array([row.get(name, np.full(shape, np.nan)) for row in rows], dtype=np.float64)
        for name, shape in shapes.items()
    }


def as_text(values: str | Sequence[str]) -> NDArray[Any]:
    """Return texts as they are stored."""
    texts = printable(values) if isinstance(values, str) else [printable(text) for text in values]
    return np.array(texts, dtype=np.dtypes.StringDType())


def over_time(model: Model, quantities: Sequence[str]) -> Array:
    """Return the estimates, shape (quantity, time); NaN where the model has none."""
    return np.stack([model.over_time(name) for name in quantities])


def explained(torque: Array, predicted: Array, sampling_rate: float) -> Row:
    """Return the VAF of a prediction; torques have the shape (realization, time)."""
    return {
        "time_varying_vaf": metrics.time_varying_vaf(torque, predicted),
        "vaf": statistics(metrics.vaf(torque, predicted)),
        "bandpassed_vaf": statistics(metrics.bandpassed_vaf(torque, predicted, sampling_rate)),
    }


def of_pathways(found: Mapping[str, Array], known: Known) -> Row:
    """Return the RMS torque of each pathway of a model, and its VAF if the truth is known.

    Torques have shape (realization, time). Nothing of a model with one pathway.
    """
    if len(found) < 2 or not known:
        return {}
    unknown = np.full(next(iter(found.values())).shape[1], np.nan)
    rms = [
        np.sqrt(mean_known(np.square(found[name]))) if name in found else unknown for name in known
    ]
    vaf = [
        statistics(
            metrics.vaf(torque, found[name])
            if torque is not None and name in found
            else np.zeros(0)
        )
        for name, torque in known.items()
    ]
    return {"pathway_torque": np.stack(rms), "pathway_vaf": np.stack(vaf)}


def over_schedule(model: Model, lengths: Mapping[str, int]) -> Row:
    """Return estimates over a method's variable, their standard errors, and its values.

    Shape (quantity, value).

    Lengths are those that methods said; NaN where a model has fewer values.
    """
    if not lengths:
        return {}
    found = np.full((3, len(lengths), max(lengths.values())), np.nan)
    for place, (name, length) in enumerate(lengths.items()):
        estimate = model.estimates.get(name)
        if estimate is None or len(estimate.axes) != 1 or estimate.axes == ("time",):
            continue
        if (count := len(estimate.values)) > length:
            raise InputError(
                f"{name}: expected the {length} values that the method states at most, got {count}"
            )
        error = estimate.standard_error
        found[0, place, :count] = estimate.values
        found[1, place, :count] = np.nan if error is None else error.values
        found[2, place, :count] = model.coordinates[estimate.axes[0]]
    return dict(
        zip(
            ("scheduled_estimate", "scheduled_standard_error", "scheduling_variable"),
            found,
            strict=True,
        )
    )


STATISTICS = ("mean", "sd", "lowest")  # of the VAFs of realizations


def statistics(values: Array) -> Array:
    """Return the ``STATISTICS`` of the known values."""
    known = values[np.isfinite(values)]
    return (
        np.array([known.mean(), known.std(), known.min()])
        if len(known)
        else np.full(len(STATISTICS), np.nan)
    )


def digests(items: Mapping[str, object]) -> dict[str, str]:
    """Return a digest of the file of each method from outside the package, to detect changes."""
    found = {}
    for label, item in items.items():
        file = getattr(_module_of(item), "__file__", None)
        if file and not _name_of_module(item).startswith("tvsysid.") and Path(file).is_file():
            found[label] = hashlib.sha256(Path(file).read_bytes()).hexdigest()[:12]
    return found


def pickled(
    items: Mapping[str, object], what: str = "method", parts: Sequence[object] = ()
) -> dict[str, bytes]:
    """Pickle methods for workers. A class from a script, a notebook or a loose file is sent whole.

    So are the classes of the ``parts`` that an item is made of. Raises an InputError if one
    cannot be pickled.
    """
    found = {}
    for label, item in items.items():
        with ExitStack() as registered:
            for module in {_module_of(part) for part in (item, *parts)}:
                if module is not None and _is_loose(module):
                    cloudpickle.register_pickle_by_value(module)
                    registered.callback(cloudpickle.unregister_pickle_by_value, module)
            try:
                found[label] = cloudpickle.dumps(item)
            except Exception as error:
                reason = f"{type(error).__name__}: {one_line(str(error))}"
                raise InputError(f"{what} {label}: cannot be sent to a worker: {reason}") from error
    return found


def _name_of_module(item: object) -> str:
    """Return the name of the module of a class or a function."""
    return str(getattr(item, "__module__", None) or type(item).__module__)


def _module_of(item: object) -> ModuleType | None:
    return sys.modules.get(_name_of_module(item))


def _is_loose(module: ModuleType) -> bool:
    """Return whether a module is a file of the user's, not of an installed package."""
    file = getattr(module, "__file__", None)
    return (
        bool(file) and not str(file).startswith(library_folders()) and module.__name__ != "__main__"
    )
