"""Run a study: trials go to workers, and what comes back goes into the store."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from tvsysid.benchmark.layout import NUMBER, TITLE, layout_of
from tvsysid.benchmark.study import Study
from tvsysid.benchmark.trial import Trial
from tvsysid.errors import InputError
from tvsysid.execution import Place, carry_out_missing, open_store, pickled, read_store

if TYPE_CHECKING:
    import xarray as xr


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

    def trial_at(place: Place) -> Trial:
        scenario = study.scenarios[place[0]]
        return Trial(scenario, place[1], study.seed_of(scenario, place[1]), methods)

    with tempfile.TemporaryDirectory() if store is None else nullcontext(store) as folder:
        path = Path(folder) / "results.zarr" if store is None else Path(folder)
        with open_store(path, layout_of(study)) as opened:
            carry_out_missing(opened, trial_at, workers, executor, progress)
            results = opened.results()
        return results.load() if store is None else results


def read_results(path: str | Path) -> xr.Dataset:
    """Results of a study from its store, finished or not.

    Parameters
    ----------
    path
        Folder of the store.

    Returns
    -------
    xarray.Dataset
        As of :func:`tvsysid.benchmark.run`; read from the disk when it is used.

    Raises
    ------
    InputError
        If the folder is not such a store, or files of it are cut short or damaged.
    """
    return read_store(path, TITLE, NUMBER)
