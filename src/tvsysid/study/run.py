"""Run the tasks of a study, keep a file of scores for each, and collect the results."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from timeit import timeit
from typing import TYPE_CHECKING

import attrs

from tvsysid.errors import InputError
from tvsysid.progress import Progress, no_progress
from tvsysid.study import bootstraps, trials
from tvsysid.study.bootstraps import Prepared, prepared_recordings
from tvsysid.study.dataset import write_results
from tvsysid.study.experiment import Experiment
from tvsysid.study.measure import Scores
from tvsysid.study.scenarios import Study
from tvsysid.study.tasks import Task, read_scores, run_task, write_scores
from tvsysid.study.workers import cores, local_workers, run_tasks

if TYPE_CHECKING:
    import xarray as xr


def run(
    study: Study | Experiment,
    folder: str | Path | None = None,
    *,
    prepared: Sequence[Prepared] = (),
    workers: int | None = None,
    executor: Executor | None = None,
    progress: Progress = no_progress,
) -> xr.Dataset:
    """Run the tasks of a study that have no scores yet, and return the results of all.

    An interrupted study resumes when it is run again. The name of a task's file is a hash of all
    that its scores depend on, and the file appears when it is complete.

    Parameters
    ----------
    study
        A simulation study or an experiment.
    folder
        Where the scores of each task (``tasks/``) and the results (``results.nc``) are kept. None
        keeps the results in memory.
    prepared
        The recordings of an experiment as :func:`tvsysid.study.prepared_recordings` returns them.
        If empty, they are prepared here.
    workers
        Processes; None takes as many as there are cores, 1 works in this one. Each uses one thread.
        The results do not depend on it.
    executor
        Runs the tasks instead of local processes: that of a Dask cluster
        (``client.get_executor()``), of MPI, Ray or submitit.
    progress
        Called with the numbers of finished tasks and of all tasks, first before any is run.

    Returns
    -------
    xarray.Dataset
        A simulation study has results over (scenario, trial, method_key) and, where it applies,
        quantity, time or pathway: ``estimate``, ``covered`` (whether the 95 % band holds the
        truth), ``time_varying_vaf``, ``vaf``, ``bandpassed_vaf`` (of the noiseless torque, means
        over realizations), ``pathway_vaf`` (of several pathways), ``seconds``, ``warnings`` and
        ``failure`` (empty, or why there is no result). ``truth`` has (scenario, quantity, time).
        ``trial_truth`` is there if the truth differs from trial to trial.

        An experiment has the same over (recording, analysis), bootstrap, quantity and time, without
        bands. Its VAFs are of the recorded torque. Over recording, it has numbers of realizations,
        ``remarks`` and, over time, ``target_torque``, ``mean_torque`` and ``truth`` (NaN for
        people).

    Raises
    ------
    InputError
        If another process runs a study in the folder, a system cannot be simulated, an object
        cannot be sent to a worker, a worker dies, or no recording can be used. A method that fails
        raises nothing: its results are NaN, and ``failure`` gives the reason. One recording that
        cannot be used raises nothing: ``remarks`` gives the reason.

    Examples
    --------
    >>> results = run(Study(duration_s=40, trials=2, methods="sds"), workers=1)
    >>> dict(results.estimate.sizes)
    {'scenario': 2, 'trial': 2, 'method_key': 1, 'quantity': 3, 'time': 200}
    >>> experiment = Experiment(
    ...     virtual=1, perturbation="noise", methods="birf", realizations=75, bootstraps=5)
    >>> run(experiment, workers=1).estimate.sel(quantity="stiffness").shape
    (1, 1, 5, 256)
    """
    from filelock import FileLock, Timeout  # noqa: PLC0415  # for studies only

    tasks, results_of = _work(study, prepared)
    with ExitStack() as stack:
        root = Path(stack.enter_context(TemporaryDirectory()) if folder is None else folder)
        root.mkdir(parents=True, exist_ok=True)
        try:
            stack.enter_context(FileLock(root / ".lock", timeout=0))
        except Timeout as error:
            raise InputError(
                f"{root}: another process is running a study in this folder; wait for it, or give "
                "another folder"
            ) from error
        files = {root / "tasks" / task.file_name: task for task in tasks}
        scores = {file: found for file in files if (found := read_scores(file))}
        progress(len(scores), len(files))
        missing = {file: task for file, task in files.items() if file not in scores}
        count = min(workers or cores(), len(missing))
        if executor is None:
            executor = stack.enter_context(local_workers(count))
        for file, measured in stack.enter_context(closing(run_tasks(missing, executor, count))):
            write_scores(measured, file)
            scores[file] = measured
            progress(len(scores), len(files))
        results = results_of((task, scores[file]) for file, task in files.items())
        write_results(results, root)
        return results


def _work(
    study: Study | Experiment, prepared: Sequence[Prepared]
) -> tuple[list[Task], Callable[[Iterable[tuple[Task, Scores]]], xr.Dataset]]:
    """Return the tasks of a study, and the function that makes results of their scores."""
    if isinstance(study, Study):
        return trials.tasks_of(study), partial(trials.results_of, study)
    prepared = prepared or prepared_recordings(study)
    counts = [len(each.ensemble) for each in prepared if each.ensemble]
    if study.max_realizations is None:
        study = attrs.evolve(study, max_realizations=min(counts, default=None))
    return bootstraps.tasks_of(study, prepared), partial(bootstraps.results_of, study, prepared)


def estimate_duration(
    study: Study | Experiment, prepared: Sequence[Prepared] = ()
) -> tuple[list[str], int, float]:
    """Return the methods, the number of identifications, and the seconds that a study takes.

    The seconds are those of one process. They are extrapolated from one draw of each case.
    """
    tasks, _ = _work(study, prepared)
    first = {(task.case, *task.methods): attrs.evolve(task, draws=task.draws[:1]) for task in tasks}
    run_task(next(iter(first.values())))  # loads lazy modules before the timing
    seconds = {kind: timeit(partial(run_task, task), number=1) for kind, task in first.items()}
    return (
        [*dict.fromkeys(label for task in tasks for label in task.methods)],
        sum(len(task.draws) * len(task.methods) for task in tasks),
        sum(len(task.draws) * seconds[task.case, *task.methods] for task in tasks),
    )
