"""The page of an experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from tvsysid.figures import Picture
from tvsysid.figures.results import of_quantity, unique
from tvsysid.figures.words import perturbation_name
from tvsysid.report import alignment
from tvsysid.report.page import in_text, render
from tvsysid.report.studies import common, settings_of, with_heading

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

Reported = Mapping[str, Sequence[str]]

# Figures shown in the section about the recordings
DETAILS = ("recorded-signals", "preparation")
METRICS = {
    "mean_stiffness": ("mean stiffness", "N·m/rad", 1),
    "random_error": ("random error", "N·m/rad", 2),
    "vaf": ("VAF", "%", 1),
    "bandpassed_vaf": ("VAF 1–10 Hz", "%", 1),
    "lowest_time_varying_vaf": ("lowest VAF over time", "%", 1),
    "bias_error": ("bias error", "N·m/rad", 2),
    "mean_bias": ("mean bias", "N·m/rad", 2),
    "seconds": ("time of an identification", "s", 4),
}
"""Heading, unit and decimals of each column of the table of metrics."""
EXTREMES = ("random_error", "vaf", "mean_bias")
COUNTS = {
    "trials": "trials",
    "trials_left_out": "trials left out",
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
    aligned: pd.DataFrame | None = None,
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
    aligned
        What the alignment does, as of :func:`tvsysid.study.alignments`; None, or no rows, if
        nothing was aligned.
    """
    draws, people = results.vaf.values, unique(results.participant.values)
    is_known = np.isfinite(of_quantity(results).truth.values).any(axis=1)
    virtual = len(unique(results.participant.values[is_known]))
    failed = int(np.count_nonzero(np.isnan(draws)))
    settings = settings_of(results, "experiment") | {
        "computing time": f"{round(float(np.nansum(results.seconds.values))):,} s on one core",
        "failed identifications": f"{failed} of {draws.size}",
    }
    perturbations, bootstraps = unique(summary.perturbation), results.sizes["bootstrap"]
    shifted = aligned if aligned is not None else summary.iloc[:0]
    remarks = dict(zip(results.recording.values, map(str, results.remarks.values), strict=True))
    labels = unique(results.method_key.values)
    render(
        path,
        "experiment.html",
        **common(results, claims, labels, settings, "recording or method"),
        failed=failed,
        tried=draws.size,
        participants=len(people),
        virtual="all" if virtual == len(people) else "some" if virtual else "none",
        kept=kept(results, summary, reported),
        perturbation=perturbation_name(perturbations[0]) if len(perturbations) == 1 else "",
        metrics=metrics(summary, bootstraps),
        of_participants=metrics(summary, bootstraps, ["participant"]),
        recordings=recordings(results, exclusions, reported),
        remarks={label: text.splitlines() for label, text in remarks.items() if text},
        alignment=alignment.table(shifted) if len(shifted) else shifted,
        alignment_sentence=alignment.sentence(shifted),
        is_notable=len(shifted) > 0 and len(alignment.notable(shifted)) > 0,
        remedy=alignment.REMEDY,
        pictures={stem: each for stem, each in pictures.items() if stem not in DETAILS},
        details={stem: each for stem, each in pictures.items() if stem in DETAILS},
        command=command,
    )


def kept(results: xr.Dataset, summary: pd.DataFrame, reported: Reported) -> list[dict[str, Any]]:
    """Return realizations kept and main metrics by perturbation, for the page's first sentences."""
    return [
        {
            "perturbation": perturbation_name(perturbation),
            "kept": mean_and_deviation(mine.survivors, 0),
            "recorded": " to ".join(map(str, sorted({mine.recorded.min(), mine.recorded.max()}))),
            "paper": of_paper(mine, reported.get(str(perturbation))),
            "extremes": extremes(summary[summary.perturbation == perturbation]),
        }
        for perturbation, mine in counts_of(results).groupby("perturbation", sort=False)
    ]


def extremes(summary: pd.DataFrame) -> list[dict[str, Any]]:
    """Return the methods with the lowest and highest main metrics, each from its least data."""
    found = []
    least = summary[summary.realizations == summary.groupby("method").realizations.transform("min")]
    for metric in EXTREMES:
        heading, unit, decimals = METRICS[metric]
        groups = least[least.metric == metric].groupby("method", sort=False).value
        means = groups.mean().dropna().sort_values()
        if len(means):
            low, high = (
                {"method": label, "value": mean_and_deviation(groups.get_group(label), decimals)}
                for label in (means.index[0], means.index[-1])
            )
            found.append({"heading": heading, "unit": unit, "low": low, "high": high})
    return found


def mean_and_deviation(values: ArrayLike, decimals: int) -> str:
    """Return mean ± standard deviation of the known values; of one value no deviation."""
    known = np.asarray(values, dtype=float)
    known = known[np.isfinite(known)]
    mean = known.mean() if len(known) else np.nan
    return in_text(mean, known.std(ddof=1) if len(known) > 1 else np.nan, decimals)


def metrics(summary: pd.DataFrame, bootstraps: int, each: Sequence[str] = ()) -> pd.DataFrame:
    """Return the metrics by perturbation, method and amount of data, and by ``each`` of others.

    Numbers are the mean ± standard deviation over participants.
    """
    import pandas as pd  # noqa: PLC0415  # heavy

    by = [*each, "method", "perturbation", "realizations"]
    names, rows = with_heading(METRICS, summary), []
    named = summary.assign(perturbation=summary.perturbation.map(perturbation_name))
    for key, mine in named.groupby(by, sort=False):
        values = dict(iter(mine.groupby("metric").value))
        cells = [mean_and_deviation(values.get(name, ()), METRICS[name][2]) for name in names]
        failed = values["failed"]
        rows.append([*key, *cells, f"{int(failed.sum())} of {bootstraps * len(failed)}"])
    headings = [f"{heading} ({unit})" for heading, unit, _ in (METRICS[name] for name in names)]
    columns = [*by[:-1], "realizations drawn", *headings, "failed draws"]
    table = pd.DataFrame(rows, columns=columns)
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

    kept_shifts = exclusions[exclusions.excluded_by == ""].groupby("recording").shift_s
    shifts = {label: 1000 * each for label, each in kept_shifts}
    rows = [
        [label, *counts, mean_and_deviation(shifts.get(label, ()), 0)]
        for label, *counts in results[list(COUNTS)].to_dataframe()[list(COUNTS)].itertuples()
    ]
    means, papers = [], []
    for perturbation, mine in counts_of(results).groupby("perturbation", sort=False):
        name = perturbation_name(perturbation)
        if len(mine) > 1:
            cells = [
                mean_and_deviation(mine[each], int(mine[each].nunique() > 1))
                for each in list(COUNTS)[2:]
            ]
            means.append([f"mean ± SD, {name}", "", "", *cells, ""])
        if theirs := of_paper(mine, reported.get(str(perturbation))):
            papers.append([f"the paper’s, {name}", "10", "", *theirs, ""])
    index = ["recording"] * len(rows) + ["total"] * len([*means, *papers])
    columns = ["recording", *COUNTS.values(), "shift (ms)"]
    return pd.DataFrame([*rows, *means, *papers], index, columns, dtype=object)
