"""Run a study: every method on every draw of every case, one file of scores for each task."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, NamedTuple

import attrs

from tvsysid.errors import InputError
from tvsysid.progress import Progress, no_progress
from tvsysid.study.bootstraps import bootstraps_of, results_of_bootstraps
from tvsysid.study.dataset import write_results
from tvsysid.study.experiment import Experiment
from tvsysid.study.measure import TRUTH, Rows, Scores
from tvsysid.study.prepared import Prepared, prepared_recordings
from tvsysid.study.scenarios import Study
from tvsysid.study.tasks import Task, read_scores, run_task
from tvsysid.study.trials import results_of_trials, trials_of
from tvsysid.study.workers import run_tasks

if TYPE_CHECKING:
    import xarray as xr

OF_DRAW = (TRUTH, "other_seconds")  # scores that the methods of a draw share


def run(
    study: Study | Experiment,
    folder: str | Path | None = None,
    *,
    prepared: Sequence[Prepared] | None = None,
    workers: int | None = None,
    executor: Executor | None = None,
    progress: Progress = no_progress,
) -> xr.Dataset:
    """Run the tasks of a study that have no scores yet, and return the results of all.

    An interrupted study resumes when it is run again. The name of a task's file is a hash of all
    that its scores depend on, and the file appears when it is complete. Tasks in which a method
    failed are run again.

    Parameters
    ----------
    study
        A simulation study or an experiment.
    folder
        Where the scores of each task (``tasks/``) and the results (``results.nc``) are kept. None
        keeps the results in memory.
    prepared
        The recordings of an experiment as :func:`tvsysid.study.prepared_recordings` returns them;
        None prepares them first.
    workers
        Processes; None takes as many as there are cores, 1 works in this one. Each uses one thread.
        The results do not depend on it.
    executor
        Runs the tasks instead of local processes: that of a Dask cluster
        (``client.get_executor()``), of MPI, Ray or submitit. Then ``workers`` is the number of
        its workers.
    progress
        Called with the numbers of finished tasks and of all tasks, first before any is run.

    Returns
    -------
    xarray.Dataset
        Of a simulation study over (scenario, trial, method_key) and, where it applies, quantity,
        time, statistic (over the realizations of a trial) or pathway: ``estimate``,
        ``standard_error``, ``covered`` (whether the 95 % band holds the truth),
        ``time_varying_vaf``, ``vaf``, ``bandpassed_vaf`` (of the noiseless torque),
        ``pathway_vaf``, ``pathway_torque`` (of several pathways), ``parameters`` (their effective
        number), ``seconds``, ``other_seconds``, ``warnings``, ``failure`` (why there is no result,
        or nothing), and ``truth`` over (scenario, quantity, time), with ``trial_truth`` where it
        differs from trial to trial. Of methods that estimate something over a measured variable
        also ``scheduled_estimate``, ``scheduled_standard_error``, ``scheduling_variable`` over
        (scheduled, scheduling). Of an experiment over (recording, analysis), bootstrap, quantity
        and time: the same without bands, with VAFs of the torque recorded in the very realizations
        drawn; and over recording: numbers of realizations and trials, ``remarks``, and over time
        ``target_torque``, ``mean_torque`` and ``truth`` (NaN for people).

    Raises
    ------
    InputError
        If another process runs a study in the folder, a system cannot be simulated, an object
        cannot be sent to a worker, a worker dies, or what was prepared are not the experiment's
        recordings. A method that fails raises nothing: its results are NaN, and ``failure`` says
        why. Nor does a recording that cannot be used: ``remarks`` say so.

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
    if workers is not None and workers < 1:
        raise InputError(f"workers must be at least 1, got {workers!r}")
    work = _work(study, prepared)
    with ExitStack() as stack:
        kept = Path(stack.enter_context(TemporaryDirectory()) if folder is None else folder)
        stack.enter_context(_exclusive(kept))
        files = [kept / "tasks" / task.file_name for task in work.tasks]
        scores = {file: read_scores(file) for file in files}
        tasks = dict(zip(files, work.tasks, strict=True))
        missing = {file: task for file, task in tasks.items() if not _is_done(scores[file])}
        done = len(tasks) - len(missing)
        progress(done, len(tasks))
        finished = run_tasks(missing, workers, executor)
        for count, (file, measured) in enumerate(finished, start=done + 1):
            scores[file] = measured
            progress(count, len(tasks))
        rows = _rows(work.tasks, [scores[file] for file in files]) | work.failed
        results = work.assemble(rows)
        write_results(results, kept)
        return results


