"""The page of a leaderboard."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from tvsysid.figures import Picture
from tvsysid.report.page import render
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
    decimals = dict.fromkeys([*map(str, standings), *errors], 1) | {"score": 2, "behind": 2}
    render(
        path,
        "leaderboard.html",
        decimals=decimals,
        first=", ".join(standings.entry[standings["rank"] == 1]),
        standings=standings.drop(columns=list(scenarios.index)),
        errors=errors,
        scenarios=scenarios.rename(columns=HEADINGS),
        picture=picture,
        problems=problems_table(results, "entry"),
        versions=settings_of(results, "versions"),
        version=version_of(results),
        **facts,
    )
