"""The page of a leaderboard."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from tvsysid.figures import Picture
from tvsysid.report.page import in_text, render
from tvsysid.report.studies import problems_table, settings_of, version_of

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

HEADINGS = {"duration_s": "data (s)", "snr_db": "SNR (dB)"}


def write_leaderboard_page(
    path: Path,
    results: xr.Dataset,
    standings: pd.DataFrame,
    scenarios: pd.DataFrame,
    picture: Picture,
    **facts: object,
) -> None:
    """Write the page of a leaderboard.

    Parameters
    ----------
    path
        Of the file, which appears whole or not at all.
    results
        As of :func:`tvsysid.study.run`.
    standings
        A row for each entry, in order of score, with columns rank and entry, and one for each
        scenario.
    scenarios
        Number, kind and settings of each scenario, by its label.
    picture
        Scores and errors.
    facts
        Of the version: number, is_official, trials, seed (None if it is secret), commitment.
    """
    errors = standings[["entry", *scenarios.index]]
    errors = errors.set_axis(["entry", *map(str, scenarios.number)], axis=1)
    render(
        path,
        "leaderboard.html",
        first=", ".join(standings.entry[standings["rank"] == 1]),
        standings=in_texts(standings.drop(columns=list(scenarios.index))),
        errors=in_texts(errors),
        scenarios=in_texts(scenarios.rename(columns=HEADINGS)),
        picture=picture,
        problems=problems_table(results, "entry"),
        versions=settings_of(results, "versions"),
        version=version_of(results),
        **facts,
    )


def in_texts(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a data frame whose numbers are texts, ± their columns ``_error``."""
    shown = frame[[name for name in map(str, frame) if not name.endswith("_error")]].copy()
    for name in shown.select_dtypes("float"):
        if (error := f"{name}_error") in frame:
            pairs = zip(frame[name], frame[error], strict=True)
            shown[name] = [in_text(*pair, 2) for pair in pairs]
        else:
            shown[name] = [in_text(value, decimals=1) for value in frame[name]]
    return shown