class Work(NamedTuple):
    """Tasks of a study, scores of what cannot be done, and the function that makes the results."""

    tasks: list[Task]
    failed: Rows
    assemble: Callable[[Rows], xr.Dataset]


def _work(study: Study | Experiment, prepared: Sequence[Prepared] | None) -> Work:
    if isinstance(study, Study):
        return Work(trials_of(study), {}, partial(results_of_trials, study))
    prepared = prepared_recordings(study) if prepared is None else prepared
    tasks, failed = bootstraps_of(study, prepared)
    return Work(tasks, failed, partial(results_of_bootstraps, study, prepared))


def _rows(tasks: Iterable[Task], scores: Iterable[Scores]) -> Rows:
    """Return scores by the place of case and draw, and of case, draw and method."""
    rows: Rows = {}
    for task, measured in zip(tasks, scores, strict=True):
        of_draw = {name for name in measured if name.partition("/")[0] in OF_DRAW}
        for number, draw in enumerate(task.draws):
            rows[task.row, draw] = {name: measured[name][number] for name in of_draw}
            for place, column in enumerate(task.columns):
                rows[task.row, draw, column] = {
                    name: values[number, place]
                    for name, values in measured.items()
                    if name not in of_draw
                }
    return rows


def _is_done(scores: Scores) -> bool:
    return "failure" in scores and not (scores["failure"] != "").any()


@contextmanager
def _exclusive(folder: Path) -> Iterator[None]:
    """Keep other processes from running a study in a folder."""
    from filelock import FileLock, Timeout  # noqa: PLC0415  # for studies only

    folder.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(folder / ".lock", timeout=0):
            yield
    except Timeout as error:
        raise InputError(
            f"{folder}: another process is running a study in this folder; wait for it, or give "
            "another folder"
        ) from error


@attrs.frozen
class Plan:
    """What a study will take.

    Parameters
    ----------
    identifications
        Their number: draws times methods.
    work_s
        Seconds that they take one process.
    size_bytes
        Size of the results.
    failures
        Why methods gave no result in the draws that were timed.
    """

    identifications: int
    work_s: float
    size_bytes: int
    failures: dict[str, str]


def plan(study: Study | Experiment, prepared: Sequence[Prepared] | None = None) -> Plan:
    """Estimate the time of a study from one draw of each case."""
    tasks = _work(study, prepared).tasks
    identifications, work, size = 0, 0.0, 0
    failures: dict[str, str] = {}
    run_task(_first_draw(tasks[-1]))  # loads what is lazy
    timed: dict[Hashable, list[Task]] = {}
    for task in tasks:
        timed.setdefault((task.row, *task.columns), []).append(task)
    for alike in timed.values():
        draws = sum(len(task.draws) for task in alike)
        started = time.perf_counter()
        scores = run_task(_first_draw(alike[0]))
        work += draws * (time.perf_counter() - started)
        size += draws * sum(values.nbytes for values in scores.values())
        identifications += draws * len(alike[0].columns)
        reasons = zip(alike[0].methods, map(str, scores["failure"][0]), strict=True)
        failures |= {label: reason for label, reason in reasons if reason}
    return Plan(identifications, work, size, failures)


def _first_draw(task: Task) -> Task:
    return attrs.evolve(task, draws=task.draws[:1])
