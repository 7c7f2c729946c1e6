"""`tvsysid report`."""

from __future__ import annotations

from pathlib import Path

from tvsysid.cli.console import say_written
from tvsysid.cli.options import Flag
from tvsysid.cli.results import write_study
from tvsysid.errors import InputError


def report(folder: Path, /, *folders: Path, sheet: Flag = False) -> None:
    """Write the report, tables and figures of a benchmark or an experiment again, from its results.

    Reads `results.nc` in the folder, and writes `report.html`, the tables and `figures/` beside it.
    What shows an experiment's recordings stays as it is: to write it, too, run the experiment
    again, which identifies nothing twice.

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
    from tvsysid.report import write_sheet
    from tvsysid.study import read_results

    if sheet:
        *_, last = visits = [folder, *folders]
        write_sheet(last / "sheet.html", visits)
        say_written(last, ["sheet.html"])
        return
    if folders:
        raise InputError("several folders are visits of one person: add --sheet")
    if folder.is_dir() and not (folder / "results.nc").exists():
        raise InputError(
            f"{folder}: no results of `tvsysid benchmark` or `experiment`; if one was interrupted, "
            "repeat its command. `identify` and `plan` write all that they find at once; --sheet "
            "makes a sheet of folders of `identify`"
        )
    write_study(read_results(folder), folder)
