"""Run an experimental study: recordings are prepared once, their bootstraps go to workers."""

from __future__ import annotations

import json
import tempfile
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.execution import Place, carry_out_missing, open_store, pickled, read_store
from tvsysid.experiment.analysis import DrawsTask
from tvsysid.experiment.experiment import Experiment
from tvsysid.experiment.layout import NUMBER, TITLE, layout_of, of_recordings
from tvsysid.experiment.prepared import Prepared, prepared_recordings
from tvsysid.recordings import whole_file

if TYPE_CHECKING:
    import xarray as xr

RECORDINGS = "recordings.nc"
"""File in the store that holds what became of each recording."""


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
        they are done. A store of the same experiment is gone on with; recordings whose data are others than before are
        identified again. None keeps the results in memory.
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
        If what was prepared are not the experiment's recordings, the store holds something else, a method cannot be
        sent to a worker, or the executor gives up. A recording that cannot be used raises nothing: it is told in
        ``remarks``, and the others go on.

    Warns
    -----
    DataQualityWarning
        If recordings are others than those in the store.

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
    if [item.recorded for item in ready] != list(experiment.recordings):
        given = ", ".join(item.recorded.label for item in ready)
        raise InputError(
            f"run: the recordings prepared are not the experiment's: {given}; give what "
            "prepared_recordings(experiment) returns"
        )
    layout = layout_of(experiment)

    def task_at(place: Place) -> DrawsTask:
        item, analysis = ready[place[0]], experiment.analyses[place[1]]
        return DrawsTask(
            label=f"{analysis.label} of {item.recorded.label}",
            ensemble=item.ensemble,
            digest=item.digest,
            samples=layout.lengths["time"],
            realizations=analysis.realizations,
            contiguous=analysis.contiguous,
            bootstraps=experiment.bootstraps,
            seed=experiment.seed_of(item.recorded, analysis.realizations),
            # A method may die of one recording alone.
            methods={f"{analysis.name} on {item.recorded.label}": methods[analysis.name]},
            reason=item.failure,
        )

    with tempfile.TemporaryDirectory() if store is None else nullcontext(store) as folder:
        path = Path(folder) / "results.zarr" if store is None else Path(folder)
        with open_store(path, layout) as opened:
            changed = opened.forget_unless("digest", lambda place: ready[place[0]].digest)
            labels = list(dict.fromkeys(ready[place[0]].recorded.label for place in changed))
            if labels:
                warnings.warn(
                    f"not the data that were identified before: {', '.join(labels)}; identified again",
                    DataQualityWarning,
                    stacklevel=2,
                )
            known = of_recordings(experiment, ready)
            with whole_file(path / RECORDINGS) as file:
                known.to_netcdf(file, engine="h5netcdf")
            carry_out_missing(opened, task_at, workers, executor, progress)
            results = with_recordings(opened.results(), known)
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
    import xarray as xr  # noqa: PLC0415  # heavy

    results = read_store(path, TITLE, NUMBER)
    try:
        with xr.open_dataset(Path(path) / RECORDINGS, engine="h5netcdf") as file:
            known = file.load()
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path}: {RECORDINGS} in it cannot be read ({error}); give the command that ran the study again"
        ) from error
    return with_recordings(results, known)


def with_recordings(results: xr.Dataset, known: xr.Dataset) -> xr.Dataset:
    """Results with what is known of the recordings, and all settings."""
    names = {name: each for name, each in known.data_vars.items() if name != "digest"}
    return results.assign({name: (each.dims, each.values, each.attrs) for name, each in names.items()}).assign_attrs(
        experiment=known.attrs["experiment"],
        data=json.dumps(dict(zip(known.recording.values.tolist(), known.digest.values.tolist(), strict=True))),
    )
