"""Call libraries that crash or never end on damaged files in another process."""

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

WAIT_S, WAIT_S_PER_BYTE = 15.0, 1e-5  # some hundred times what an intact file takes
MEMORY_BYTES = 4 * 2**30  # beside what the process has when it starts

Result = TypeVar("Result")


def run_isolated(function: Callable[..., Result], file: Path, *arguments: object) -> Result:
    """Call a function of a file in another process, with limits for memory and time.

    An InputError is raised if the process crashes or takes too long; the function's own errors are
    raised as well.
    """
    if multiprocessing.current_process().daemon:  # which cannot start processes
        return function(file, *arguments)
    seconds, executor = WAIT_S + WAIT_S_PER_BYTE * file.stat().st_size, _executor(os.getpid())
    try:
        return executor.submit(function, file, *arguments).result(seconds)
    except (BrokenProcessPool, TimeoutError, KeyboardInterrupt) as error:
        _executor.cache_clear()
        for process in (executor._processes or {}).values():
            process.kill()
        executor.shutdown(wait=False, cancel_futures=True)
        if isinstance(error, KeyboardInterrupt):
            raise
        raise InputError(
            f"the library that reads such files crashed, or did not end in {seconds:.0f} s. The "
            "file is probably damaged: copy it again"
        ) from None


@cache
def _executor(process: int) -> ProcessPoolExecutor:
    """Return the executor of this process, which a fork cannot share."""
    if sys.platform == "linux" and threading.active_count() == 1:  # a fork takes no locks along
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
        limit = min(used + MEMORY_BYTES, hard if hard > 0 else sys.maxsize)
        resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    multiprocessing.parent_process().join()  # type: ignore[union-attr]  # it has one
    os._exit(1)
