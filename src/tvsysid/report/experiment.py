"""The page of an experiment."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from tvsysid.figures import Picture
from tvsysid.figures.results import is_known, unique
from tvsysid.figures.words import perturbation_name
from tvsysid.report.page import render
from tvsysid.report.studies import best_methods, common, metric_columns, settings_of

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

# Figures shown in the section about the recordings
DETAILS = ("recorded-signals", "preparation")
COUNTS = {
    "recorded": "recorded",
    "excluded_alignment": "excluded: shift",
    "excluded_task": "excluded: task component",
    "excluded_residual": "excluded: residual",
    "survivors": "kept",
}
"""Column headings of the counts of realizations."""


def write_experiment_report(
    path: str | Path,
    results: xr.Dataset,
    summary: pd.DataFrame,
    claims: pd.DataFrame,
    pictures: Mapping[str, Picture],
    command: str = "",
    answers: pd.DataFrame | None = None,
) -> None:
    """Write one HTML file that holds all of an experiment's outcome and needs nothing else.

    The parameters are those of :func:`write_report`, and ``answers``: a row for each recording with
    the stiffness to report, if it is known.
    """
    summary = summary.assign(perturbation=summary.perturbation.map(perturbation_name))
    remarks = dict(zip(results.recording.values, map(str, results.remarks.values), strict=True))
    counts = results[list(COUNTS)].to_dataframe()
    render(
        path,
        "experiment.html",
        **common(results, claims, settings_of(results, "experiment")),
        participants=len(unique(results.participant.values)),
        is_known=is_known(results),
        kept=counts[counts.recorded > 0].groupby("perturbation")[["survivors", "recorded"]].mean(),
        best=best_by_perturbation(summary),
        perturbation_name=perturbation_name,
        metrics=metrics(summary),
        of_participants=metrics(summary, "participant"),
        recordings=counts[list(COUNTS)].rename(columns=COUNTS).reset_index(),
        remarks={label: text.splitlines() for label, text in remarks.items() if text},
        pictures={stem: each for stem, each in pictures.items() if stem not in DETAILS},
        details={stem: each for stem, each in pictures.items() if stem in DETAILS},
        command=command,
        answers=answers,
    )


def best_by_perturbation(summary: pd.DataFrame) -> dict[str, list[dict[str, str]]]:
    """Return the best methods by their means over participants, each from its least data."""
    least = summary.groupby("method").realizations.transform("min")
    groups = summary[summary.realizations == least].groupby(["perturbation", "method", "metric"])
    means = groups.value.agg(value="mean", standard_error="std").reset_index()
    return {str(name): best_methods(mine) for name, mine in means.groupby("perturbation")}


def metrics(summary: pd.DataFrame, *each: str) -> pd.DataFrame:
    """Return the metrics by method, perturbation and amount of data, and by ``each`` of others.

    Numbers are the mean ± standard deviation over participants.
    """
    by = [*each, "method", "perturbation", "realizations", "metric"]
    groups = summary.groupby(by, sort=False).value
    means, deviations = groups.mean().unstack(sort=False), groups.std().unstack(sort=False)
    table: pd.DataFrame = means[[]].assign(**metric_columns(means, deviations)).reset_index()
    return table
