"""Page of what a diagnosis found in one or several recordings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from tvsysid.errors import InputError
from tvsysid.figures import diagnosis_illustration, draw_all
from tvsysid.quality import Diagnosis
from tvsysid.report.page import in_text, render

if TYPE_CHECKING:
    import pandas as pd

SYMBOLS = {"found": "✗", "uncertain": "?", "in order": "✓", "not judged": "–"}


def write_diagnosis(
    path: str | Path,
    diagnoses: Mapping[str, Diagnosis],
    command: str = "",
    notes: Mapping[str, str] = MappingProxyType({}),
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
    notes
        Further sentences about ensembles, by their names.

    Raises
    ------
    InputError
        If there is no diagnosis.
    """
    if not diagnoses:
        raise InputError("write_diagnosis: expected diagnoses by name, got none")
    drawn = {name: diagnosis_illustration(each, name) for name, each in diagnoses.items()}
    render(
        path,
        "diagnosis.html",
        diagnoses=diagnoses,
        pictures=draw_all(drawn),
        findings={name: findings_table(each) for name, each in diagnoses.items()},
        checks={name: _checks(each) for name, each in diagnoses.items()},
        measures={name: _measures(each) for name, each in diagnoses.items()},
        notes=notes,
        command=command,
    )


def findings_table(diagnosis: Diagnosis | None) -> pd.DataFrame:
    """Return the findings of an ensemble, their effects and remedies."""
    import pandas as pd  # noqa: PLC0415  # heavy

    return pd.DataFrame(
        {
            "found": f"{each.fault.title} ({each.name})",
            "what was seen": each.what,
            "how strong": each.strength,
            "what it does to the result": each.fault.effect,
            "what to do": each.fault.remedy,
        }
        for each in (() if diagnosis is None else diagnosis.findings)
    )


def _checks(diagnosis: Diagnosis) -> pd.DataFrame:
    import pandas as pd  # noqa: PLC0415  # heavy

    return pd.DataFrame(
        {
            "what": each.name,
            "verdict": f"{SYMBOLS[each.state]} {each.state}",
            "how strong": each.strength,
            "what was seen": each.what,
            "measure": each.fault.measure,
        }
        for each in diagnosis.checks
    )


def _measures(diagnosis: Diagnosis) -> pd.DataFrame:
    import pandas as pd  # noqa: PLC0415  # heavy

    return pd.DataFrame(
        {"measure": name, "value": in_text(value), "unit": "" if unit == "1" else unit}
        for name, (value, unit) in diagnosis.measures.items()
        if math.isfinite(value)
    )
