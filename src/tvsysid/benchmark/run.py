"""Run a study: trials go to workers, and what comes back goes into the store."""

from __future__ import annotations

import multiprocessing
import os
import signal
import tempfile
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import closing, contextmanager, nullcontext
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from tvsysid.benchmark.store import Store, open_store, read_results
from tvsysid.benchmark.study import Study
from tvsysid.benchmark.trial import Outcome, Trial, all_failed, pickled, run_trial
from tvsysid.errors import InputError

if TYPE_CHECKING:
    import xarray as xr

AHEAD = 2
"""Trials that wait for each worker: enough to keep it busy; more would only take memory."""
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
        results = read_results(path)
        return results.load() if store is None else results


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
    numbers = {scenario: number for number, scenario in enumerate(study.scenarios)}
    trials = [
        Trial(study.scenarios[place], number, study.seed_of(study.scenarios[place], number), methods)
        for place, number in places
    ]
    done = total - len(trials)
    if progress is not None:
        progress(done, total)
    # Closed at once if writing fails, so that no worker goes on in vain.
    with closing(_outcomes(trials, workers, executor)) as outcomes:
        for trial, outcome in outcomes:
            store.write(numbers[trial.scenario], trial.number, outcome)
            done += 1
            if progress is not None:
                progress(done, total)


def _outcomes(trials: list[Trial], workers: int | None, executor: Executor | None) -> Generator[tuple[Trial, Outcome]]:
    if executor is not None:
        try:
            yield from _from(executor, trials, workers or int(getattr(executor, "_max_workers", UNKNOWN_WORKERS)))
        except BrokenExecutor as error:
            raise InputError(
                f"run: the executor gave up: {error}; what was finished is kept in the store; the same call goes on"
            ) from error
        return
    workers = min(workers or os.cpu_count() or 1, len(trials))
    if workers <= 1:
        yield from ((trial, run_trial(trial)) for trial in trials)
    else:
        yield from _from_processes(trials, workers)


def _from(executor: Executor, trials: Sequence[Trial], workers: int) -> Iterator[tuple[Trial, Outcome]]:
    """Outcomes as they come; never more than a few trials are under way."""
    queue = iter(trials)
    pending: dict[Future[Outcome], Trial] = {}
    try:
        while True:
            for trial in islice(queue, (1 + AHEAD) * workers - len(pending)):
                pending[executor.submit(run_trial, trial)] = trial
            if not pending:
                return
            done, _ = wait(pending, return_when=FIRST_COMPLETED)
            for future in done:
                trial = pending[future]
                try:
                    outcome = future.result()
                except (BrokenExecutor, InputError):
                    raise
                except Exception as error:
                    reason = f"the worker failed: {type(error).__name__}: {error}"
                    outcome = all_failed(len(trial.methods), reason)
                del pending[future]
                yield trial, outcome
    finally:
        for future in pending:
            future.cancel()


def _from_processes(trials: list[Trial], workers: int) -> Iterator[tuple[Trial, Outcome]]:
    """Outcomes from local processes; where one dies, its trials are run again, each by itself."""
    left = {(trial.scenario, trial.number): trial for trial in trials}
    killers: dict[str, str] = {}
    while left:
        under_way = [replace(trial, left_out=killers) for trial in left.values()]
        try:
            with _processes(min(workers, len(left))) as pool:
                for trial, outcome in _from(pool, under_way, workers):
                    yield trial, outcome
                    del left[trial.scenario, trial.number]
        except BrokenExecutor:
            # It was one of those under way, the first ones left; the others among them only shared its pool.
            for place, trial in list(left.items())[: (1 + AHEAD) * workers]:
                yield trial, _alone(trial, killers)
                del left[place]


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
    with _processes(1) as pool:
        return pool.submit(run_trial, trial).result()


@contextmanager
def _processes(workers: int) -> Iterator[ProcessPoolExecutor]:
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
