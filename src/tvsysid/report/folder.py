"""Write the folder of an identification: models, tables, figures and pages."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import attrs

from tvsysid.comparison import Comparison, PreparedRecording
from tvsysid.errors import printable
from tvsysid.figures import save, tuning_curves
from tvsysid.figures.words import count
from tvsysid.recordings import write_models, write_table
from tvsysid.report.diagnosis import recording_illustration
from tvsysid.report.identification import illustrations, write_identification
from tvsysid.report.sheet import facts, group_name, write_sheet


def write_folder(
    folder: Path,
    found: Comparison,
    prepared: PreparedRecording,
    command: str = "",
    sheet: bool = False,
) -> list[str]:
    """Write all that ``tvsysid identify`` writes.

    Parameters
    ----------
    folder
        Folder of the files.
    found
        What was found.
    prepared
        What was identified.
    command
        Command that was typed, for the page.
    sheet
        Whether to write ``sheet.html``, one page of A4.

    Returns
    -------
    list of str
        Names of all files.
    """
    source = _source(prepared)
    title = printable(_title(found, source))
    tables = {"stiffness": found.over_time()}
    on_page = illustrations(found)
    on_page["recording"] = recording_illustration(prepared.recording, found.ensemble)
    stem = "methods" if "methods" in on_page else "answer"
    impedance = on_page[stem].draw()
    impedance.suptitle(title)
    on_page[stem] = attrs.evolve(on_page[stem], draw=lambda: impedance)
    figures = {"stiffness": impedance}
    if not (over_variables := found.over_variables()).empty:
        tables["scheduled"] = over_variables
    if "variable" in on_page:
        figures["scheduled"] = on_page["variable"].draw()
    if found.evidence:
        import pandas as pd  # noqa: PLC0415  # heavy

        tried = {label: item.to_pandas() for label, item in found.evidence.items()}
        tables["tuning"] = pd.concat(tried, names=["method"]).reset_index("method")
        figures["tuning"] = tuning_curves(found.evidence)
    models = {group_name(label): model for label, model in found.models.items()}
    write_models(folder / "models.nc", models, found.ensemble, facts(found, source.get("file", "")))
    for name, table in tables.items():
        write_table(folder / f"{name}.csv", table)
    page = folder / "report.html"
    corrections = [action for fault, action in prepared.corrections if fault.name != "delay"]
    write_identification(
        page, found, command, source=source, corrections=corrections, figures=on_page
    )
    if sheet:
        write_sheet(folder / "sheet.html", [folder])
    pictures = [f"{name}.{ending}" for name in figures for ending in ("png", "pdf")]
    for picture in pictures:
        save(figures[picture.partition(".")[0]], folder / picture)
    pages = ["report.html", *["sheet.html"] * sheet, "models.nc"]
    return [*pages, *(f"{name}.csv" for name in tables), *pictures]


def _source(prepared: PreparedRecording) -> dict[str, str]:
    """Return the file and its channels in words; nothing of a recording without a file."""
    if prepared.file is None:
        return {}
    reading = prepared.reading
    sign = ", sign reversed" if reading.torque_sign == -1 else ""
    return {
        "file": printable(prepared.file.name),
        "angle": f"channel {reading.angle}, in {reading.angle_unit}",
        "torque": f"channel {reading.torque}, in {reading.torque_unit.replace('N', 'N·')}{sign}",
    }


def _title(found: Comparison, source: Mapping[str, str]) -> str:
    """Return the title of the figures: the data, and the correction of a delay."""
    ensemble = found.ensemble
    title = "" if found.answer.is_stated else "not valid: "
    title += f"{source.get('file', 'ensemble')}: {count(len(ensemble), 'realization')} of "
    title += f"{ensemble.duration:g} s"
    if delay := 1000 * ensemble.delay_removed:
        title += f"; torque taken {abs(delay):.3g} ms {'earlier' if delay > 0 else 'later'}"
    return title
