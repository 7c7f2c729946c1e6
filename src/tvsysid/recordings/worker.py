"""Read files in another process: some libraries crash or never end on damaged files."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import TypeVar

from tvsysid.errors import InputError
from tvsysid.recordings.channel import available_memory, explained

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

SECONDS, SECONDS_PER_BYTE = 3.0, 1e-6  # processor time, some ten times that of a sound file
BYTES, BYTES_PER_BYTE = 2**30, 20  # memory, for all values of a compressed file and their copies
WAIT_RATIO = 10  # time to wait, relative to the processor time: other programs may be at work

Result = TypeVar("Result")


def run_isolated(
    file: Path, size: int, function: Callable[..., Result], *arguments: object
) -> Result:
    """Call a function that reads a file, in a process with limits for memory and time.

    Parameters
    ----------
    file
        File that the function reads.
    size
        Bytes of the values to be read, beyond the size of the file.
    function
        Function of a module; its result can be pickled.

    Raises
    ------
    InputError
        If the function raises an error, crashes, or takes too much memory or time.
    """
    if multiprocessing.current_process().daemon:  # cannot start processes
        return function(*arguments)
    size += file.stat().st_size
    seconds = SECONDS + SECONDS_PER_BYTE * size
    memory = int(min(BYTES + BYTES_PER_BYTE * size, available_memory()))
    executor = _executor(os.getpid())
    try:
        with _no_main_module():
            future = executor.submit(
                _limited, os.getcwd(), file, seconds, memory, function, *arguments
            )
        return future.result(WAIT_RATIO * seconds)
    except InputError as error:
        raise InputError(str(error)) from None  # without the traceback of the other process
    except (BrokenProcessPool, TimeoutError):
        _stop(executor)
        raise InputError(
            f"{file}: the library that reads such files crashed, or did not end in {seconds:.0f} s "
            "of processor time. The file is probably damaged: copy it again"
        ) from None
    except KeyboardInterrupt:
        _stop(executor)
        raise


@cache
def _executor(process: int) -> ProcessPoolExecutor:
    """Return the executor of this process. A fork needs its own."""
    spawn = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(1, spawn, initializer=_initialize)


@contextmanager
def _no_main_module() -> Iterator[None]:
    """Hide the user's script: a new process would run it, unless it has a main guard."""
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


def _stop(executor: ProcessPoolExecutor) -> None:
    _executor.cache_clear()
    for process in (executor._processes or {}).values():
        process.kill()
    executor.shutdown(wait=False, cancel_futures=True)


def _initialize() -> None:
    """Prepare the process: no output, no interrupts, and an end when its parent ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
    os._exit(1)


def _limited(
    folder: str,
    file: Path,
    seconds: float,
    memory: int,
    function: Callable[..., Result],
    *arguments: object,
) -> Result:
    os.chdir(folder)
    if resource is not None:
        _limit(resource.RLIMIT_CORE, 0)
        _limit(resource.RLIMIT_CPU, int(time.process_time() + seconds) + 1)
        with suppress(OSError):  # only Linux tells which addresses are taken
            pages = Path("/proc/self/statm").read_text().split()[0]
            _limit(resource.RLIMIT_AS, int(pages) * resource.getpagesize() + memory)
    with explained(str(file)):
        return function(*arguments)


def _limit(kind: int, value: int) -> None:
    hard = resource.getrlimit(kind)[1]
    resource.setrlimit(kind, (value if hard == resource.RLIM_INFINITY else min(value, hard), hard))
