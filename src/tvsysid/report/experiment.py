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
from tvsysid.figures.style import Array
from tvsysid.figures.words import count, perturbation_name
from tvsysid.report.page import (
    Block,
    Box,
    Bullets,
    Cell,
    Column,
    Fold,
    Heading,
    Page,
    Row,
    Section,
    Table,
    number,
    write_page,
)
from tvsysid.report.sections import (
    again_section,
    claims_section,
    methods_section,
    metrics_there,
    numbered,
    problems,
    problems_section,
    run_section,
    settings_of,
    unfinished,
    verdicts,
    version_of,
)

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

Reported = Mapping[str, Sequence[str]]

DETAILS = ("recorded-signals", "preparation")
"""Figures that stand beside the account of the recordings."""
METRICS = {
    "mean_stiffness": ("mean stiffness", "N·m/rad", 1),
    "random_error": ("random error", "N·m/rad", 2),
    "vaf": ("VAF", "%", 1),
    "bandpassed_vaf": ("VAF 1-10 Hz", "%", 1),
    "lowest_time_varying_vaf": ("lowest VAF over time", "%", 1),
    "bias_error": ("bias error", "N·m/rad", 2),
    "mean_bias": ("mean bias", "N·m/rad", 2),
    "seconds": ("computing time", "s", 2),
}
"""Heading, unit and decimals of each column of the table of metrics."""
COUNTS = {
    "recorded": "recorded",
    "excluded_alignment": "excluded: shift",
    "excluded_task": "excluded: task component",
    "excluded_residual": "excluded: residual",
    "survivors": "kept",
}
"""Heading of each count of realizations."""
CLAIMS = (
    "What van de Ruit et al. (2021) say of their experiment, and whether these recordings show it. Estimate and limits "
    "(95 %) are those of the value that decides."
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
) -> None:
    """Write one HTML file that holds all of an experiment's outcome and needs nothing else.

    Parameters
    ----------
    path
        Of the file, which appears whole or not at all.
    results
        Over recording, analysis, bootstrap and time, as of :func:`tvsysid.study.run`.
    summary
        Of these results: columns participant, perturbation, method, realizations, metric, value, unit.
    claims
        What the paper says of its experiment and whether it holds here; may have no rows.
    exclusions
        A row for each realization recorded: columns recording, excluded_by and shift_s are used.
    pictures
        As of :func:`tvsysid.figures.draw_all`.
    command
        What was typed to analyse the experiment; the page says nothing of it if empty.
    reported
        Realizations recorded, excluded by each step, and kept, as a paper reports them, by perturbation; shown beside
        recordings of as many realizations.
    """
    there = results.checksums.transpose("recording", "analysis", ...).values.any(axis=-1)
    draws = results.vaf.transpose("recording", "analysis", "bootstrap").values[there]
    failed = int(np.count_nonzero(np.isnan(draws)))
    labels, people = unique(results.method_key.values), unique(results.participant.values)
    virtual = unique(results.participant.values[np.isfinite(truth(results).values).any(axis=1)])
    methods, participants = count(len(labels), "method"), count(len(people), "participant")
    recorded = count(results.sizes["recording"], "recording")
    known = "all" if len(virtual) == len(people) else "some" if virtual else "none"
    done = (
        f"{recorded} of {participants}; {methods} with one or more amounts of data, "
        f"{count(results.sizes['bootstrap'], 'bootstrap')} each; {count(draws.size, 'identification')} in all, "
        f"of which {failed or 'none'} failed."
    )
    shown = {stem: each for stem, each in pictures.items() if stem not in DETAILS}
    details = {stem: each for stem, each in pictures.items() if stem in DETAILS}
    settings = {name.replace("_", " "): value for name, value in settings_of(results, "experiment").items()}
    first, smallest = str(results.recording.values[0]), str(results.analysis.values[0])
    lines = [done, *unfinished(results, "analyses"), *outcome(results, summary, claims, reported)]
    sections = [
        Section("outcome", "Outcome", [Box(lines), _definitions(bool(virtual), len(people) > 1)]),
        *([Section("figures", "Figures", numbered(shown))] if shown else []),
        Section("metrics", "Metrics", metrics(summary, results.sizes["bootstrap"]), wide=True),
        claims_section(claims, CLAIMS, fold=True),
        Section(
            "recordings",
            "Recordings and exclusions",
            [
                recordings(results, exclusions, reported),
                Heading("Files and trials", "remarks"),
                *_remarks(results),
                *numbered(details, 1 + len(shown)),
            ],
            contents="Recordings",
            wide=True,
        ),
        problems_section(problems(results), "recording or analysis"),
        methods_section(labels),
        run_section(results, settings, float(np.nansum(results.seconds.values)), f"{failed} of {draws.size}"),
        again_section(
            command,
            f'results.estimate.sel(quantity="stiffness", recording="{first}", analysis="{smallest}")  # N·m/rad',
            same="The same files, settings and version give the same numbers, except for computing times.",
        ),
    ]
    title = f"Time-varying joint stiffness of {participants}"
    write_page(path, Page(title, f"{methods} applied to {recorded}. {KNOWN[known]}", sections, version_of(results)))


