"""The page of an experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from tvsysid.figures import Picture
from tvsysid.figures.results import of_quantity, unique
from tvsysid.figures.words import perturbation_name
from tvsysid.report.page import in_text, render
from tvsysid.report.studies import best_methods, common, metric_columns, settings_of

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

Reported = Mapping[str, Sequence[str]]

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
    exclusions: pd.DataFrame,
    pictures: Mapping[str, Picture],
    command: str = "",
    reported: Reported = MappingProxyType({}),
) -> None:
    """Write one HTML file that holds all of an experiment's outcome and needs nothing else.

    Parameters
    ----------
    path, results, summary, claims, pictures, command
        As for :func:`write_report`.
    exclusions
        A row for each realization recorded: columns recording, excluded_by and shift_s are used.
    reported
        Realizations recorded, excluded by each step, and kept, as a paper reports them, by
        perturbation; shown beside recordings of as many realizations.
    """
    people, bootstraps = unique(results.participant.values), results.sizes["bootstrap"]
    is_known = np.isfinite(of_quantity(results).truth.values).any(axis=1)
    virtual = len(unique(results.participant.values[is_known]))
    perturbations = unique(summary.perturbation)
    remarks = dict(zip(results.recording.values, map(str, results.remarks.values), strict=True))
    render(
        path,
        "experiment.html",
        **common(results, claims, settings_of(results, "experiment"), "recording or method"),
        participants=len(people),
        virtual="all" if virtual == len(people) else "some" if virtual else "none",
        kept=kept(results, summary, reported),
        perturbation=perturbation_name(perturbations[0]) if len(perturbations) == 1 else "",
        metrics=metrics(summary, bootstraps),
        of_participants=metrics(summary, bootstraps, ["participant"]),
        recordings=recordings(results, exclusions, reported),
        remarks={label: text.splitlines() for label, text in remarks.items() if text},
        pictures={stem: each for stem, each in pictures.items() if stem not in DETAILS},
        details={stem: each for stem, each in pictures.items() if stem in DETAILS},
        command=command,
    )


def kept(results: xr.Dataset, summary: pd.DataFrame, reported: Reported) -> list[dict[str, Any]]:
    """Return realizations kept and the best methods by perturbation.

    The methods are compared by their means over participants, each from its least data.
    """
    least = summary.groupby("method").realizations.transform("min")
    groups = summary[summary.realizations == least].groupby(["perturbation", "method", "metric"])
    means = groups.value.agg(value="mean", standard_error="std").reset_index()
    return [
        {
            "perturbation": perturbation_name(perturbation),
            "kept": in_text(mine.survivors.mean(), mine.survivors.std(), 0),
            "recorded": " to ".join(map(str, sorted({mine.recorded.min(), mine.recorded.max()}))),
            "paper": of_paper(mine, reported.get(str(perturbation))),
            "best": best_methods(means[means.perturbation == perturbation]),
        }
        for perturbation, mine in counts_of(results).groupby("perturbation", sort=False)
    ]


def metrics(summary: pd.DataFrame, bootstraps: int, each: Sequence[str] = ()) -> pd.DataFrame:
    """Return the metrics by perturbation, method and amount of data, and by ``each`` of others.

    Numbers are the mean ± standard deviation over participants.
    """
    named = summary.assign(perturbation=summary.perturbation.map(perturbation_name))
    by = [*each, "method", "perturbation", "realizations"]
    groups = named.groupby([*by, "metric"], sort=False).value
    means, deviations = groups.mean().unstack(sort=False), groups.std().unstack(sort=False)
    failed = groups.agg(["sum", "count"]).xs("failed", level="metric")
    table = means[[]].assign(
        **metric_columns(means, deviations),
        **{
            "failed draws": [
                f"{number:.0f} of {bootstraps * people:.0f}"
                for number, people in failed.loc[means.index].to_numpy()
            ]
        },
    )
    table = table.reset_index().rename(columns={"realizations": "realizations drawn"})
    return table if named.perturbation.nunique() > 1 else table.drop(columns="perturbation")


def counts_of(results: xr.Dataset) -> pd.DataFrame:
    """Return the counts of realizations of each recording that has any."""
    table = results[list(COUNTS)].to_dataframe()[["perturbation", *COUNTS]]
    return table[table.recorded > 0]


def of_paper(counts: pd.DataFrame, theirs: Sequence[str] | None) -> Sequence[str]:
    """Return the paper's counts, if one of the recordings has as many realizations."""
    return theirs if theirs and theirs[0] in unique(counts.recorded) else ()


def recordings(
    results: xr.Dataset, exclusions: pd.DataFrame, reported: Reported = MappingProxyType({})
) -> pd.DataFrame:
    """Return the counts of kept and excluded realizations, and those of the paper."""
    import pandas as pd  # noqa: PLC0415  # heavy

    shifts = exclusions[exclusions.excluded_by == ""].groupby("recording").shift_s
    late = {label: in_text(1000 * each.mean(), 1000 * each.std(), 0) for label, each in shifts}
    table = results[list(COUNTS)].to_dataframe()[list(COUNTS)].reset_index()
    rows = [[*row, late.get(row[0], "–")] for row in table.itertuples(index=False)]
    totals = []
    for perturbation, mine in counts_of(results).groupby("perturbation", sort=False):
        name, numbers = perturbation_name(perturbation), [mine[each] for each in COUNTS]
        if len(mine) > 1:
            cells = [in_text(each.mean(), each.std(), int(each.nunique() > 1)) for each in numbers]
            totals.append([f"mean ± SD, {name}", *cells, ""])
        if theirs := of_paper(mine, reported.get(str(perturbation))):
            totals.append([f"the paper’s, {name}", *theirs, ""])
    index = ["recording"] * len(rows) + ["total"] * len(totals)
    columns = ["recording", *COUNTS.values(), "shift (ms)"]
    return pd.DataFrame([*rows, *totals], index, columns, dtype=object)
