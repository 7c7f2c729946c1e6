"""Page of what a diagnosis found in one or several recordings."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from tvsysid.errors import InputError
from tvsysid.figures import diagnosis_illustration, draw_all
from tvsysid.quality import Diagnosis
from tvsysid.report.page import render


def write_diagnosis(
    path: str | Path,
    diagnoses: Mapping[str, Diagnosis],
    command: str = "",
) -> None:
    """Write one HTML file that holds all that was seen and needs nothing else.

    Parameters
    ----------
    path
        Of the file, which appears whole or not at all.
    diagnoses
        Of :func:`tvsysid.diagnose`, by the names of the ensembles.
    command
        What was typed, if it is to be mentioned.

    Raises
    ------
    InputError
        If there is no diagnosis.
    """
    if not diagnoses:
        raise InputError("write_diagnosis: expected diagnoses by name, got none")
    drawn = {name: diagnosis_illustration(each, name) for name, each in diagnoses.items()}
    pictures = draw_all(drawn)
    render(
        path,
        "diagnosis.html",
        diagnoses=diagnoses,
        pictures=pictures,
        command=command,
    )
