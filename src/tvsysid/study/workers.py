"""Tasks go to workers, and what comes back goes into the store."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    wait,
)
from concurrent.futures import ProcessPoolExecutor as Pool
from contextlib import closing, contextmanager
from functools import partial
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tvsysid.errors import InputError, describe_error
from tvsysid.study.source import Source
from tvsysid.study.store import Place, Store
from tvsysid.study.task import Outcome, Task, carry_out, note_tasks_in

AHEAD = 2  # tasks that wait for each worker: enough to keep it busy; more would only take memory
UNKNOWN_WORKERS = 32  # assumed of an executor that does not say how many it has


def cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def carry_out_missing(
    store: Store,
    source: Source,
    workers: int | None = None,
    executor: Executor | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> None:
    """Carry out the tasks of a study that its store lacks, and write what comes back.

    Arguments are those of `run`.
    """
    # Those that take longest must not begin last.
    places = sorted(store.missing(), key=source.rank, reverse=True)
    total = len(store.places)
    done = total - len(places)
    if progress is not None:
        progress(done, total)
    # Closed at once if writing fails, so that no worker goes on in vain.
    with closing(_outcomes(source.task_at, places, workers, executor)) as outcomes:
        for place, outcome in outcomes:
            store.write(place, outcome)
            done += 1
            if progress is not None:
                progress(done, total)


def _outcomes(
    task_at: Callable[[Place], Task],
    places: list[Place],
    workers: int | None,
    executor: Executor | None,
) -> Generator[tuple[Place, Outcome]]:
    if executor is not None:
        at_a_time = workers or int(getattr(executor, "_max_workers", UNKNOWN_WORKERS))
        try:
            yield from _from(executor, task_at, places, at_a_time, cancel=True)
        except (BrokenExecutor, CancelledError) as error:
            raise InputError(
                f"run: the executor failed ({type(error).__name__}: {error}). Run the same command "
                "again to resume"
            ) from error
        return
    workers = workers or cores()
    if workers == 1:
        for place in places:
            task = task_at(place)
            yield place, _outcome(partial(carry_out, task), task)
    else:
        yield from _from_processes(task_at, places, min(workers, len(places)))


def _from(
    executor: Executor,
    task_at: Callable[[Place], Task],
    places: Iterable[Place],
    workers: int,
    cancel: bool = False,
) -> Generator[tuple[Place, Outcome]]:
    """Yield outcomes as they finish. Only a few trials are under way at a time.

    Tasks under way at an early end are cancelled, but not in a local pool: its workers are
    ended, and Python 3.11 hangs when it tells a task that was cancelled that its worker died.
    """
    queue = iter(places)
    pending: dict[Future[Outcome], Place] = {}
    try:
        while True:
            for place in islice(queue, (1 + AHEAD) * workers - len(pending)):
                pending[_submit(executor, task_at(place))] = place
            if not pending:
                return
            done, _ = wait(pending, return_when=FIRST_COMPLETED)
            for future in done:
                yield pending[future], _outcome(future.result, task_at(pending[future]))
                del pending[future]
    finally:
        for future in pending if cancel else ():
            future.cancel()


def _outcome(result: Callable[[], Outcome], task: Task) -> Outcome:
    """Return the outcome of a task, or a failure for an unexpected exception."""
    try:
        return result()
    except (BrokenExecutor, CancelledError, InputError):
        raise
    except Exception as error:
        return task.all_failed(f"the worker failed: {describe_error(error)}")


def _submit(executor: Executor, task: Task) -> Future[Outcome]:
    try:
        return executor.submit(carry_out, task)
    except RuntimeError as error:  # it was shut down
        raise BrokenExecutor(str(error)) from error


def _from_processes(
    task_at: Callable[[Place], Task], places: list[Place], workers: int
) -> Generator[tuple[Place, Outcome]]:
    """Yield outcomes from local processes. One that dies ends the study."""
    if not places:
        return
    with TemporaryDirectory() as notes, processes(workers, notes=notes) as pool:
        started = list((pool._processes or {}).values())
        try:
            yield from _from(pool, task_at, places, workers)
        except BrokenExecutor as error:
            for each in started:
                each.join(10)  # the pool ends those that are alive
            # Workers that the pool has ended come last: by a signal, or with an unknown exit code.
            started.sort(key=lambda each: each.exitcode in (0, 255, -signal.SIGTERM))
            files = [Path(notes, str(each.pid)) for each in started]
            where = [file.read_text(encoding="utf-8") for file in files if file.exists()]
            raise InputError(
                f"run: a worker process died in {where[0] if where else 'an unknown task'}. It "
                "crashed, or ran out of memory. Mend or leave out that method; the same command "
                "resumes"
            ) from error


@contextmanager
def processes(workers: int, ready: bool = True, notes: str = "") -> Iterator[Pool]:
    """Start local workers, which end with this process and ignore interruptions.

    They are waited for until ``ready``; an InputError says that they do not start. Each writes the
    task that it works on into a file in the folder ``notes``, if there is one.
    """
    # A fresh interpreter for each worker: forking one with BLAS and progress threads may hang.
    context = multiprocessing.get_context("spawn")
    try:
        pool = Pool(workers, mp_context=context, initializer=_start_worker, initargs=(notes,))
    except OSError as error:
        raise InputError(
            "run: worker processes cannot be made here, which need shared memory "
            f"({error.strerror}); see that "
            "/dev/shm can be written to, or give workers=1"
        ) from error
    try:
        # Each waiting task starts a worker, which inherits that it leaves an interruption to this
        # process.
        with _interruptions_ignored():
            first = [pool.submit(os.getpid) for _ in range(workers)]
        try:
            if ready:
                wait(first)
                first[0].result()
        except BrokenExecutor as error:
            raise InputError(
                "run: the worker processes did not start. A script must call run from under "
                "`if __name__ == '__main__':`, because each worker imports it; or give workers=1"
            ) from error
        if len(pool._processes or {}) == workers:  # no more will be started
            _close_results(pool)
        yield pool
    except (KeyboardInterrupt, GeneratorExit):
        # Nobody waits for what is under way any more, least of all for a method that hangs.
        _close_results(pool)
        for process in list((pool._processes or {}).values()):
            process.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _close_results(pool: Pool) -> None:
    """Close the parent's end of the result pipe. The reader then notices a worker that ends."""
    results: Any = getattr(pool, "_result_queue", None)
    if results is not None:
        results._writer.close()


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


def _start_worker(notes: str) -> None:
    """Make a worker end with its parent, even a killed one, and note its tasks."""
    if notes:
        note_tasks_in(Path(notes, str(os.getpid())))
    parent = multiprocessing.parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
