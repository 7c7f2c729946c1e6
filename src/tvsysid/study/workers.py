"""Run tasks in this process, in local worker processes, or by any executor."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from concurrent.futures import ProcessPoolExecutor as Pool
from contextlib import ExitStack, contextmanager
from itertools import islice
from pathlib import Path

from tvsysid.errors import InputError, one_line
from tvsysid.study.measure import Scores
from tvsysid.study.tasks import Task, pickled, run_pickled, run_task, write_scores

UNKNOWN_WORKERS = 32  # assumed of an executor that does not state how many it has


def cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run_tasks(
    tasks: Mapping[Path, Task], workers: int | None = None, executor: Executor | None = None
) -> Iterator[tuple[Path, Scores]]:
    """Run tasks, write the scores of each to its file, and yield both.

    Parameters
    ----------
    workers
        Local processes; None takes one for each core, 1 works in this process.
    executor
        Runs the tasks instead. It needs no access to the files. Then ``workers`` is the number of
        workers that it has.

    Raises
    ------
    InputError
        If a worker dies, or the executor fails.
    """
    with ExitStack() as stack:
        if executor is not None:
            # A second task for each worker is on its way while the first is run.
            count = workers or int(getattr(executor, "_max_workers", UNKNOWN_WORKERS))
            finished = _by_executors(tasks, [executor] * 2 * count)
        elif (count := min(workers or cores(), len(tasks))) > 1:
            # A pool of one for each process: if the process dies, its task is known.
            pools = [stack.enter_context(_process()) for _ in range(count)]
            finished = _by_executors(tasks, pools)
        else:
            finished = ((file, run_task(task)) for file, task in tasks.items())
        for file, scores in finished:
            write_scores(scores, file)
            yield file, scores


def _by_executors(
    tasks: Mapping[Path, Task], free: Sequence[Executor]
) -> Iterator[tuple[Path, Scores]]:
    """Yield scores as they come; an executor in the list is free for one task."""
    waiting, free = iter(tasks.items()), list(free)
    running: dict[Future[Scores], tuple[Executor, Path]] = {}
    file = Path()
    try:
        while True:
            for file, task in islice(waiting, len(free)):
                executor = free.pop()
                running[executor.submit(run_pickled, pickled(task))] = executor, file
            if not running:
                return
            done = wait(running, return_when=FIRST_COMPLETED).done
            for future in sorted(done, key=lambda each: each.exception() is not None):
                executor, file = running.pop(future)
                free.append(executor)
                yield file, future.result()
    except (InputError, OSError):
        raise
    except Exception as error:
        task = tasks[file]
        raise InputError(
            f"run: the worker of {task.case} by {', '.join(task.methods)} failed "
            f"({type(error).__name__}: {one_line(str(error))}). It crashed, ran out of memory, or "
            "did not start (a script must call run under `if __name__ == '__main__':`). Run the "
            "same command again to resume"
        ) from error
    finally:
        for future in running:
            future.cancel()


@contextmanager
def _process() -> Iterator[Pool]:
    """Start a local process, which ends with this one and ignores interruptions."""
    others = set(multiprocessing.active_children())
    # A fresh interpreter for each worker: forking one with BLAS and progress threads may hang.
    pool = Pool(1, multiprocessing.get_context("spawn"), initializer=_begin)
    try:
        yield pool
    except BaseException:
        # Nobody waits for what is under way, least of all for a method that hangs.
        for child in set(multiprocessing.active_children()) - others:
            child.terminate()
        # The end of a result that a worker was sending never comes: do not wait for it.
        pool._result_queue._writer.close()  # type: ignore[attr-defined]
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _begin() -> None:
    """Make a worker ignore interruptions, and end with its parent, even with one that is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def follow() -> None:
        if parent := multiprocessing.parent_process():
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
