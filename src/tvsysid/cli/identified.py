"""Files that `tvsysid identify` writes to its folder."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from tvsysid.cli.console import say
from tvsysid.cli.running import command_line

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tvsysid.comparison import Comparison
    from tvsysid.report import Account


def write_results(found: Comparison, out: Path) -> None:
    """Write models and estimates."""
    from tvsysid.recordings import write_models, write_table

    write_table(out / "stiffness.csv", found.rows_over_time())
    models = {label.replace("/", "_"): each for label, each in found.models.items()}
    write_models(out / "models.nc", models, found.ensemble)


def write_account(account: Account, out: Path, name: str, sheet: bool) -> list[str]:
    """Add the account to the models, and write page, figures and, if asked for, a sheet.

    Return all files' names.
    """
    from tvsysid.figures import identified_impedance, variable_of
    from tvsysid.recordings import describe_models
    from tvsysid.report import write_identification, write_sheet
    from tvsysid.report.sheet import facts

    found = account.found
    describe_models(out / "models.nc", facts(account))
    write_identification(out / "report.html", account, command_line())
    if sheet:
        write_sheet(out / "sheet.html", [out])
    title = ("not valid: " if account.trust.level == "none" else "") + _title(name, found)
    over = variable_of(found.models, found.ensemble)
    _save(identified_impedance(found.models, found.vaf_over_time(), title, over), out / "stiffness")
    drawn = [
        "stiffness.csv",
        "stiffness.png",
        "stiffness.pdf",
        *_write_scheduled(found, out, title),
    ]
    return ["report.html", *["sheet.html"] * sheet, "models.nc", *drawn]


def _write_scheduled(found: Comparison, out: Path, title: str) -> list[str]:
    """Write what was estimated over variables, and draw it over the first of them.

    Returns the names of the files.
    """
    from tvsysid.figures import scheduled_estimates, variable_of
    from tvsysid.recordings import write_table

    if not (rows := found.rows_over_variables()):
        return []
    write_table(out / "scheduled.csv", rows)
    if not (variable := variable_of(found.models, found.ensemble)):
        return ["scheduled.csv"]
    _save(scheduled_estimates(found.models, found.ensemble, variable, title), out / "scheduled")
    return ["scheduled.csv", "scheduled.png", "scheduled.pdf"]


def write_tuning(found: Comparison, out: Path) -> list[str]:
    """Print which settings were chosen, and write all that were tried.

    Returns the names of the files.
    """
    if not found.evidence:
        return []
    import pandas as pd

    from tvsysid.figures import tuning_curves
    from tvsysid.methods import Method, typed
    from tvsysid.recordings import whole_file

    tuned = [
        each
        for label, each in found.methods.items()
        if label in found.evidence and isinstance(each, Method)
    ]
    for label, item in found.evidence.items():
        say(f"{label}: {item}")
    say(
        "the same settings again: "
        f"{' '.join(f'--method {shlex.quote(typed(each))}' for each in tuned)}"
    )
    tables = [item.to_pandas().assign(method=label) for label, item in found.evidence.items()]
    table = pd.concat(tables, ignore_index=True)
    with whole_file(out / "tuning.csv") as file:
        table[["method", *table.columns.drop("method")]].to_csv(
            file, index=False, float_format="%.6g"
        )
    _save(tuning_curves(found.evidence), out / "tuning")
    return ["tuning.csv", "tuning.png", "tuning.pdf"]


def _save(figure: Figure, stem: Path) -> None:
    """Write a figure in both of its forms."""
    from tvsysid.figures import save

    for ending in ("png", "pdf"):
        save(figure, stem.with_name(f"{stem.name}.{ending}"))


def _title(name: str, found: Comparison) -> str:
    """What the figure shows: of which data, whether with bands, and what was done about a delay."""
    from tvsysid.figures.words import count
    from tvsysid.report.answer import taken

    title = f"{name}: {count(len(found.ensemble), 'realization')} of {found.ensemble.duration:g} s"
    title += ", with 95 % bands" if found.has_bands else ""
    return (
        f"{title}; {taken(found.ensemble.delay_removed)}" if found.ensemble.delay_removed else title
    )
