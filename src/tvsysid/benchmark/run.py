"""Run a study: trials go to workers, and what comes back goes into the store."""

from __future__ import annotations

import multiprocessing
import os
import signal
import tempfile
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import closing, contextmanager, nullcontext
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from tvsysid.benchmark.store import Store, open_store
from tvsysid.benchmark.study import Study
from tvsysid.benchmark.trial import Outcome, Trial, all_failed, pickled, run_trial
from tvsysid.errors import InputError

if TYPE_CHECKING:
    import xarray as xr

AHEAD = 2
"""Trials that wait for each worker: enough to keep it busy; more would only take memory."""
Place = tuple[int, int]
"""Numbers of scenario and trial."""
UNKNOWN_WORKERS = 32
"""Workers assumed of an executor that does not say how many it has."""


def run(
    study: Study,
    *,
    store: str | Path | None = None,
    workers: int | None = None,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> xr.Dataset:
    """Run a study, or what is missing of it, and collect what its metrics are made from.

    Parameters
    ----------
    study
        What to run.
    store
        Zarr store for the results. Each trial is written when it is done. A store of the same study is gone on with:
        only trials that are missing, cut short or failed are run. None keeps the results in memory.
    workers
        Processes; None takes as many as there are cores, 1 works in this one. Each uses one thread. The results do not
        depend on it.
    executor
        Runs the trials in place of local processes: that of a Dask cluster (``client.get_executor()``), of MPI, Ray or
        submitit. Then ``workers`` is the number of trials that it runs at a time.
    progress
        Called with the numbers of trials there and in all, first before any is run.

    Returns
    -------
    xarray.Dataset
        Over (scenario, trial, method_key) and, where it applies, time, statistic (over the realizations of a trial) or
        stage: ``stiffness``, ``time_varying_vaf``, ``vaf`` and ``bandpassed_vaf`` (against the noiseless torque),
        ``parameters`` (their effective number), ``seconds`` and ``stage_seconds`` (time taken), ``doubts`` (the
        warnings met, or nothing), ``failure`` (why there is no result, or nothing), and ``true_stiffness`` over
        (scenario, time). Read from the store when used.

    Raises
    ------
    InputError
        If the store holds something else, a method cannot be sent to a worker, or the executor gives up. A method that
        fails raises nothing: its results are NaN, and ``failure`` says why.

    Examples
    --------
    >>> results = run(Study(duration_s=40, trials=2, methods="sds"), workers=1)
    >>> dict(results.stiffness.sizes)
    {'scenario': 2, 'trial': 2, 'method_key': 1, 'time': 200}
    """
    if workers is not None and workers < 1:
        raise InputError(f"workers must be at least 1, got {workers!r}")
    methods = pickled(study.named_methods)
    with tempfile.TemporaryDirectory() if store is None else nullcontext(store) as folder:
        path = Path(folder) / "results.zarr" if store is None else Path(folder)
        with open_store(path, study) as opened:
            _run_missing(study, methods, opened, workers, executor, progress)
            results = opened.results()
        return results.load() if store is None else results


def cores() -> int:
    """Cores that this process may use; a job on a cluster may have fewer than the machine."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _run_missing(
    study: Study,
    methods: dict[str, bytes],
    store: Store,
    workers: int | None,
    executor: Executor | None,
    progress: Callable[[int, int], None] | None,
) -> None:
    total = len(study.scenarios) * study.trials
    places = store.missing()
    done = total - len(places)

    def trial_at(place: Place) -> Trial:
        scenario = study.scenarios[place[0]]
        return Trial(scenario, place[1], study.seed_of(scenario, place[1]), methods)

    if progress is not None:
        progress(done, total)
    # Closed at once if writing fails, so that no worker goes on in vain.
    with closing(_outcomes(trial_at, places, workers, executor)) as outcomes:
        for place, outcome in outcomes:
            store.write(*place, outcome)
            done += 1
            if progress is not None:
                progress(done, total)


def _outcomes(
    trial_at: Callable[[Place], Trial], places: list[Place], workers: int | None, executor: Executor | None
) -> Generator[tuple[Place, Outcome]]:
    if executor is not None:
        at_a_time = workers or int(getattr(executor, "_max_workers", UNKNOWN_WORKERS))
        try:
            yield from _from(executor, trial_at, places, at_a_time)
        except (BrokenExecutor, CancelledError) as error:
            raise InputError(
                f"run: the executor gave up ({type(error).__name__}: {error}); what was finished is kept in the store, "
                "and the same call goes on from there"
            ) from error
        return
    workers = workers or cores()
    if workers == 1:
        yield from ((place, run_trial(trial_at(place))) for place in places)
    else:
        yield from _from_processes(trial_at, places, workers)


def _from(
    executor: Executor, trial_at: Callable[[Place], Trial], places: Iterable[Place], workers: int
) -> Generator[tuple[Place, Outcome]]:
    """Outcomes as they come; never more than a few trials are under way."""
    queue = iter(places)
    pending: dict[Future[Outcome], Place] = {}
    try:
        while True:
            for place in islice(queue, (1 + AHEAD) * workers - len(pending)):
                pending[_submit(executor, trial_at(place))] = place
            if not pending:
                return
            done, _ = wait(pending, return_when=FIRST_COMPLETED)
            for future in done:
                try:
                    outcome = future.result()
                except (BrokenExecutor, CancelledError, InputError):
                    raise
                except Exception as error:
                    reason = f"the worker failed: {type(error).__name__}: {error}"
                    outcome = all_failed(len(trial_at(pending[future]).methods), reason)
                yield pending.pop(future), outcome
    finally:
        for future in pending:
            future.cancel()


def _submit(executor: Executor, trial: Trial) -> Future[Outcome]:
    try:
        return executor.submit(run_trial, trial)
    except RuntimeError as error:  # it was shut down
        raise BrokenExecutor(str(error)) from error


def _from_processes(
    trial_at: Callable[[Place], Trial], places: list[Place], workers: int
) -> Generator[tuple[Place, Outcome]]:
    """Outcomes from local processes; where one dies, its trials are run again, each by itself."""
    left = dict.fromkeys(places)
    killers: dict[str, str] = {}

    def without_killers(place: Place) -> Trial:
        return replace(trial_at(place), left_out=dict(killers))

    while left:
        try:
            with processes(min(workers, len(left))) as pool:
                for place, outcome in _from(pool, without_killers, list(left), workers):
                    del left[place]
                    yield place, outcome
        except BrokenExecutor:
            # It was one of those under way, the first ones left; the others among them only shared its pool.
            for place in list(left)[: (1 + AHEAD) * workers]:
                del left[place]
                yield place, _alone(trial_at(place), killers)


def _alone(trial: Trial, killers: dict[str, str]) -> Outcome:
    """Outcome of a trial in a process of its own; a method that kills it is found, marked and not tried again."""
    labels = list(trial.methods)
    while True:
        try:
            return _in_one_process(replace(trial, left_out=dict(killers)))
        except BrokenExecutor:
            for label in labels:
                if label in killers:
                    continue
                others = dict.fromkeys((other for other in labels if other != label), "not tried")
                try:
                    _in_one_process(replace(trial, left_out=others))
                except BrokenExecutor:
                    killers[label] = (
                        f"its worker process died in {trial}, so it was not tried again: it crashed, or took more "
                        "memory than there is"
                    )
                    break
            else:
                return all_failed(len(labels), "the worker process died, though each method by itself does not kill it")


def _in_one_process(trial: Trial) -> Outcome:
    with processes(1) as pool:
        return pool.submit(run_trial, trial).result()


@contextmanager
def processes(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Local worker processes that end with this one, and leave an interruption to it.

    Raises
    ------
    InputError
        If they do not start.
    """
    # A fresh interpreter for each worker: forking one with BLAS and progress threads may hang.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_start_worker)
    try:
        # Each waiting task starts a worker, which inherits that it leaves an interruption to this process.
        with _interruptions_ignored():
            first = [pool.submit(os.getpid) for _ in range(workers)]
        try:
            wait(first)
            first[0].result()
        except BrokenExecutor as error:
            raise InputError(
                "run: the worker processes did not start. A script must call run from under "
                "`if __name__ == '__main__':`, because each worker imports it; or give workers=1"
            ) from error
        yield pool
    except (KeyboardInterrupt, GeneratorExit):
        # Nobody waits for what is under way any more, least of all for a method that hangs.
        for process in list((pool._processes or {}).values()):
            process.terminate()
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


def _start_worker() -> None:
    """Have a worker end with its parent, even one that is killed."""
    parent = multiprocessing.parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()
