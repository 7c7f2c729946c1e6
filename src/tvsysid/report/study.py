"""The page of a simulation study."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tomli_w

from tvsysid.errors import InputError
from tvsysid.figures import Picture
from tvsysid.figures.results import scenario_traits
from tvsysid.figures.words import described
from tvsysid.report.page import render
from tvsysid.report.studies import best_methods, common, metric_columns, settings_of
from tvsysid.study.scenarios import Study

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

UNRANKED = ["mean_stiffness", "mean_bias", "lowest_time_varying_vaf"]
USUAL = {"profile": "square", "duration_s": 150.0, "snr_db": 10.0, "viscosity": "constant"}


def write_report(
    path: str | Path,
    results: xr.Dataset,
    summary: pd.DataFrame,
    claims: pd.DataFrame,
    pictures: Mapping[str, Picture],
    command: str = "",
    says: str = "is published",
) -> None:
    """Write one HTML file that holds all of a study's outcome and needs nothing else.

    Parameters
    ----------
    path
        Of the file, which appears whole or not at all.
    results, summary
        As of :func:`tvsysid.study.run`, and of :func:`tvsysid.study.summarize`.
    claims
        What the papers say and whether it holds here; may have no rows.
    pictures
        As of :func:`tvsysid.figures.draw_all`.
    command
        What was typed to run the study, if it is to be mentioned.
    says
        Who says so of what, as of ``PublishedStudy``.
    """
    traits, study = scenario_traits(results), settings_of(results, "study")
    main = main_scenario(traits)
    total = summary[summary.metric == "total_error"].dropna(subset=["value"])
    best = total.loc[total.groupby("scenario", sort=False).value.idxmin()]
    render(
        path,
        "study.html",
        **common(results, claims, study),
        main=main,
        best=best_methods(summary[summary.scenario == main]),
        wins=best.method.value_counts().to_dict(),
        scenarios={label: described(own) for label, own in traits.to_dict("index").items()},
        ranking=ranking(list(traits.index), summary),
        pictures=pictures,
        says=says,
        command=command,
        toml=toml_of(study),
    )


def main_scenario(traits: pd.DataFrame) -> str:
    """Return the label of the scenario to look at first: the one most like the paper's."""
    return str((traits[list(USUAL)] == list(USUAL.values())).sum(axis=1).idxmax())


def ranking(scenarios: list[str], summary: pd.DataFrame) -> pd.DataFrame:
    """Return metrics of every method in every scenario, the lowest total error of each first."""
    wide: Any = summary.pivot(
        index=["scenario", "method"], columns="metric", values=["value", "standard_error"]
    )
    wide = wide.sort_values(("value", "total_error")).loc[scenarios]
    values = wide["value"].drop(columns=UNRANKED, errors="ignore")
    table: pd.DataFrame = values[[]].assign(**metric_columns(values, wide["standard_error"]))
    return table.reset_index().set_index("scenario", drop=False)


def toml_of(study: Mapping[str, Any]) -> str:
    """Return a study as TOML; an empty text if it has objects that no file can name."""
    try:
        Study(**study)
    except InputError:
        return ""
    return tomli_w.dumps(study)
