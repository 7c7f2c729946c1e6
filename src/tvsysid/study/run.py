"""Run a study, read what one left, and say beforehand what one will take."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import attrs

from tvsysid.errors import InputError
from tvsysid.progress import Progress, no_progress
from tvsysid.study.contents import EXPERIMENT
from tvsysid.study.prepared import Prepared
from tvsysid.study.recorded import Experiment
from tvsysid.study.simulated import Scenario, Study
from tvsysid.study.source import Simulations, recordings_in, source_of, with_recordings
from tvsysid.study.store import open_store, stored
from tvsysid.study.task import carry_out
from tvsysid.study.workers import carry_out_missing

if TYPE_CHECKING:
    import xarray as xr

LONGEST_S = 600.0  # seconds of data beyond which nothing is timed


def run(
    study: Study | Experiment,
    *,
    prepared: Sequence[Prepared] | None = None,
    store: str | Path | None = None,
    workers: int | None = None,
    executor: Executor | None = None,
    progress: Progress = no_progress,
) -> xr.Dataset:
    """Run a study, or what is missing of it, and collect what its metrics are made from.

    Parameters
    ----------
    study
        What to run: a simulation study or an experiment.
    prepared
        The recordings of an experiment as :func:`tvsysid.study.prepared_recordings` gives them;
        None prepares them first.
    store
        Zarr store for the results. Each trial of a simulation study is written when it is done; of
        an experiment, all bootstraps of one method, number of realizations and recording. A store
        of the same study is resumed: only what is missing, cut short or failed is run, and
        recordings whose data are others than before. None keeps the results in memory.
    workers
        Processes; None takes as many as there are cores, 1 works in this one. Each uses one thread.
        The results do not depend on it.
    executor
        Runs the tasks in place of local processes: that of a Dask cluster
        (``client.get_executor()``), of MPI, Ray or submitit. Then ``workers`` is the number of
        tasks that it runs at a time.
    progress
        Called with the numbers of tasks there and in all, first before any is run.

    Returns
    -------
    xarray.Dataset
        Read from the store; more than 1 GB when it is used. Of a simulation study over (scenario,
        trial, method_key) and, where it applies, quantity, time, statistic (over the realizations
        of a trial), pathway or stage: ``estimate``, ``standard_error``, ``covered`` (whether the 95
        % band holds the truth), ``time_varying_vaf``, ``vaf``, ``bandpassed_vaf`` (against the
        noiseless torque), ``pathway_vaf``, ``pathway_torque`` (of several pathways), ``parameters``
        (their effective number), ``seconds``, ``stage_seconds``, ``warnings``, ``failure`` (why
        there is no result, or nothing), and ``truth`` over (scenario, quantity, time), with
        ``trial_truth`` where it differs from trial to trial. Of methods that estimate something
        over a variable of their own also ``scheduled_estimate``, ``scheduled_standard_error``,
        ``scheduling_variable`` over (scheduled, scheduling). Of an experiment over (recording,
        analysis), bootstrap, quantity and time: the same without standard errors, with VAFs of the
        torque recorded in the very realizations drawn; and over recording: numbers of realizations
        and trials, ``remarks``, and over time ``target_torque``, ``mean_torque`` and ``truth`` (NaN
        for people).

    Raises
    ------
    InputError
        If the store holds something else, a method cannot be sent to a worker, the executor gives
        up, or what was prepared are not the experiment's recordings. A method that fails raises
        nothing: its results are NaN, and ``failure`` says why. Nor does a recording that cannot be
        used: ``remarks`` say so.

    Warns
    -----
    DataQualityWarning
        If recordings are others than those in the store.

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
    source = source_of(study, prepared)
    with tempfile.TemporaryDirectory() if store is None else nullcontext(store) as folder:
        path = Path(folder) / "results.zarr" if store is None else Path(folder)
        with open_store(path, source.layout) as opened:
            source.begin(opened)
            carry_out_missing(opened, source, workers, executor, progress)
            results = source.completed(opened.results())
        return results.load() if store is None else results


def read_results(path: str | Path) -> xr.Dataset:
    """Load the results of a study of either kind, finished or not.

    They are those of :func:`tvsysid.study.run`; the attribute ``title`` says of which kind. Every
    file is verified before it is used, and what tasks left that did not finish is NaN: neither can
    be said of ``xarray.open_zarr``.

    Raises
    ------
    InputError
        If the folder is not such a store, or files of it are missing, cut short or damaged; the
        message says how they are made again.
    """
    store = stored(Path(path))
    results = store.results()
    if results.attrs["title"] != EXPERIMENT:
        return results
    return with_recordings(results, recordings_in(store, results))


@attrs.frozen
class Plan:
    """What a study will take.

    Trials of all scenarios, the seconds of data that they simulate, the seconds that they take
    one process, the size of the results; and methods that gave no result in the trials that were
    timed, and why.
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
    source, work = Simulations(study), 0.0
    alike: dict[frozenset[str], list[Scenario]] = {}
    for scenario, methods in study.methods_of.items():
        alike.setdefault(methods, []).append(scenario)
    failures: dict[str, str] = {}
    carry_out(
        source.trial(min(study.scenarios, key=lambda scenario: scenario.duration_s), 0)
    )  # loads what is lazy
    for scenarios in alike.values():
        scenarios.sort(key=lambda scenario: scenario.duration_s)
        ends = [
            end._replace(duration_s=min(end.duration_s, LONGEST_S))
            for end in (scenarios[0], scenarios[-1])
        ]
        taken: list[float] = []
        for scenario, own in zip(ends, (scenarios[0], scenarios[-1]), strict=True):
            started = time.perf_counter()
            outcome = carry_out(source.trial(scenario, 0, study.methods_of[own]))
            taken.append(time.perf_counter() - started)
            failures |= {
                label: str(text)
                for label, text in zip(study.named_methods, outcome["failure"], strict=True)
                if text
            }
        span = ends[1].duration_s - ends[0].duration_s
        slope = max(0.0, (taken[1] - taken[0]) / span) if span else taken[0] / ends[0].duration_s
        work += sum(
            taken[0] + slope * (scenario.duration_s - ends[0].duration_s) for scenario in scenarios
        )
    simulated = sum(scenario.duration_s for scenario in study.scenarios) * study.trials
    return Plan(
        len(study.scenarios) * study.trials,
        simulated,
        work * study.trials,
        source.layout.bytes_of_numbers,
        failures,
    )
