"""`tvsysid report`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from tvsysid.cli import options
from tvsysid.cli.benchmark import write as write_benchmark
from tvsysid.cli.console import progress, remark, say_written
from tvsysid.cli.experiment import write as write_experiment
from tvsysid.cli.running import STORE, check_folder
from tvsysid.errors import InputError


def report(
    folders: Annotated[
        list[Path],
        typer.Argument(
            metavar="DIR…",
            help="Folder of a benchmark or an experiment; with --sheet, of identify.",
        ),
    ],
    sheet: Annotated[
        bool,
        options.option(
            "",
            "Write one page of A4 about one person, from folders of `tvsysid identify`: one for "
            "each visit, in the "
            "order of time. For research use only.",
            "--sheet",
        ),
    ] = False,
) -> None:
    """Write the report, tables and figures of a benchmark or an experiment again, from its results.

    Reads `results.zarr` in the folder, complete or not, and writes `report.html`, the tables and
    `figures/` beside it. The recordings of an experiment are read and prepared again.

    With `--sheet`, reads `models.nc` of each folder instead, and writes `sheet.html` to the last of
    them: stiffness over time and over visits, with bands, to be printed.

    Example: `tvsysid report tvsysid-benchmark`

    Example: `tvsysid report P1/january P1/march P1/june --sheet`
    """
    if sheet:
        from tvsysid.report import write_sheet

        check_folder(folders[-1])
        write_sheet(folders[-1] / "sheet.html", folders)
        say_written(folders[-1], ["sheet.html"])
        return
    if len(folders) > 1:
        raise InputError(
            f"report: expected one folder, got {len(folders)}; several visits of one person take "
            "--sheet"
        )
    _again(folders[0])


def _again(folder: Path) -> None:
    """Write the report of a study again."""
    from tvsysid.study import EXPERIMENT, Experiment, prepared_recordings, read_results

    if not folder.is_dir():
        raise InputError(
            f"{folder}: no such folder; give one that a benchmark or an experiment wrote"
        )
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
            "the recordings are missing or have changed: exclusions.csv, prepared/ and the "
            "figures of recording and "
            "preparation stay as they are, and the page does not show these figures",
        )
        prepared = ()
    write_experiment(what, results, prepared, folder, "")
