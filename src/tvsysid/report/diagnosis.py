"""What a diagnosis found, as a page of its own or as a part of another."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tvsysid import __version__
from tvsysid.errors import InputError
from tvsysid.figures import diagnosis_illustration, draw_all
from tvsysid.quality import Diagnosis, Finding
from tvsysid.report.rendering import embedded_one, filled, write_page
from tvsysid.report.tables import number

SYMBOLS = {"found": "✗", "uncertain": "?", "in order": "✓", "not judged": "–"}


def write_diagnosis(path: str | Path, diagnoses: Mapping[str, Diagnosis], command: str = "", workers: int = 1) -> None:
    """Write one HTML file that holds all that was seen and needs nothing else.

    Parameters
    ----------
    path
        Of the file, which appears whole or not at all.
    diagnoses
        Of :func:`tvsysid.diagnose`, by what the ensembles are called.
    command
        What was typed; the page says nothing of it if empty.
    workers
        Processes that draw, as of :func:`tvsysid.figures.draw_all`.

    Raises
    ------
    InputError
        For what is no mapping of names to diagnoses, and for none.
    """
    content = {**_content(diagnoses, workers), "command": command, "version": __version__}
    write_page(path, "diagnosis.html", content)


def diagnosis_section(diagnoses: Mapping[str, Diagnosis]) -> str:
    """Part of a page: for each ensemble its findings, what to do, pictures, and all that was looked at.

    Parameters
    ----------
    diagnoses
        Of :func:`tvsysid.diagnose`, by what the ensembles are called.

    Returns
    -------
    str
        HTML, escaped, whose headings are of the third and fourth level; it takes the style of the report's pages.
    """
    return filled("diagnosis_section.html", _content(diagnoses))


def _content(diagnoses: Mapping[str, Diagnosis], workers: int = 1) -> dict[str, Any]:
    if not isinstance(diagnoses, Mapping) or not all(isinstance(each, Diagnosis) for each in diagnoses.values()):
        raise InputError(
            f"write_diagnosis: expected diagnoses by name, got {type(diagnoses).__name__}; give "
            "{'ankle': tvsysid.diagnose(ensemble)}"
        )
    if not diagnoses:
        raise InputError("write_diagnosis: expected diagnoses by name, got none; give {'ankle': diagnosis}")
    pictures = draw_all({name: diagnosis_illustration(each, name) for name, each in diagnoses.items()}, None, workers)
    return {
        "diagnoses": [
            {
                "name": name,
                "anchor": f"diagnosis-{index}",
                "ensemble": each.ensemble,
                "verdict": each.verdict,
                "notes": each.notes,
                "findings": [_row(check) for check in each.findings],
                "checks": [_row(check) for check in each.checks],
                "measures": [
                    (key, number(value).text, "" if unit == "1" else unit) for key, (value, unit) in _known(each)
                ],
                "figure": embedded_one(pictures[name]),
            }
            for index, (name, each) in enumerate(diagnoses.items(), start=1)
        ]
    }


def _known(diagnosis: Diagnosis) -> list[tuple[str, tuple[float, str]]]:
    return [(key, measure) for key, measure in diagnosis.measures.items() if math.isfinite(measure[0])]


def _row(finding: Finding) -> dict[str, Any]:
    row = {name: getattr(finding, name) for name in ("name", "what", "state", "strength")}
    return row | finding.fault._asdict() | {"symbol": SYMBOLS[finding.state]}
