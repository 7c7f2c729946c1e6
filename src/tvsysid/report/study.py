"""The page of a simulation study."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import tomli_w

from tvsysid.errors import InputError
from tvsysid.figures import Picture
from tvsysid.figures.results import scenario_traits
from tvsysid.figures.words import TRAITS, described, trait
from tvsysid.report.page import render
from tvsysid.report.studies import best_methods, common, metric_columns, settings_of
from tvsysid.study.scenarios import Study

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

HEADINGS = {
    "profile": "stiffness",
    "duration_s": "data (s)",
    "snr_db": "signal-to-noise (dB)",
    "rate": "sampling rate (Hz)",
    "period": "duration of a realization (s)",
}
UNRANKED = ["mean_stiffness", "mean_bias", "lowest_time_varying_vaf"]
USUAL = {"profile": "square", "duration_s": 150.0, "snr_db": 10.0, "viscosity": "constant"}
CLAIMS = (
    "What van de Ruit et al. (2021) say, and whether this study finds it. Estimate and limits (95 "
    "%) are those of the comparison that decides: a difference above 0 or a ratio above 1 speaks "
    "for the claim. For “does not hold” the confidence is 95 % for all comparisons together."
)


def write_report(
    path: str | Path,
    results: xr.Dataset,
    summary: pd.DataFrame,
    claims: pd.DataFrame,
    pictures: Mapping[str, Picture],
    command: str = "",
    about: str = CLAIMS,
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
    about
        What stands above the claims.
    """
    traits, study = scenario_traits(results), settings_of(results, "study")
    rows: list[Any] = traits.to_dict("records")
    varying = [name for name in TRAITS if traits[name].nunique() > 1]
    main = main_scenario(traits)
    total = summary[summary.metric == "total_error"].dropna(subset=["value"])
    best = total.loc[total.groupby("scenario", sort=False).value.idxmin()]
    settings = {HEADINGS.get(name, name): value for name, value in study.items()}
    render(
        path,
        "study.html",
        **common(results, claims, settings, "method"),
        main=main,
        best=best_methods(summary[summary.scenario == main]),
        wins=best.method.value_counts().to_dict(),
        scenarios=dict(zip(traits.index, map(described, rows), strict=True)),
        ranking=ranking(traits, varying, summary),
        shared=described(rows[0], [name for name in TRAITS if name not in varying]),
        pictures=pictures,
        about=about,
        command=command,
        toml=toml_of(study),
    )


def main_scenario(traits: pd.DataFrame) -> str:
    """Return the label of the scenario to look at first: the one most like the paper's."""
    return str((traits[list(USUAL)] == list(USUAL.values())).sum(axis=1).idxmax())


def ranking(traits: pd.DataFrame, varying: list[str], summary: pd.DataFrame) -> pd.DataFrame:
    """Return metrics of every method in every scenario, the lowest total error of each first."""
    wide: Any = summary.pivot(
        index=["scenario", "method"], columns="metric", values=["value", "standard_error"]
    )
    scenarios = traits.index.get_indexer(wide.index.get_level_values("scenario"))
    wide = wide.iloc[np.lexsort((wide["value"].total_error, scenarios))]
    labels = wide.index.get_level_values("scenario")
    columns: dict[str, Any] = {"method": wide.index.get_level_values("method")}
    for name in varying:
        values = traits.loc[labels, name]
        columns[HEADINGS.get(name, name)] = [
            f"{each:g}" if values.dtype.kind == "f" else trait(name, each).removeprefix("b ")
            for each in values
        ]
    values = wide["value"].drop(columns=UNRANKED, errors="ignore")
    columns |= metric_columns(values, wide["standard_error"])
    table: pd.DataFrame = traits.loc[labels, []].assign(**columns)
    return table


def toml_of(study: Mapping[str, Any]) -> str:
    """Return a study as TOML; an empty text if it has objects that no file can name."""
    try:
        Study(**study)
    except InputError:
        return ""
    return tomli_w.dumps(study)
