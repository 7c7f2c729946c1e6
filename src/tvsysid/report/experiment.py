"""The page of an experiment."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from tvsysid.figures import Picture
from tvsysid.figures.results import truth, unique
from tvsysid.figures.words import count, perturbation_name
from tvsysid.numerics import Array
from tvsysid.report import alignment, page, sections

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
# Column headings of the counts of realizations
COUNTS = {
    "recorded": "recorded",
    "excluded_alignment": "excluded: shift",
    "excluded_task": "excluded: task component",
    "excluded_residual": "excluded: residual",
    "survivors": "kept",
}
CLAIMS = (
    "What van de Ruit et al. (2021) say of their experiment, and whether these recordings show it. "
    "Estimate and limits (95 %) are those of the value that decides."
)
KNOWN = {
    "all": "The participants are virtual: their true stiffness is known.",
    "some": "Some participants are virtual: their true stiffness is known.",
    "none": "The true stiffness is not known.",
}


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
    draws = results.vaf.values
    failed = int(np.count_nonzero(np.isnan(draws)))
    labels, people = unique(results.method_key.values), unique(results.participant.values)
    virtual = unique(results.participant.values[np.isfinite(truth(results).values).any(axis=1)])
    methods, participants = count(len(labels), "method"), count(len(people), "participant")
    recorded = count(results.sizes["recording"], "recording")
    known = "all" if len(virtual) == len(people) else "some" if virtual else "none"
    done = (
        f"{recorded} of {participants}; {methods} with one or more amounts of data, "
        f"{count(results.sizes['bootstrap'], 'bootstrap')} each; "
        f"{count(draws.size, 'identification')} in all, of which {failed or 'none'} failed."
    )
    shown = {stem: each for stem, each in pictures.items() if stem not in DETAILS}
    details = {stem: each for stem, each in pictures.items() if stem in DETAILS}
    settings = {
        name.replace("_", " "): value
        for name, value in sections.settings_of(results, "experiment").items()
    }
    first, smallest = str(results.recording.values[0]), str(results.analysis.values[0])
    lines = [
        done,
        *outcome(results, summary, claims, reported),
    ]
    shifted = [] if aligned is None or not len(aligned) else [alignment.alignment_table(aligned)]
    if aligned is not None and shifted:
        lines.append(
            f"{alignment.sentence(aligned)} "
            f"{alignment.REMEDY if len(alignment.notable(aligned)) else ''}"
        )
    parts = [
        page.Section(
            "outcome", "Outcome", [page.Box(lines), _definitions(bool(virtual), len(people) > 1)]
        ),
        *([page.Section("figures", "Figures", sections.numbered(shown))] if shown else []),
        page.Section("metrics", "Metrics", metrics(summary, results.sizes["bootstrap"]), wide=True),
        sections.claims_section(claims, CLAIMS, fold=True),
        page.Section(
            "recordings",
            "Recordings and exclusions",
            [
                recordings(results, exclusions, reported),
                *shifted,
                page.Heading("Files and trials", "remarks"),
                *_remarks(results),
                *sections.numbered(details, 1 + len(shown)),
            ],
            contents="Recordings",
            wide=True,
        ),
        sections.problems_section(sections.problems(results), "recording or method"),
        sections.methods_section(labels),
        sections.run_section(
            results, settings, float(np.nansum(results.seconds.values)), f"{failed} of {draws.size}"
        ),
        sections.again_section(
            command,
            f'results.estimate.sel(quantity="stiffness", recording="{first}", '
            f'analysis="{smallest}")  # N·m/rad',
            same="The same files, settings and version give the same numbers, except for computing "
            "times.",
        ),
    ]
    title = f"Time-varying joint stiffness of {participants}"
    subtitle = f"{methods} applied to {recorded}. {KNOWN[known]}"
    page.write_page(path, page.Page(title, subtitle, parts, sections.version_of(results)))


def _definitions(known: bool, several: bool) -> str:
    """Explain the numbers."""
    bias = (
        " Bias is the mean estimate over bootstraps minus the true stiffness: bias error is its "
        "root mean square over time, mean bias its mean over time."
    )
    return (
        "A bootstrap draws realizations with replacement from those that were kept. Random error "
        "is the spread of the "
        "estimated stiffness over bootstraps. VAF (variance accounted for) is the share of the "
        "recorded torque, after "
        "its mean over realizations is subtracted, that the identified model predicts; it is "
        "computed in the same "
        f"realizations that the model was identified from.{bias * known}"
        f"{' After ± stands one standard deviation over participants.' * several}"
    )


def over_participants(values: Array, decimals: int | None) -> page.Cell:
    """Return mean ± standard deviation of the known values; of one value no deviation."""
    known = values[np.isfinite(values)]
    if not len(known):
        return page.number(math.nan)
    spread = float(known.std(ddof=1)) if len(known) > 1 else math.nan
    return page.number(float(known.mean()), spread, decimals)


def metrics(summary: pd.DataFrame, bootstraps: int) -> list[page.Block]:
    """Return the metrics of each method, amount of data and perturbation.

    Those of every participant fold away.
    """
    if not len(summary):
        return ["There is none yet."]
    blocks: list[page.Block] = [_metrics(summary, bootstraps, "method")]
    if summary.participant.nunique() > 1:
        blocks.append(page.Fold("Each participant", [_metrics(summary, bootstraps, "participant")]))
    return blocks


def _metrics(summary: pd.DataFrame, bootstraps: int, each: str) -> page.Table:
    """Return the metrics for each ``"method"`` over participants, or ``"participant"``."""
    alone, several = each == "participant", summary.participant.nunique() > 1
    names, perturbations = sections.metrics_there(summary, METRICS), unique(summary.perturbation)
    heads = [
        *(["participant"] if alone else []),
        "method",
        *(["perturbation"] if len(perturbations) > 1 else []),
    ]
    rows, nothing = [], np.zeros(0)
    by = [*(["participant"] if alone else []), "perturbation", "method", "realizations"]
    for _, mine in summary.groupby(by, sort=False):
        values = {
            str(name): group.value.to_numpy(dtype=float) for name, group in mine.groupby("metric")
        }
        first = mine.assign(perturbation=mine.perturbation.map(perturbation_name)).iloc[0]
        drawn, failed = (
            int(mine.realizations.iloc[0]),
            int(np.nansum(values.get("failed", nothing))),
        )
        cells: list[page.Cell | str | float] = [str(first[name]) for name in heads]
        cells.append(page.Cell(str(drawn), drawn))
        cells += [over_participants(values.get(name, nothing), METRICS[name][2]) for name in names]
        cells.append(page.Cell(f"{failed} of {bootstraps * mine.participant.nunique()}", failed))
        rows.append(page.Row(cells))
    of = (
        " for each participant"
        if alone
        else ", mean ± standard deviation over participants"
        if several
        else ""
    )
    one = (
        f"; perturbation: {perturbation_name(perturbations[0])}" if len(perturbations) == 1 else ""
    )
    columns = [
        *(page.Column(heading, kind="label") for heading in heads),
        page.Column("realizations drawn", kind="number"),
        *(
            page.Column(heading, unit, "number")
            for heading, unit, _ in (METRICS[name] for name in names)
        ),
        page.Column("failed draws", kind="number"),
    ]
    return page.Table(
        f"Metrics of each {each}",
        f"Metrics of each method{of}{one}. Click a heading to sort.",
        columns,
        rows,
        f"{'participants' if alone else 'metrics'}-table",
        sortable=True,
        narrow=True,
    )


def recordings(
    results: xr.Dataset, exclusions: pd.DataFrame, reported: Reported = MappingProxyType({})
) -> page.Table:
    """Return the counts of kept and excluded realizations, and those of the paper."""
    shifts = {
        str(label): 1000 * mine.shift_s[mine.excluded_by == ""].to_numpy(dtype=float)
        for label, mine in exclusions.groupby("recording", sort=False)
    }
    rows = []
    for label in map(str, results.recording.values):
        here = results.sel(recording=label)
        counts = [int(here[name]) for name in ("trials", "trials_left_out", *COUNTS)]
        rows.append(
            page.Row([label, *counts, over_participants(shifts.get(label, np.zeros(0)), 0)])
        )
    means, paper = [], []
    for perturbation, chosen in _by_perturbation(results):
        name = perturbation_name(perturbation)
        if chosen.sizes["recording"] > 1:
            values = [chosen[name].values.astype(float) for name in COUNTS]
            cells = [over_participants(each, 1 if np.ptp(each) else 0) for each in values]
            means.append(page.Row([f"mean ± SD, {name}", "", "", *cells, ""], total=True))
        theirs = reported.get(perturbation)
        if theirs and theirs[0] in unique(chosen.recorded.values):
            paper.append(page.Row([f"the paper’s, {name}", "10", "", *theirs, ""], total=True))
    caption = (
        "What became of the realizations of each recording. Excluded are those whose alignment to "
        "the torque to be followed takes too large a shift, and those whose component at the "
        "task’s frequency or whose low-passed residual differs too much from the others’. Shifts "
        "are those of the realizations kept, mean ± standard deviation, positive where the torque "
        "came late."
    )
    headings = ("trials", "trials left out", *COUNTS.values())
    columns = [
        page.Column("recording", kind="label"),
        *(page.Column(heading, kind="number") for heading in headings),
    ]
    columns.append(page.Column("shift", "ms", "number"))
    return page.Table(
        "Recordings and exclusions", caption, columns, [*rows, *means, *paper], narrow=True
    )


def _by_perturbation(results: xr.Dataset) -> list[tuple[str, xr.Dataset]]:
    """Return the recordings with realizations under each perturbation."""
    recorded = results.isel(recording=results.recorded.values > 0)
    return [
        (perturbation, recorded.isel(recording=recorded.perturbation.values == perturbation))
        for perturbation in unique(recorded.perturbation.values)
    ]


def _remarks(results: xr.Dataset) -> list[page.Block]:
    """Return the remarks on recordings."""
    from markupsafe import Markup  # noqa: PLC0415  # only a page needs it

    blocks: list[page.Block] = []
    for label, text in zip(results.recording.values, results.remarks.values, strict=True):
        if lines := [line.strip() for line in str(text).splitlines() if line.strip()]:
            blocks += [Markup("<strong>{}</strong>").format(label), page.Bullets(lines)]
    return blocks or ["Nothing was left out, and there were no warnings."]


def outcome(
    results: xr.Dataset,
    summary: pd.DataFrame,
    claims: pd.DataFrame,
    reported: Reported = MappingProxyType({}),
) -> list[str]:
    """Describe the main result in sentences."""
    sentences = []
    for perturbation, chosen in _by_perturbation(results):
        recorded = unique(chosen.recorded.values)
        kept = over_participants(chosen.survivors.values.astype(float), 0).text
        of = (
            recorded[0]
            if len(recorded) == 1
            else f"{min(map(int, recorded))} to {max(map(int, recorded))}"
        )
        theirs = reported.get(perturbation)
        paper = (
            f" (the paper: {theirs[-1]} of {theirs[0]})"
            if theirs and recorded == [theirs[0]]
            else ""
        )
        sentences.append(
            f"With {perturbation_name(perturbation)}, {kept} of {of} realizations were "
            f"kept{paper}.{_extremes(summary[summary.perturbation == perturbation])}"
        )
    return [*sentences, *sections.verdicts(claims)]


def _extremes(rows: pd.DataFrame) -> str:
    """Return the methods with the lowest and highest main metrics, each from its least data."""
    parts = []
    for metric in ("random_error", "vaf", "mean_bias"):
        heading, unit, decimals = METRICS[metric]
        each = {}
        for method, mine in rows[rows.metric == metric].groupby("method", sort=False):
            values = mine.value[mine.realizations == mine.realizations.min()].to_numpy(dtype=float)
            if np.isfinite(values).any():
                each[str(method)] = over_participants(values, decimals)
        order = sorted(each, key=lambda method: each[method].value or 0.0)
        if len(order) == 1:
            parts.append(f"{heading} {each[order[0]].text} {unit} ({order[0]})")
        elif order:
            low, high = order[0], order[-1]
            parts.append(
                f"{heading} from {each[low].text} ({low}) to {each[high].text} {unit} ({high})"
            )
    return f" With the least data of each method: {'; '.join(parts)}." if parts else ""
