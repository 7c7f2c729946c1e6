"""Run a study, and read what one left: tasks go to workers, and what comes back goes into the store."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from tvsysid.errors import InputError
from tvsysid.study.contents import EXPERIMENT, NUMBERS
from tvsysid.study.prepared import Prepared
from tvsysid.study.recorded import Experiment
from tvsysid.study.simulated import Study
from tvsysid.study.source import recordings_in, source_of, with_recordings
from tvsysid.study.store import open_store, read_store
from tvsysid.study.workers import carry_out_missing

if TYPE_CHECKING:
    import xarray as xr


def run(
    study: Study | Experiment,
    *,
    prepared: Sequence[Prepared] | None = None,
    store: str | Path | None = None,
    workers: int | None = None,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> xr.Dataset:
    """Run a study, or what is missing of it, and collect what its metrics are made from.

    Parameters
    ----------
    study
        What to run: a simulation study or an experiment.
    prepared
        The recordings of an experiment as :func:`tvsysid.study.prepared_recordings` gives them; None prepares them
        first.
    store
        Zarr store for the results. Each trial of a simulation study is written when it is done; of an experiment, all
        bootstraps of one method, number of realizations and recording. A store of the same study is resumed: only what
        is missing, cut short or failed is run, and recordings whose data are others than before. None keeps the
        results in memory.
    workers
        Processes; None takes as many as there are cores, 1 works in this one. Each uses one thread. The results do not
        depend on it.
    executor
        Runs the tasks in place of local processes: that of a Dask cluster (``client.get_executor()``), of MPI, Ray or
        submitit. Then ``workers`` is the number of tasks that it runs at a time.
    progress
        Called with the numbers of tasks there and in all, first before any is run.

    Returns
    -------
    xarray.Dataset
        Read from the store when used. Of a simulation study over (scenario, trial, method_key) and, where it applies,
        quantity, time, statistic (over the realizations of a trial), pathway or stage: ``estimate``, ``standard_error``
        and ``covered`` (whether the 95 % band holds the truth), ``time_varying_vaf``, ``vaf`` and ``bandpassed_vaf``
        (against the noiseless torque), ``pathway_vaf`` (where there are several pathways), ``parameters`` (their
        effective number), ``seconds`` and ``stage_seconds`` (time taken), ``warnings`` (those met, or nothing),
        ``failure`` (why there is no result, or nothing), and ``truth`` over (scenario, quantity, time); where it
        differs from trial to trial, also ``trial_truth``. Of an experiment over (recording, analysis), bootstrap,
        quantity and time: the same without standard errors, with VAFs of the torque recorded in the very realizations
        drawn; and over recording: numbers of realizations and trials, ``remarks``, and over time ``target_torque``,
        ``mean_torque`` and ``truth`` (NaN for people).

    Raises
    ------
    InputError
        If the store holds something else, a method cannot be sent to a worker, the executor gives up, or what was
        prepared are not the experiment's recordings. A method that fails raises nothing: its results are NaN, and
        ``failure`` says why. Nor does a recording that cannot be used: ``remarks`` say so.

    Warns
    -----
    DataQualityWarning
        If recordings are others than those in the store.

    Examples
    --------
    >>> results = run(Study(duration_s=40, trials=2, methods="sds"), workers=1)
    >>> dict(results.estimate.sizes)
    {'scenario': 2, 'trial': 2, 'method_key': 1, 'quantity': 3, 'time': 200}
    >>> experiment = Experiment(virtual=1, perturbation="noise", methods="birf", realizations=75, bootstraps=5)
    >>> run(experiment, workers=1).estimate.sel(quantity="stiffness").shape
    (1, 1, 5, 256)
    """
    if workers is not None and workers < 1:
        raise InputError(f"workers must be at least 1, got {workers!r}")
    source = source_of(study, prepared)
    with tempfile.TemporaryDirectory() if store is None else nullcontext(store) as folder:
        path = Path(folder) / "results.zarr" if store is None else Path(folder)
        with open_store(path, source.layout) as opened:
            source.begin(opened)
            carry_out_missing(opened, source.task_at, workers, executor, progress)
            results = source.completed(opened.results())
        return results.load() if store is None else results


def read_results(path: str | Path) -> xr.Dataset:
    """Results of a study of either kind from its store, finished or not.

    Parameters
    ----------
    path
        Folder of the store.

    Returns
    -------
    xarray.Dataset
        As of :func:`tvsysid.study.run`; read from the disk when it is used. The attribute ``title`` says of which
        kind.

    Raises
    ------
    InputError
        If the folder is not such a store, or files of it are cut short or damaged.
    """
    results = read_store(path, NUMBERS)
    if results.attrs["title"] != EXPERIMENT:
        return results
    return with_recordings(results, recordings_in(Path(path)))
