"""Run tasks in this process, in local worker processes, or by any executor."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from concurrent.futures import ProcessPoolExecutor as Pool
from contextlib import ExitStack, contextmanager
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from tvsysid.errors import InputError, one_line
from tvsysid.study.measure import Scores
from tvsysid.study.tasks import Task, note_tasks_in, run_task, write_scores

UNKNOWN_WORKERS = 32  # assumed of an executor that does not state how many it has


class Worker(NamedTuple):
    """What runs one task at a time.

    Parameters
    ----------
    executor
        Local process, or an executor of somebody else, which has several workers.
    note
        File in which a local process writes what it does.
    """

    executor: Executor
    note: Path | None = None


def cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run_tasks(
    tasks: Mapping[Path, Task], workers: int | None = None, executor: Executor | None = None
) -> Iterator[Path]:
    """Run tasks, write the scores of each to its file, and yield the file.

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
    if executor is not None:
        count = workers or int(getattr(executor, "_max_workers", UNKNOWN_WORKERS))
        # A second task for each worker is on its way while the first is run.
        yield from _run(tasks, [Worker(executor)] * 2 * count)
        return
    count = workers or cores()
    if count == 1:
        for file, task in tasks.items():
            run_task(task, file)
            yield file
        return
    with TemporaryDirectory() as notes, ExitStack() as stack:
        # A process to itself for each worker: if one dies, its task is known.
        files = [Path(notes, str(number)) for number in range(min(count, len(tasks)))]
        workers_ = [Worker(stack.enter_context(processes(1, note)), note) for note in files]
        yield from _run(tasks, workers_)


def _run(tasks: Mapping[Path, Task], workers: Sequence[Worker]) -> Iterator[Path]:
    waiting = iter(tasks.items())
    running: dict[Future[Scores | None], tuple[Worker, Path]] = {}

    def start(worker: Worker) -> None:
        for file, task in islice(waiting, 1):
            arguments = (task,) if worker.note is None else (task, file)
            running[worker.executor.submit(run_task, *arguments)] = worker, file

    try:
        for worker in workers:
            start(worker)
        while running:
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                worker, file = running.pop(future)
                try:
                    scores = future.result()
                except BrokenExecutor as error:
                    raise _died(worker, error) from error
                start(worker)
                if scores is not None:
                    write_scores(scores, file)
                yield file
    except (InputError, OSError):
        raise
    except Exception as error:
        raise InputError(
            f"run: the executor failed ({type(error).__name__}: {one_line(str(error))}). Run the "
            "same command again to resume"
        ) from error
    finally:
        for future in running:
            future.cancel()


def _died(worker: Worker, error: BrokenExecutor) -> Exception:
    """Return the error for a worker that died."""
    if worker.note is None:
        return error
    if not worker.note.exists():
        return InputError(
            "run: the worker processes did not start. A script must call run from under `if "
            "__name__ == '__main__':`, because each worker imports it; or give workers=1"
        )
    return InputError(
        f"run: a worker process died in {worker.note.read_text(encoding='utf-8')}. It crashed, or "
        "ran out of memory. Correct or leave out that method; the same command resumes"
    )


@contextmanager
def processes(count: int, note: Path | None = None) -> Iterator[Pool]:
    """Start local processes, which end with this one and ignore interruptions.

    Parameters
    ----------
    note
        File in which the process writes its current task.

    Raises
    ------
    InputError
        If no process can be started.
    """
    others = set(multiprocessing.active_children())
    # A fresh interpreter for each worker: forking one with BLAS and progress threads may hang.
    context = multiprocessing.get_context("spawn")
    try:
        pool = Pool(count, mp_context=context, initializer=_begin, initargs=(note,))
    except OSError as error:
        raise InputError(
            "run: worker processes cannot be made here, which need shared memory "
            f"({error.strerror}); make /dev/shm writable, or give workers=1"
        ) from error
    try:
        with _interruptions_ignored():  # which a new process inherits
            for _ in range(count):
                pool.submit(os.getpid)
        yield pool
    except BaseException:
        # Nobody waits for what is under way, least of all for a method that hangs.
        for child in set(multiprocessing.active_children()) - others:
            child.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _interruptions_ignored() -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _begin(note: Path | None) -> None:
    """Make a worker end with its parent, even with one that is killed."""
    if note is not None:
        note_tasks_in(note)
    parent = multiprocessing.parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
