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
from tvsysid.report.page import in_text, render
from tvsysid.report.studies import common, settings_of, with_heading
from tvsysid.study.scenarios import OWN, Study

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

RANKED = {
    "bias_error": ("bias error", "N·m/rad", 2),
    "random_error": ("random error", "N·m/rad", 2),
    "total_error": ("total error", "N·m/rad", 2),
    "rise_time": ("rise time", "s", 3),
    "vaf": ("VAF", "%", 2),
    "bandpassed_vaf": ("VAF 1–10 Hz", "%", 2),
    "coverage": ("in 95 % band", "%", 1),
    "reflex_gain total_error": ("error of reflex gain", "N·m·s/rad", 2),
    "intrinsic pathway_vaf": ("VAF intrinsic", "%", 1),
    "reflex pathway_vaf": ("VAF reflex", "%", 1),
    "seconds": ("time", "ms", 1),
}
"""Heading, unit and decimals of each column of the ranking."""
BEST = {
    "bias_error": "lowest bias error",
    "random_error": "lowest random error",
    "total_error": "lowest total error",
    "rise_time": "shortest rise time",
    "vaf": "highest VAF",
}
HEADINGS = {
    "profile": "stiffness",
    "duration_s": "data (s)",
    "snr_db": "signal-to-noise (dB)",
    "rate": "sampling rate (Hz)",
    "period": "duration of a realization (s)",
}
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
    settings = {HEADINGS.get(name, name): value for name, value in study.items()}
    for name in ("profile", "viscosity"):
        if (traits[name] == OWN).all():  # of a system that has no such setting
            settings.pop(HEADINGS.get(name, name), None)
    failed, tried = (
        int((results.failure != "").sum()),
        int(results.asked.sum()) * results.sizes["trial"],
    )
    seconds = float(results.seconds.sum() + results.other_seconds.sum())
    settings |= {
        "computing time": f"{round(seconds):,} s on one core",
        "failed identifications": f"{failed} of {tried}",
    }
    rows: list[Any] = traits.to_dict("records")
    varying = [name for name in TRAITS if traits[name].nunique() > 1]
    main = main_scenario(traits)
    total = summary[summary.metric == "total_error"].dropna(subset=["value"])
    best = total.loc[total.groupby("scenario", sort=False).value.idxmin()]
    render(
        path,
        "study.html",
        **common(results, claims, map(str, results.method_key.values), settings, "method"),
        failed=failed,
        tried=tried,
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


def best_methods(summary: pd.DataFrame) -> list[dict[str, str]]:
    """Return the best method by each metric, and its ``rival`` if they do not differ clearly."""
    best = []
    for metric, words in BEST.items():
        rows = summary[summary.metric == metric].dropna(subset=["value"])
        rows = rows.sort_values("value", ascending=metric != "vaf")
        if len(rows) < 2:
            continue
        values, errors = rows.value.to_numpy(), rows.standard_error.fillna(0.0).to_numpy()
        is_clear = abs(values[1] - values[0]) > 2 * np.hypot(*errors[:2])
        best.append(
            {
                "method": rows.method.iloc[0],
                "words": words,
                "value": in_text(values[0], rows.standard_error.iloc[0], RANKED[metric][2]),
                "unit": rows.unit.iloc[0],
                "rival": "" if is_clear else rows.method.iloc[1],
                "compared": "higher" if metric == "vaf" else "lower",
            }
        )
    return best


def ranking(traits: pd.DataFrame, varying: list[str], summary: pd.DataFrame) -> pd.DataFrame:
    """Return metrics of every method in every scenario, the lowest total error of each first."""
    metrics = with_heading(RANKED, summary)
    rows = summary[summary.metric.isin([*metrics, "total_error"])]
    value, error = (
        rows.pivot(index=["scenario", "method"], columns="metric", values=name)
        for name in ("value", "standard_error")
    )
    places = value.index.get_level_values("scenario").map(list(traits.index).index)
    value = value.assign(place=places).sort_values(["place", "total_error"], kind="stable")
    error = error.reindex(value.index)
    scenarios, methods = (value.index.get_level_values(name) for name in ("scenario", "method"))
    table = traits.loc[scenarios, varying].rename(columns=HEADINGS)
    table.insert(0, "method", methods)
    for name in varying:
        heading = HEADINGS.get(name, name)
        if table[heading].dtype.kind == "f":
            table[heading] = table[heading].map("{:g}".format)
        else:
            table[heading] = [trait(name, each).removeprefix("b ") for each in table[heading]]
    for name in metrics:
        heading, unit, decimals = RANKED[name]
        factor = 1000 if unit == "ms" else 1
        pairs = zip(factor * value[name], factor * error[name], strict=True)
        table[f"{heading} ({unit})"] = [in_text(*pair, decimals) for pair in pairs]
    return table


def toml_of(study: Mapping[str, Any]) -> str:
    """Return a study as TOML; an empty text if it has objects that no file can name."""
    try:
        Study(**study)
    except InputError:
        return ""
    return tomli_w.dumps(study)
