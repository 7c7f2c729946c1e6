"""`tvsysid report`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from tvsysid.cli.benchmark import write as write_benchmark
from tvsysid.cli.console import remark, say_written, shown_progress
from tvsysid.cli.experiment import write as write_experiment
from tvsysid.cli.options import Flag
from tvsysid.errors import InputError

if TYPE_CHECKING:
    from tvsysid.study import Prepared


def report(folder: Path, /, *folders: Path, sheet: Flag = False) -> None:
    """Write the report, tables and figures of a benchmark or an experiment again, from its results.

    Reads `results.nc` in the folder, and writes `report.html`, the tables and
    `figures/` beside it. The recordings of an experiment are read and prepared again.

    With `--sheet`, reads `models.nc` and `stiffness.csv` of each folder instead, and writes
    `sheet.html` to the last of them: stiffness over time and over visits, with bands, to be
    printed.

    Example: `tvsysid report tvsysid-benchmark`

    Example: `tvsysid report P1/january P1/march P1/june --sheet`

    Parameters
    ----------
    folder
        Folder of a benchmark or an experiment; with `--sheet`, of `tvsysid identify`.
    folders
        With `--sheet`, folders of further visits.
    sheet
        Write one page of A4 about one person, from folders of `tvsysid identify`: one for each
        visit, in the order of time. For research use only.
    """
    if sheet:
        from tvsysid.report import write_sheet

        *_, last = visits = [folder, *folders]
        write_sheet(last / "sheet.html", visits)
        say_written(last, ["sheet.html"])
        return
    if folders:
        raise InputError("several folders are visits of one person: add --sheet")
    if (folder / "models.nc").exists():
        raise InputError(
            f"{folder}: `tvsysid identify` wrote its report already; --sheet makes a sheet of it"
        )
    _write_again(folder)


def _write_again(folder: Path) -> None:
    """Write the report of a study again, from its results."""
    from tvsysid.study import EXPERIMENT, Experiment, prepared_recordings, read_results

    results = read_results(folder)
    if results.attrs["title"] != EXPERIMENT:
        write_benchmark(results, folder, "")
        return
    prepared: Sequence[Prepared] = ()
    with suppress(InputError), shown_progress("preparing recordings") as advance:
        study = Experiment(**json.loads(results.attrs["experiment"]))
        prepared = prepared_recordings(study, advance)
    if [item.digest for item in prepared] != results.digest.values.tolist():
        remark(
            "note",
            "the recordings are missing or have changed: exclusions.csv, prepared/ and the figures "
            "of recording and preparation stay as they are; the page does not show them",
        )
        prepared = ()
    write_experiment(results, prepared, folder, "")
