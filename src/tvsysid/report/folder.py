"""Write the folder of an identification: models, tables, figures and pages."""

from __future__ import annotations

from pathlib import Path

import attrs

from tvsysid.errors import printable
from tvsysid.figures import save, scheduled_estimates, tuning_curves, variable_of
from tvsysid.figures.words import count
from tvsysid.recordings import write_models, write_table
from tvsysid.report.answer import Account, taken
from tvsysid.report.identification import illustrations, write_identification
from tvsysid.report.sheet import facts, group_name, write_sheet


def write_folder(
    folder: Path, account: Account, command: str = "", sheet: bool = False
) -> list[str]:
    """Write all that ``tvsysid identify`` writes.

    Parameters
    ----------
    folder
        Folder of the files.
    account
        What was found, and what is known of it.
    command
        Command that was typed, for the page.
    sheet
        Whether to write ``sheet.html``, one page of A4.

    Returns
    -------
    list of str
        Names of all files.
    """
    found, names = account.found, ["report.html"]
    write_table(folder / "stiffness.csv", found.over_time())
    models = {group_name(label): model for label, model in found.models.items()}
    write_models(folder / "models.nc", models, found.ensemble, facts(account))
    title, variable = _title(account), variable_of(found.models, found.ensemble)
    on_page = illustrations(account)
    stem = "methods" if "methods" in on_page else "answer"
    impedance = on_page[stem].draw()
    impedance.suptitle(printable(title))
    on_page[stem] = attrs.evolve(on_page[stem], draw=lambda: impedance)
    write_identification(folder / "report.html", account, command, on_page)
    if sheet:
        write_sheet(folder / "sheet.html", [folder])
        names.append("sheet.html")
    names += ["models.nc", "stiffness.csv"]
    figures = {"stiffness": impedance}
    if not (table := found.over_variables()).empty:
        write_table(folder / "scheduled.csv", table)
        names.append("scheduled.csv")
        if variable:
            figures["scheduled"] = scheduled_estimates(
                found.models, found.ensemble, variable, title
            )
    if found.evidence:
        import pandas as pd  # noqa: PLC0415  # heavy

        tried = {label: item.to_pandas() for label, item in found.evidence.items()}
        table = pd.concat(tried, names=["method"]).reset_index("method")
        write_table(folder / "tuning.csv", table)
        names.append("tuning.csv")
        figures["tuning"] = tuning_curves(found.evidence)
    for stem, figure in figures.items():
        for ending in ("png", "pdf"):
            save(figure, folder / f"{stem}.{ending}")
            names.append(f"{stem}.{ending}")
    return names


def _title(account: Account) -> str:
    """Return the title of the figures: the data, and the correction of a delay."""
    ensemble = account.found.ensemble
    title = "not valid: " if account.trust.level == "none" else ""
    title += f"{account.source.get('file', 'ensemble')}: {count(len(ensemble), 'realization')} of "
    title += f"{ensemble.duration:g} s"
    return f"{title}; {taken(ensemble.delay_removed)}" if ensemble.delay_removed else title
