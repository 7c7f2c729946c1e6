"""Run tasks in this process, in local worker processes, or by any executor."""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import threading
from collections.abc import Generator, Iterator, Mapping
from concurrent.futures import Executor, Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

import cloudpickle

from tvsysid.errors import InputError, one_line
from tvsysid.study.measure import Scores
from tvsysid.study.tasks import Task, run_task

RESUME = "Run the same command again to resume"


def cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run_tasks(
    tasks: Mapping[Path, Task], executor: Executor | None, workers: int
) -> Generator[tuple[Path, Scores], None, None]:
    """Run tasks, and yield the file of each with its scores as they come.

    Parameters
    ----------
    executor
        Runs the tasks. It needs no access to the files. None runs them in this process.
    workers
        Number of tasks that are named if a worker dies: those that were begun first.

    Raises
    ------
    InputError
        If a worker dies, or the executor fails.
    """
    if executor is None:
        yield from ((file, run_task(task)) for file, task in tasks.items())
        return
    running: dict[Future[Scores], Path] = {}
    try:
        for file, task in tasks.items():
            cloudpickle.dumps(task.methods)  # raises here, and not in a thread of the executor
            running[executor.submit(run_task, task)] = file
        for future in as_completed(running):
            measured = future.result()
            yield running.pop(future), measured
    except InputError:
        raise
    except Exception as error:
        begun = (tasks[file] for file in islice(running.values(), workers))
        names = dict.fromkeys(f" at {task.case} by {', '.join(task.methods)}" for task in begun)
        raise InputError(
            f"run: a worker failed ({type(error).__name__}: {one_line(str(error))})"
            f"{' or'.join(names)}. It crashed, ran out of memory, did not start (a script must "
            f"call run under `if __name__ == '__main__':`), or could not be sent its task. {RESUME}"
        ) from error
    finally:
        if not isinstance(executor, _LocalPool):  # which is terminated, and has to fail its futures
            for future in running:
                future.cancel()


class _LocalPool(ProcessPoolExecutor):
    """Processes that end with the block of :func:`local_workers`."""


@contextmanager
def local_workers(count: int) -> Iterator[Executor | None]:
    """Open local processes, which end with this one and ignore interruptions.

    Yield None instead of a single process.

    Raises
    ------
    InputError
        If a worker dies.
    """
    if count < 2:
        yield None
        return
    # A fresh interpreter for each worker: forking one with BLAS and progress threads may hang.
    context = multiprocessing.get_context("spawn")
    pool = _LocalPool(count, context, initializer=_begin)
    for _ in range(count):  # start all, which takes a second, before there is work
        pool.submit(cores)
    try:
        yield pool
    except BrokenProcessPool as error:
        raise InputError(f"a worker failed: {error} {RESUME}") from error
    except BaseException:
        # Nobody waits for what is under way, least of all for a method that hangs.
        for worker in pool._processes.values():
            worker.terminate()
        # A worker may have sent only a part of its result: do not wait for the rest.
        pool._result_queue._writer.close()  # type: ignore[attr-defined]
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _begin() -> None:
    """Make a worker ignore interruptions, and end with its parent, even if that is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # The workers also draw figures. Garbage collection would take a tenth of that time.
    gc.set_threshold(100_000)

    def follow() -> None:
        if parent := multiprocessing.parent_process():
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
