"""`tvsysid report`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from tvsysid.cli.benchmark import write_study
from tvsysid.cli.console import progress, remark
from tvsysid.cli.experiment import write_experiment
from tvsysid.cli.running import STORE, check_folder
from tvsysid.errors import InputError


def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder that a benchmark or an experiment wrote.")],
) -> None:
    """Write report, tables and figures anew from the results of a benchmark or an experiment.

    Reads `results.zarr` in the folder, finished or not, and writes `report.html`, the tables and `figures/` beside it.
    Of an experiment, the recordings are read and prepared again.

    Example: `tvsysid report tvsysid-benchmark`
    """
    from tvsysid.study import EXPERIMENT, Experiment, prepared_recordings, read_results

    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder; give the one that a benchmark or an experiment wrote")
    check_folder(folder)
    results = read_results(folder / STORE)
    if results.attrs["title"] != EXPERIMENT:
        write_study(results, folder, "")
        return
    settings = {name: each for name, each in json.loads(results.attrs["experiment"]).items() if name != "methods"}
    what = Experiment(**settings)
    with progress("preparing recordings") as advance:
        prepared = prepared_recordings(what, advance)
    if {item.recorded.label: item.digest for item in prepared} != json.loads(results.attrs["data"]):
        remark(
            "note",
            "the recordings are not there, or not as they were: exclusions.csv, prepared/ and the "
            "figures of recording and preparation stay as they are, and the page is without these figures",
        )
        prepared = ()
    write_experiment(what, results, prepared, folder, "")