def _definitions(known: bool, several: bool) -> str:
    """What the numbers mean."""
    bias = (
        " Bias is the mean estimate over bootstraps minus the true stiffness: bias error is its root mean square over "
        "time, mean bias its mean over time."
    )
    return (
        "A bootstrap draws realizations with replacement from those that were kept. Random error is the spread of the "
        "estimated stiffness over bootstraps. VAF (variance accounted for) is the share of the recorded torque, after "
        "its mean over realizations is subtracted, that the identified model predicts; it is computed in the same "
        f"realizations that the model was identified from.{bias * known}"
        f"{' After ± stands one standard deviation over participants.' * several}"
    )


def over_participants(values: Array, decimals: int | None) -> Cell:
    """Mean ± standard deviation of the values that are there; no deviation of a single one."""
    known = values[np.isfinite(values)]
    if not len(known):
        return number(math.nan)
    spread = float(known.std(ddof=1)) if len(known) > 1 else math.nan
    return number(float(known.mean()), spread, decimals)


def metrics(summary: pd.DataFrame, bootstraps: int) -> list[Block]:
    """Metrics of each method, amount of data and perturbation; those of every participant fold away."""
    if not len(summary):
        return ["There is none yet."]
    blocks: list[Block] = [_metrics(summary, bootstraps, "method")]
    if summary.participant.nunique() > 1:
        blocks.append(Fold("Each participant", [_metrics(summary, bootstraps, "participant")]))
    return blocks


def _metrics(summary: pd.DataFrame, bootstraps: int, each: str) -> Table:
    """Table of metrics for each ``"method"`` over participants, or for each ``"participant"``."""
    alone, several = each == "participant", summary.participant.nunique() > 1
    names, perturbations = metrics_there(summary, METRICS), unique(summary.perturbation)
    heads = [*(["participant"] if alone else []), "method", *(["perturbation"] if len(perturbations) > 1 else [])]
    rows, nothing = [], np.zeros(0)
    by = [*(["participant"] if alone else []), "perturbation", "method", "realizations"]
    for _, mine in summary.groupby(by, sort=False):
        values = {str(name): group.value.to_numpy(dtype=float) for name, group in mine.groupby("metric")}
        first = mine.assign(perturbation=mine.perturbation.map(perturbation_name)).iloc[0]
        drawn, failed = int(mine.realizations.iloc[0]), int(np.nansum(values.get("failed", nothing)))
        cells: list[Cell | str | float] = [str(first[name]) for name in heads]
        cells.append(Cell(str(drawn), drawn))
        cells += [over_participants(values.get(name, nothing), METRICS[name][2]) for name in names]
        cells.append(Cell(f"{failed} of {bootstraps * mine.participant.nunique()}", failed))
        rows.append(Row(cells))
    of = " for each participant" if alone else ", mean ± standard deviation over participants" if several else ""
    one = f"; perturbation: {perturbation_name(perturbations[0])}" if len(perturbations) == 1 else ""
    columns = [
        *(Column(heading, kind="label") for heading in heads),
        Column("realizations drawn", kind="number"),
        *(Column(heading, unit, "number") for heading, unit, _ in (METRICS[name] for name in names)),
        Column("failed draws", kind="number"),
    ]
    return Table(
        f"Metrics of each {each}",
        f"Metrics of each method{of}{one}. Click a heading to sort.",
        columns,
        rows,
        f"{'participants' if alone else 'metrics'}-table",
        sortable=True,
        narrow=True,
    )


