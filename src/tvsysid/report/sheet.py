"""A sheet of A4 about one person: one visit, or several in the order of time."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tvsysid import __version__
from tvsysid.errors import InputError
from tvsysid.figures import Illustration, draw_all
from tvsysid.figures.visits import Visit, stiffness_of_visits
from tvsysid.numerics.bands import mean_of
from tvsysid.recommendation.trust import sentence
from tvsysid.report.answer import Account, answer
from tvsysid.report.page import in_text, render

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

MODELS = "models.nc"  # where tvsysid identify keeps what it found, in its folder
MAX_VISITS = 6  # on one page
VALUES = [f"{name} (N·m/rad)" for name in ("stiffness", "lowest", "highest")]
VALUES += ["viscosity (N·m·s/rad)", "inertia (kg·m²)"]


class Known(NamedTuple):
    """What a folder knows of one visit: stiffness, and rows about it."""

    visit: Visit
    about: dict[str, Any]
    viscosity: float
    inertia: float

    @property
    def valid(self) -> bool:
        """Whether a stiffness is stated."""
        return bool(np.isfinite(self.visit.stiffness).any())


def facts(account: Account) -> dict[str, str | float]:
    """Return the facts for a sheet that models do not hold, as attributes of their file."""
    found, label = account.found, account.found.leading
    names = (
        None
        if account.diagnosis is None
        else ", ".join(each.name for each in account.diagnosis.findings)
    )
    return {
        "tvsysid": __version__,
        "leading": group_name(label),
        "answer": " ".join(map(sentence, answer(account))),
        "trust": account.trust.level,
        "file": account.source.get("file", ""),
        "data": f"{len(found.ensemble)} × {found.ensemble.duration:g} s",
        "faults": "not diagnosed" if names is None else names or "none",
        "vaf": mean_of(found.vaf[label]),
        "held_out_vaf": account.held_out_mean(label),
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
    known = [_read(Path(folder)) for folder in folders]
    several = len(known) > 1
    lines = [f"{each.visit.label}: {each.about['answer']}" for each in known if not each.valid]
    lines = lines if several else [known[0].about["answer"]]
    illustration = Illustration(
        partial(stiffness_of_visits, [each.visit for each in known]),
        "Stiffness over time"
        + (", and over visits (circles: means with the mean half width of the band)" * several),
        "",
    )
    is_valid = any(each.valid for each in known)
    render(
        path,
        "sheet.html",
        visits=known,
        lines=lines,
        files=dict.fromkeys(str(each.about["file"]) for each in known),
        picture=draw_all({"sheet": illustration})["sheet"] if is_valid else None,
        values=_values(known),
    )


def _read(folder: Path) -> Known:
    """Load the results that ``tvsysid identify`` wrote to a folder."""
    import xarray as xr  # noqa: PLC0415  # heavy

    file = folder / MODELS
    if not file.is_file():
        raise InputError(
            f"{folder}: there is no {MODELS}; give folders that tvsysid identify wrote"
        )
    try:
        with xr.open_datatree(file, engine="h5netcdf") as tree:
            about = {str(name): value for name, value in tree.attrs.items()}
            model = tree[about["leading"]].to_dataset().load()
    except (KeyError, OSError, ValueError) as error:
        raise InputError(
            f"{file}: cannot be read, or an older version wrote it; identify the recording again "
            f"({error})"
        ) from error
    stiffness = _over_time(model, "stiffness")
    if not np.isfinite(stiffness).any():
        raise InputError(
            f"{file}: {about['leading']} estimates no stiffness over time; a sheet shows that"
        )
    time = np.asarray(model.time.values, dtype=float)
    limits = [_over_time(model, f"stiffness_{end}") for end in ("lower", "upper")]
    if about.get("trust") == "none":  # no stiffness is stated
        stiffness, *limits = (np.full_like(time, np.nan) for _ in range(3))
    means = [mean_of(_over_time(model, name)) for name in ("viscosity", "inertia")]
    return Known(Visit(folder.name or str(folder), time, stiffness, *limits), about, *means)


def _over_time(model: xr.Dataset, name: str) -> np.ndarray:
    """Return a variable over time, NaN if there is none.

    Limits of single realizations are none of the mean.
    """
    missing = np.full(model.sizes["time"], np.nan)
    if name not in model or "time" not in model[name].dims:
        return missing
    values = model[name]
    if "realization" in values.dims:
        return (
            missing
            if name.endswith(("lower", "upper"))
            else np.asarray(values.mean("realization"), dtype=float)
        )
    return np.asarray(values, dtype=float)


def _values(known: Sequence[Known]) -> pd.DataFrame:
    """Return a row for each visit."""
    import pandas as pd  # noqa: PLC0415  # heavy

    rows = []
    for place, each in enumerate(known, start=1):
        visit, about = each.visit, each.about
        values = dict.fromkeys(VALUES, "not valid")
        if each.valid:
            low, high = int(np.nanargmin(visit.stiffness)), int(np.nanargmax(visit.stiffness))
            texts = [in_text(visit.mean, visit.half_band, 1)]
            texts += [f"{visit.stiffness[at]:.1f} at {visit.time[at]:.2f} s" for at in (low, high)]
            texts += [in_text(each.viscosity, decimals=2), in_text(each.inertia, decimals=4)]
            values = dict(zip(VALUES, texts, strict=True))
        rows.append(
            {
                "visit": f"{place}. {visit.label}",
                "data": about["data"].replace(" ", "\u00a0"),
                "method": about["leading"],
                **values,
                "VAF (%)": in_text(float(about["held_out_vaf"]), decimals=1),
                "faults of the data": about["faults"],
            }
        )
    return pd.DataFrame(rows)
