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
from typing import Any

import attrs

from tvsysid.errors import InputError, describe_error
from tvsysid.study.source import Source
from tvsysid.study.store import Place, Store
from tvsysid.study.task import Outcome, Task, carry_out

AHEAD = 2  # tasks that wait for each worker: enough to keep it busy; more would only take memory
UNKNOWN_WORKERS = 32  # assumed of an executor that does not say how many it has


def cores() -> int:
    """Cores that this process may use; a job on a cluster may have fewer than the machine."""
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
    killers: dict[str, str] = {}

    def task_at(place: Place) -> Task:
        return attrs.evolve(source.task_at(place), left_out=dict(killers))

    if progress is not None:
        progress(done, total)
    # Closed at once if writing fails, so that no worker goes on in vain.
    with closing(_outcomes(task_at, killers, places, workers, executor)) as outcomes:
        for place, outcome in outcomes:
            store.write(place, outcome)
            done += 1
            if progress is not None:
                progress(done, total)


def _outcomes(
    task_at: Callable[[Place], Task],
    killers: dict[str, str],
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
                f"run: the executor gave up ({type(error).__name__}: {error}); what was finished "
                "is kept in the store, "
                "and the same call goes on from there"
            ) from error
        return
    workers = workers or cores()
    if workers == 1:
        for place in places:
            task = task_at(place)
            yield place, _outcome(partial(carry_out, task), task)
    else:
        yield from _from_processes(task_at, killers, places, workers)


def _from(
    executor: Executor,
    task_at: Callable[[Place], Task],
    places: Iterable[Place],
    workers: int,
    cancel: bool = False,
) -> Generator[tuple[Place, Outcome]]:
    """Outcomes as they come; never more than a few trials are under way.

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
    """What a task gives, or that it failed where it raised what is nobody's word to the user."""
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
    task_at: Callable[[Place], Task], killers: dict[str, str], places: list[Place], workers: int
) -> Generator[tuple[Place, Outcome]]:
    """Outcomes from local processes; where one dies, its tasks are done again, each by itself."""
    left = dict.fromkeys(places)
    while left:
        try:
            with processes(min(workers, len(left))) as pool:
                for place, outcome in _from(pool, task_at, list(left), workers):
                    del left[place]
                    yield place, outcome
        except BrokenExecutor:
            # It was one of those under way, the first ones left; the others among them only shared
            # its pool.
            for place in list(left)[: (1 + AHEAD) * workers]:
                del left[place]
                yield place, _alone(task_at(place), killers)


def _alone(task: Task, killers: dict[str, str]) -> Outcome:
    """Outcome of a task in a process of its own.

    A method that kills it is found, marked and not tried again.
    """
    while True:
        try:
            return _in_one_process(attrs.evolve(task, left_out=dict(killers)))
        except BrokenExecutor:
            untried = dict.fromkeys(task.methods, "not tried")
            for label in (None, *(label for label in task.methods if label not in killers)):
                try:
                    _in_one_process(
                        attrs.evolve(
                            task,
                            left_out={each: untried[each] for each in untried if each != label},
                        )
                    )
                except BrokenExecutor:
                    if label is None:
                        return task.all_failed(
                            "the worker process died before any method was tried"
                        )
                    killers[label] = (
                        f"its worker process died in {task.label}, so it was not tried again: it "
                        "crashed, or took more "
                        "memory than there is"
                    )
                    break
            else:
                return task.all_failed(
                    "the worker process died, though each method by itself does not kill it"
                )


def _in_one_process(task: Task) -> Outcome:
    with processes(1) as pool:
        return _outcome(pool.submit(carry_out, task).result, task)


@contextmanager
def processes(workers: int, ready: bool = True) -> Iterator[Pool]:
    """So many local worker processes, which end with this one and leave an interruption to it.

    They are waited for until ``ready``; an InputError says that they do not start.
    """
    # A fresh interpreter for each worker: forking one with BLAS and progress threads may hang.
    context = multiprocessing.get_context("spawn")
    try:
        pool = Pool(workers, mp_context=context, initializer=_start_worker)
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
    """Leave only the workers able to write results: one that ends halfway through would be read from for ever."""
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


def _start_worker() -> None:
    """Have a worker end with its parent, even one that is killed."""
    parent = multiprocessing.parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
