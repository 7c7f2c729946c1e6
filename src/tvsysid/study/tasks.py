"""A task identifies some draws of a case by some methods; its scores are one file."""

from __future__ import annotations

import hashlib
import inspect
import platform
import re
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import attrs
import cloudpickle
import numpy as np
import scipy

from tvsysid import __version__
from tvsysid.errors import InputError, describe_error, one_line
from tvsysid.methods import Method, label_of
from tvsysid.numerics.threads import single_thread
from tvsysid.recordings import whole_file
from tvsysid.signals import Ensemble
from tvsysid.study.measure import Scores, Truth, measure, stack


def versions() -> dict[str, str]:
    """Return the versions of the software that decides the last bits of a result."""
    return {
        "tvsysid": __version__,
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "python": platform.python_version(),
    }


@attrs.frozen(kw_only=True)
class Task:
    """Some draws of a case, identified by some methods.

    Parameters
    ----------
    case
        Label of a scenario, or of a recording.
    draw
        Function of a draw's number that returns an ensemble and the truth. If it raises an
        InputError, all methods fail in that draw.
    draws
        Numbers of the draws.
    methods
        Methods by their labels in the results.
    depends_on
        Object whose repr states everything that determines the draws.
    """

    case: str
    draw: Callable[[int], tuple[Ensemble, Truth]]
    draws: Sequence[int]
    methods: Mapping[str, Method]
    depends_on: object

    def __reduce__(self) -> tuple[Any, ...]:
        # cloudpickle also sends a notebook's code. It is called when a task is sent, so that copies
        # of all tasks do not fill the memory.
        return _unpickled, (cloudpickle.dumps(attrs.asdict(self, recurse=False)),)

    @property
    def file_name(self) -> str:
        """Name of its file: a hash of all that the scores depend on."""
        methods = {label: identity_of(method) for label, method in self.methods.items()}
        parts = self.case, self.depends_on, list(self.draws), methods, versions()
        return f"{hashlib.sha256(repr(parts).encode()).hexdigest()[:24]}.npz"

    def scores(self) -> Scores:
        """Return scores over draws and methods. Equal draws are identified once."""
        cells: list[Scores] = []
        found: dict[bytes, list[Scores]] = {}
        for number in self.draws:
            try:
                ensemble, truth = self.draw(number)
            except InputError as error:
                cells += [{"failure": np.array(one_line(str(error)))}] * len(self.methods)
                continue
            key = ensemble.angle.tobytes()
            if key not in found:
                found[key] = [measure(each, ensemble, truth) for each in self.methods.values()]
            cells += found[key]
        return stack(cells, len(self.draws), len(self.methods))


def _unpickled(settings: bytes) -> Task:
    return Task(**cloudpickle.loads(settings))


_one_at_a_time = threading.Lock()


def run_task(task: Task) -> Scores:
    """Return the scores of a task, on one thread."""
    try:
        # Warnings are caught and BLAS is limited for a whole process: one task at a time in it.
        with _one_at_a_time, single_thread():
            return task.scores()
    except Exception as error:
        raise InputError(f"run: {task.case} failed: {describe_error(error)}") from error


def identity_of(item: object) -> str:
    """Return a text that identifies an object: its settings and, if it is a user's, its code."""
    kind: Any = item if inspect.isroutine(item) else type(item)
    if kind.__module__.startswith("tvsysid."):
        return label_of(item)
    module: Any = sys.modules.get(kind.__module__)
    with np.printoptions(threshold=sys.maxsize):
        text = re.sub(" at 0x[0-9a-f]+", "", repr(item.__getstate__()))
    with suppress(OSError, TypeError):  # notebooks have no source of a module
        text += inspect.getsource(module if hasattr(module, "__file__") else kind)
    return text


def write_scores(scores: Scores, file: Path) -> None:
    """Write scores to a file, which appears whole or not at all.

    They are the fields of one array, because many arrays take three times as long to write.
    """
    fields = [(name, each.dtype, each.shape) for name, each in scores.items()]
    with whole_file(file) as temporary:
        np.savez(temporary, scores=np.array(tuple(scores.values()), fields))


def read_scores(file: Path) -> Scores:
    """Return the scores in a file; none if there is no such file, or it is damaged.

    The file is a ZIP archive, which has a checksum.
    """
    try:
        with np.load(file) as archive:
            scores = archive["scores"]
            return {name: scores[name] for name in scores.dtype.names}
    except (OSError, ValueError, EOFError, KeyError, BadZipFile, RuntimeError):
        return {}
