"""Run a study: every method on every draw of every case, one file of scores for each task."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import attrs

from tvsysid.errors import InputError
from tvsysid.numerics.threads import single_thread
from tvsysid.progress import Progress, no_progress
from tvsysid.study.bootstraps import Recordings
from tvsysid.study.dataset import read_results, write_results
from tvsysid.study.experiment import Experiment
from tvsysid.study.measure import Scores
from tvsysid.study.prepared import Prepared
from tvsysid.study.scenarios import Scenario, Study
from tvsysid.study.tasks import read_scores
from tvsysid.study.trials import Simulations
from tvsysid.study.workers import run_tasks

if TYPE_CHECKING:
    import xarray as xr

MAX_TIMED_S = 600.0  # seconds of data of a trial that is timed


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
        time, statistic (over the realizations of a trial), pathway or stage: ``estimate``,
        ``standard_error``, ``covered`` (whether the 95 % band holds the truth),
        ``time_varying_vaf``, ``vaf``, ``bandpassed_vaf`` (of the noiseless torque),
        ``pathway_vaf``, ``pathway_torque`` (of several pathways), ``parameters`` (their effective
        number), ``seconds``, ``stage_seconds``, ``warnings``, ``failure`` (why there is no result,
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
    source = Simulations(study) if isinstance(study, Study) else Recordings(study, prepared)
    with ExitStack() as stack:
        kept = Path(stack.enter_context(TemporaryDirectory()) if folder is None else folder)
        stack.enter_context(_exclusive(kept))
        tasks, files = source.tasks, {}
        for place, task in tasks.items():
            files[place] = kept / "tasks" / task.file_name
        scores = {place: read_scores(file) for place, file in files.items()}
        missing = {files[place]: tasks[place] for place in tasks if not _is_done(scores[place])}
        done = len(tasks) - len(missing)
        progress(done, len(tasks))
        for count, _ in enumerate(run_tasks(missing, workers, executor), start=done + 1):
            progress(count, len(tasks))
        for place, file in files.items():
            if file in missing:
                scores[place] = read_scores(file)
        write_results(
            source.results({place: each for place, each in scores.items() if each is not None}),
            kept,
        )
        return read_results(kept)


def _is_done(scores: Scores | None) -> bool:
    return scores is not None and not (scores["failure"] != "").any()


@contextmanager
def _exclusive(folder: Path) -> Iterator[None]:
    """Keep other processes from running a study in a folder, and remove unfinished files."""
    from filelock import FileLock, Timeout  # noqa: PLC0415  # for studies only

    folder.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(folder / ".lock", timeout=0):
            for leftover in (folder / "tasks").glob(".*.npz"):  # of a process that was killed
                leftover.unlink(missing_ok=True)
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
    trials
        Trials of all scenarios.
    simulated_s
        Seconds of data that they simulate.
    work_s
        Seconds that they take one process.
    size_bytes
        Size of the results.
    failures
        Why methods gave no result in the trials that were timed.
    """

    trials: int
    simulated_s: float
    work_s: float
    size_bytes: int
    failures: dict[str, str]


def plan(study: Study) -> Plan:
    """Estimate the time of a study from a trial of the shortest and one of the longest duration.

    The longest is timed with 600 s at most. Beside a fixed part, time is proportional to the
    duration. Scenarios with methods of their own are timed by themselves.
    """
    source, work, size, failures = Simulations(study), 0.0, 0.0, {}

    def timed(scenario: Scenario, methods: frozenset[str]) -> tuple[float, int]:
        started = time.perf_counter()
        with single_thread():
            scores = source.trial(scenario, 0, methods).scores()
        for label, text in zip(study.named_methods, scores["failure"].tolist(), strict=True):
            failures.update({label: text} if text else {})
        return time.perf_counter() - started, sum(each.nbytes for each in scores.values())

    groups: dict[frozenset[str], list[Scenario]] = {}
    for scenario, methods in study.methods_of.items():
        groups.setdefault(methods, []).append(scenario)
    shortest = min(study.scenarios, key=lambda scenario: scenario.duration_s)
    timed(shortest, study.methods_of[shortest])  # loads what is lazy
    for methods, scenarios in groups.items():
        durations = [scenario.duration_s for scenario in scenarios]
        ends = [min(durations), min(max(durations), MAX_TIMED_S)]
        (first, bytes_each), (last, _) = (
            timed(scenarios[0]._replace(duration_s=end), methods) for end in ends
        )
        span = ends[1] - ends[0]
        slope = max(0.0, (last - first) / span) if span else first / ends[0]
        work += sum(first + slope * (duration - ends[0]) for duration in durations)
        size += bytes_each * len(scenarios)
    simulated = sum(scenario.duration_s for scenario in study.scenarios) * study.trials
    trials = len(study.scenarios) * study.trials
    return Plan(trials, simulated, work * study.trials, round(size * study.trials), failures)