def recordings(results: xr.Dataset, exclusions: pd.DataFrame, reported: Reported = MappingProxyType({})) -> Table:
    """What became of the realizations of each recording, their means for each perturbation, and the paper's counts."""
    shifts = {
        str(label): 1000 * mine.shift_s[mine.excluded_by == ""].to_numpy(dtype=float)
        for label, mine in exclusions.groupby("recording", sort=False)
    }
    rows = []
    for label in map(str, results.recording.values):
        here = results.sel(recording=label)
        counts = [int(here[name]) for name in ("trials", "trials_left_out", *COUNTS)]
        rows.append(Row([label, *counts, over_participants(shifts.get(label, np.zeros(0)), 0)]))
    means, paper = [], []
    for perturbation, chosen in _by_perturbation(results):
        name = perturbation_name(perturbation)
        if chosen.sizes["recording"] > 1:
            values = [chosen[name].values.astype(float) for name in COUNTS]
            cells = [over_participants(each, 1 if np.ptp(each) else 0) for each in values]
            means.append(Row([f"mean ± SD, {name}", "", "", *cells, ""], total=True))
        theirs = reported.get(perturbation)
        if theirs and theirs[0] in unique(chosen.recorded.values):
            paper.append(Row([f"the paper’s, {name}", "10", "", *theirs, ""], total=True))
    caption = (
        "What became of the realizations of each recording. Excluded are those whose alignment to the torque to be "
        "followed takes too large a shift, and those whose component at the task’s frequency or whose low-passed "
        "residual differs too much from the others’. Shifts are those of the realizations kept, mean ± standard "
        "deviation, positive where the torque came late."
    )
    headings = ("trials", "trials left out", *COUNTS.values())
    columns = [Column("recording", kind="label"), *(Column(heading, kind="number") for heading in headings)]
    columns.append(Column("shift", "ms", "number"))
    return Table("Recordings and exclusions", caption, columns, [*rows, *means, *paper], narrow=True)


def _by_perturbation(results: xr.Dataset) -> list[tuple[str, xr.Dataset]]:
    """Recordings under each perturbation of which there are realizations."""
    recorded = results.isel(recording=results.recorded.values > 0)
    return [
        (perturbation, recorded.isel(recording=recorded.perturbation.values == perturbation))
        for perturbation in unique(recorded.perturbation.values)
    ]


def _remarks(results: xr.Dataset) -> list[Block]:
    """Recordings about which something was remarked, and what."""
    from markupsafe import Markup  # noqa: PLC0415  # only a page needs it

    blocks: list[Block] = []
    for label, text in zip(results.recording.values, results.remarks.values, strict=True):
        if lines := [line.strip() for line in str(text).splitlines() if line.strip()]:
            blocks += [Markup("<strong>{}</strong>").format(label), Bullets(lines)]
    return blocks or ["Nothing was left out, and there were no warnings."]


def outcome(
    results: xr.Dataset, summary: pd.DataFrame, claims: pd.DataFrame, reported: Reported = MappingProxyType({})
) -> list[str]:
    """The main outcome in sentences."""
    sentences = []
    for perturbation, chosen in _by_perturbation(results):
        recorded = unique(chosen.recorded.values)
        kept = over_participants(chosen.survivors.values.astype(float), 0).text
        of = recorded[0] if len(recorded) == 1 else f"{min(map(int, recorded))} to {max(map(int, recorded))}"
        theirs = reported.get(perturbation)
        paper = f" (the paper: {theirs[-1]} of {theirs[0]})" if theirs and recorded == [theirs[0]] else ""
        sentences.append(
            f"With {perturbation_name(perturbation)}, {kept} of {of} realizations were kept{paper}."
            f"{_extremes(summary[summary.perturbation == perturbation])}"
        )
    return [*sentences, *verdicts(claims)]


def _extremes(rows: pd.DataFrame) -> str:
    """Which methods have the lowest and the highest value of the main metrics, each from its least data."""
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
            parts.append(f"{heading} from {each[low].text} ({low}) to {each[high].text} {unit} ({high})")
    return f" With the least data of each method: {'; '.join(parts)}." if parts else ""
