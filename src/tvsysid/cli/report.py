"""`tvsysid report`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from tvsysid.cli.benchmark import write as write_benchmark
from tvsysid.cli.console import progress, remark
from tvsysid.cli.experiment import write as write_experiment
from tvsysid.cli.running import STORE, check_folder
from tvsysid.errors import InputError


def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder that a benchmark or an experiment wrote.")],
) -> None:
    """Write the report, tables and figures of a benchmark or an experiment again, from its results.

    Reads `results.zarr` in the folder, complete or not, and writes `report.html`, the tables and `figures/` beside it.
    The recordings of an experiment are read and prepared again.

    Example: `tvsysid report tvsysid-benchmark`
    """
    from tvsysid.study import EXPERIMENT, Experiment, prepared_recordings, read_results

    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give one that a benchmark or an experiment wrote")
    check_folder(folder)
    results = read_results(folder / STORE)
    if results.attrs["title"] != EXPERIMENT:
        write_benchmark(results, folder, "")
        return
    what = Experiment.without_methods(results.attrs["experiment"])
    with progress("preparing recordings") as advance:
        prepared = prepared_recordings(what, advance)
    if {item.recorded.label: item.digest for item in prepared} != json.loads(results.attrs["data"]):
        remark(
            "note",
            "the recordings are missing or have changed: exclusions.csv, prepared/ and the figures of recording and "
            "preparation stay as they are, and the page does not show these figures",
        )
        prepared = ()
    write_experiment(what, results, prepared, folder, "")
