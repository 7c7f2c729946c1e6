"""Run an experimental study: recordings are prepared once, their bootstraps go to workers."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from tvsysid.errors import InputError
from tvsysid.execution import Place, carry_out_missing, open_store, pickled, read_store
from tvsysid.experiment.analysis import DrawsTask
from tvsysid.experiment.experiment import Experiment
from tvsysid.experiment.layout import NUMBER, TITLE, layout_of
from tvsysid.experiment.prepared import Prepared, prepared_recordings

if TYPE_CHECKING:
    import xarray as xr


def run(
    experiment: Experiment,
    *,
    prepared: Sequence[Prepared] | None = None,
    store: str | Path | None = None,
    workers: int | None = None,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> xr.Dataset:
    """Run an experiment, or what is missing of it.

    Parameters
    ----------
    experiment
        What to run.
    prepared
        Its recordings as :func:`prepared_recordings` gives them; None prepares them first.
    store
        Zarr store for the results. All bootstraps of one method, number of realizations and recording are written when
        they are done. A store of the same experiment on the same data is gone on with. None keeps the results in
        memory.
    workers, executor
        As of :func:`tvsysid.benchmark.run`.
    progress
        Called with the numbers of analyses there and in all, first before any is run.

    Returns
    -------
    xarray.Dataset
        Over (recording, analysis), bootstrap and time: ``stiffness`` and ``time_varying_vaf``; over bootstraps
        ``vaf`` and ``bandpassed_vaf`` (of the torque recorded in the very realizations drawn) and ``parameters``;
        ``seconds``, ``doubts`` and ``failure``. Over recording: numbers of realizations and trials, ``remarks``, and
        over time ``target_torque``, ``mean_torque`` and ``true_stiffness`` (NaN for people).

    Raises
    ------
    InputError
        If the store holds something else, a method cannot be sent to a worker, or the executor gives up. A recording
        that cannot be used raises nothing: it is told in ``remarks``, and the others go on.

    Examples
    --------
    >>> experiment = Experiment(virtual=1, perturbation="noise", methods="birf", realizations=75, bootstraps=5)
    >>> run(experiment, workers=1).stiffness.shape
    (1, 1, 5, 256)
    """
    if workers is not None and workers < 1:
        raise InputError(f"workers must be at least 1, got {workers!r}")
    methods = pickled(experiment.named_methods)
    ready = prepared_recordings(experiment) if prepared is None else prepared
    layout = layout_of(experiment, ready)

    def task_at(place: Place) -> DrawsTask:
        item, analysis = ready[place[0]], experiment.analyses[place[1]]
        return DrawsTask(
            label=f"{analysis.label} of {item.recorded.label}",
            ensemble=item.ensemble,
            samples=layout.lengths["time"],
            realizations=analysis.realizations,
            contiguous=analysis.contiguous,
            bootstraps=experiment.bootstraps,
            seed=experiment.seed_of(item.recorded, analysis.realizations),
            methods={analysis.name: methods[analysis.name]},
            reason=item.failure,
        )

    with tempfile.TemporaryDirectory() if store is None else nullcontext(store) as folder:
        path = Path(folder) / "results.zarr" if store is None else Path(folder)
        with open_store(path, layout) as opened:
            carry_out_missing(opened, task_at, workers, executor, progress)
            results = opened.results()
        return results.load() if store is None else results


def read_results(path: str | Path) -> xr.Dataset:
    """Results of an experiment from its store, finished or not.

    Parameters
    ----------
    path
        Folder of the store.

    Returns
    -------
    xarray.Dataset
        As of :func:`run`; read from the disk when it is used.

    Raises
    ------
    InputError
        If the folder is not such a store, or files of it are cut short or damaged.
    """
    return read_store(path, TITLE, NUMBER)
