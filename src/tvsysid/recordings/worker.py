"""Read files in a separate process, because damaged files crash or hang some libraries."""

from __future__ import annotations

import faulthandler
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import TypeVar

from tvsysid.errors import InputError

TIMEOUT_S, TIMEOUT_S_PER_BYTE = 15.0, 1e-5  # some hundred times longer than an intact file
MAX_ADDED_BYTES = 4 * 2**30  # beyond the memory of the process when it starts

Result = TypeVar("Result")


def run_isolated(function: Callable[..., Result], file: Path, *arguments: object) -> Result:
    """Call ``function(file, *arguments)`` in another process, with limits for memory and time.

    Raise an InputError if the process crashes or takes too long. Errors of the function are raised
    as well.
    """
    if multiprocessing.current_process().daemon:  # a daemon cannot start processes
        return function(file, *arguments)
    seconds, executor = TIMEOUT_S + TIMEOUT_S_PER_BYTE * file.stat().st_size, _executor(os.getpid())
    try:
        return executor.submit(function, file, *arguments).result(seconds)
    except (BrokenProcessPool, TimeoutError, KeyboardInterrupt) as error:
        _executor.cache_clear()
        for process in (executor._processes or {}).values():
            process.kill()
        executor.shutdown(wait=False, cancel_futures=True)
        if isinstance(error, KeyboardInterrupt):
            raise
        late = isinstance(error, TimeoutError)
        happened = f"did not finish in {seconds:.0f} s" if late else "crashed"
        raise InputError(
            f"the library that reads this format {happened}. The file is probably damaged. "
            "Copy it again"
        ) from None


@cache
def _executor(process_id: int) -> ProcessPoolExecutor:
    """Return the executor of this process. A forked process needs its own, hence the id."""
    if sys.platform == "linux" and threading.active_count() == 1:  # no other thread holds a lock
        return ProcessPoolExecutor(1, multiprocessing.get_context("fork"), _initialize)
    executor = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), _initialize)
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")  # else the new process runs the user's script
    try:
        executor.submit(os.getpid)  # starts the process
    finally:
        sys.modules["__main__"] = main
    return executor


def _initialize() -> None:
    """Silence and limit the process, leave Ctrl-C to its parent, and end it with its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    faulthandler.disable()
    for stream in (1, 2):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
    if sys.platform == "linux":  # other systems do not limit memory
        import resource  # noqa: PLC0415  # not on Windows

        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        limit = min(used + MAX_ADDED_BYTES, hard if hard > 0 else sys.maxsize)
        resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Wait until the parent process ends, then end this process."""
    multiprocessing.parent_process().join()  # type: ignore[union-attr]  # it has one
    os._exit(1)
