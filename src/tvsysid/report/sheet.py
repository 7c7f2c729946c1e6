"""A sheet of A4 about one person: one visit, or several; and a page about several recordings."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid import __version__
from tvsysid.comparison import Comparison
from tvsysid.errors import InputError
from tvsysid.figures import Illustration, draw_all
from tvsysid.figures.visits import Visit, stiffness_of_visits
from tvsysid.quality import Diagnosis
from tvsysid.recommendation.answer import sentence
from tvsysid.report.page import in_text, render

if TYPE_CHECKING:
    import pandas as pd

MAX_VISITS = 6  # on one page


def facts(found: Comparison, file: str = "") -> dict[str, str]:
    """Return the facts for a sheet, as attributes of the file of models."""
    answer, label = found.answer, found.answer.label
    row: Any = found.summary().set_index("method").loc[label]
    values = {
        "stiffness (N·m/rad)": in_text(row["stiffness (N·m/rad)"], row["half_band (N·m/rad)"], 1),
        "methods differ by (N·m/rad)": in_text(answer.difference, decimals=1),
    }
    for end in ("lowest", "highest"):
        where = f" at {row[f'{end} at (s)']:.2f} s"
        values[f"{end} (N·m/rad)"] = in_text(row[f"{end} (N·m/rad)"], decimals=1) + where
    for name, decimals in {"viscosity (N·m·s/rad)": 2, "inertia (kg·m²)": 4}.items():
        values[name] = in_text(row[name], decimals=decimals)
    if not answer.is_stated:
        values = dict.fromkeys(values, "not valid")
    diagnosis, faults = found.recommendation.diagnosis, "not diagnosed"
    if isinstance(diagnosis, Diagnosis):
        faults = ", ".join(each.name for each in diagnosis.findings) or "none"
    columns = {
        "data": f"{len(found.ensemble)} × {found.ensemble.duration:g} s",
        "method": label,
        **values,
        "VAF (%)": in_text(answer.vaf[label], decimals=1),
        "faults of the data": faults,
    }
    return {
        "tvsysid": __version__,
        "leading": group_name(label),
        "answer": " ".join(map(sentence, answer.lines)),
        "trust": answer.trust,
        "file": file,
        "sheet": json.dumps(columns, ensure_ascii=False),
    }


def group_name(label: str) -> str:
    """Name of a method's group in the file of models."""
    return label.replace("/", "_")


def write_sheet(path: str | Path, folders: Sequence[str | Path]) -> None:
    """Write one page of A4, as HTML to be printed, about one person.

    Parameters
    ----------
    path
        Of the file, which appears whole or not at all.
    folders
        Of ``tvsysid identify``, one for each visit, in the order of time; at most six.

    Raises
    ------
    InputError
        For none, too many, and for a folder that identify did not write.
    """
    if not 1 <= len(folders) <= MAX_VISITS:
        raise InputError(
            f"write_sheet: expected 1 to {MAX_VISITS} folders of tvsysid identify, got "
            f"{len(folders)}"
        )
    import pandas as pd  # noqa: PLC0415  # heavy

    known = [_read(Path(folder)) for folder in folders]
    visits, several = [visit for visit, _ in known], len(known) > 1
    draw = partial(stiffness_of_visits, visits)
    over = ", and over visits (circles: means with the mean half width of the band)" * several
    figure = {"sheet": Illustration(draw, f"Stiffness over time{over}")}
    is_valid = any(np.isfinite(visit.stiffness).any() for visit in visits)
    # Of a single visit, the file says more than the folder of its results.
    names = [f"{place}. {visit.label}" for place, visit in enumerate(visits, start=1)]
    names = names if several else [known[0][1]["file"] or visits[0].label]
    rows = [
        {"visit": name, **json.loads(about["sheet"])}
        for name, (_, about) in zip(names, known, strict=True)
    ]
    render(
        path,
        "sheet.html",
        known=known,
        picture=draw_all(figure)["sheet"] if is_valid else None,
        values=pd.DataFrame(rows),
    )


def write_recordings(
    path: str | Path, folders: Sequence[str | Path], command: str = ""
) -> pd.DataFrame:
    """Write one page about several recordings, and return its table, a row for each.

    Parameters
    ----------
    path
        Of the file, which appears whole or not at all.
    folders
        Of ``tvsysid identify``, one for each recording, beside the file.
    command
        What was typed.

    Raises
    ------
    InputError
        For a folder that identify did not write.
    """
    import pandas as pd  # noqa: PLC0415  # heavy

    known = [_read(Path(folder)) for folder in folders]
    figures = {
        visit.label: Illustration(partial(stiffness_of_visits, [visit]), "Stiffness over time")
        for visit, _ in known
        if np.isfinite(visit.stiffness).any()
    }
    pictures = draw_all(figures)
    rows = [{"recording": visit.label, **json.loads(about["sheet"])} for visit, about in known]
    values = pd.DataFrame(rows)
    render(path, "recordings.html", known=known, pictures=pictures, values=values, command=command)
    return values


def _read(folder: Path) -> tuple[Visit, dict[str, Any]]:
    """Load the stiffness that ``tvsysid identify`` wrote to a folder, and the facts about it."""
    import h5py  # noqa: PLC0415  # heavy
    import pandas as pd  # noqa: PLC0415  # heavy

    try:
        with h5py.File(folder / "models.nc") as file:
            about = dict(file.attrs)
        method = json.loads(about["sheet"])["method"]
        table = pd.read_csv(folder / "stiffness.csv").query("method == @method")
        names = ["time_s", "stiffness", "stiffness_lower", "stiffness_upper"]
        time, *stiffness = table[names].to_numpy(float).T
    except (KeyError, OSError, ValueError) as error:
        raise InputError(
            f"{folder}: tvsysid identify did not write this folder, or an older version did; "
            "identify the recording again"
        ) from error
    if not np.isfinite(stiffness[0]).any():
        raise InputError(f"{folder}: {method} estimates no stiffness over time; a sheet shows that")
    if about["trust"] == "none":  # no stiffness is stated
        stiffness = [np.full_like(time, np.nan)] * 3
    return Visit(folder.name or str(folder), time, *stiffness), about
