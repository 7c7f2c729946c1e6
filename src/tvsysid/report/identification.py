"""Page of one identification: the stiffness to report, its reasons and its trustworthiness."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from tvsysid.errors import by_text
from tvsysid.figures import Illustration, draw_all
from tvsysid.figures.words import count
from tvsysid.recommendation.trust import sentence
from tvsysid.report import page
from tvsysid.report.answer import (
    Account,
    further,
    reflex_shape,
    taken,
)
from tvsysid.report.diagnosis import findings_table
from tvsysid.report.outcome import VAF, illustrations, outcome
from tvsysid.report.paragraph import methods_bibliography, methods_paragraph, settings_of


def write_identification(
    path: str | Path,
    account: Account,
    command: str = "",
    figures: Mapping[str, Illustration] | None = None,
) -> None:
    """Write one HTML file that says what was identified and how, and needs nothing else.

    Parameters
    ----------
    path
        Of the file, which appears whole or not at all.
    account
        What was found, and what is known of it.
    command
        What was typed, if it is to be mentioned.
    figures
        Figures by name, if they are drawn already; as :func:`illustrations` returns them.

    Examples
    --------
    >>> import tempfile, tvsysid as tv
    >>> simulation = tv.simulate.Joint().simulate(
    ...     40, perturbation=tv.simulate.PRBS(), snr_db=10, seed=1)
    >>> recording = tv.preprocess.decimate(simulation.recording, 100)
    >>> ensemble = tv.preprocess.subtract_mean(tv.preprocess.segment(recording, period=2.0))
    >>> found = tv.compare(ensemble, ["sds", "birf"])
    >>> account = tv.report.Account(found, found.held_out_vaf(), tv.diagnose(ensemble))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     tv.report.write_identification(f"{folder}/report.html", account)
    """
    found = account.found
    name = account.source.get("file", "an ensemble")
    pictures = draw_all(figures or illustrations(account))
    shown: list[page.Block] = [
        page.Figure(f"{stem}-figure", picture, place, saved=False)
        for place, (stem, picture) in enumerate(pictures.items(), 1)
    ]
    in_front = ("answer" in pictures) + ("variable" in pictures)
    parts = [
        outcome(account, shown[:in_front]),
        _made(account),
        _diagnosed(account),
        _suited(account),
        _methods(account, shown[in_front:]),
        *_beside(account),
        _met(account),
        *_paragraph(account),
        _again(command),
    ]
    subtitle = (
        f"{count(len(found.models), 'method')} on {count(len(found.ensemble), 'realization')} of "
    )
    subtitle += f"{found.ensemble.duration:g} s: stiffness, viscosity and inertia over time."
    page.write_page(path, page.Page(f"Joint impedance identified from {name}", subtitle, parts))


def _made(account: Account) -> page.Section:
    """Return the section on the source and the processing of the data."""
    ensemble = account.found.ensemble
    rate, ratio = ensemble.sampling_rate, ensemble.angle_as_recorded.shape[-1]
    context = f"{ensemble.context / rate:g} s on either side"
    trials = len(np.unique(np.asarray(ensemble.trials)))
    rows = {
        **account.source,
        "recorded at": f"{rate * ratio:g} Hz",
        "identified at": f"{rate:g} Hz{', low-pass filtered and decimated' if ratio > 1 else ''}",
        "realizations": f"{len(ensemble)} of {ensemble.duration:g} s, from "
        f"{count(trials, 'trial')}",
        "realizations left "
        "out": f"{ensemble.left_out or 'none'}{': no context' if ensemble.left_out else ''}",
        "context": context,
        "mean over realizations": "subtracted" if ensemble.mean_subtracted else "not subtracted",
        "delay between the channels": taken(ensemble.delay_removed)
        if ensemble.delay_removed
        else "not corrected",
        "further channels": ", ".join(ensemble.channels) or "none",
    }
    if account.diagnosis is not None:
        measures = account.diagnosis.measures
        rows["perturbation"] = (
            f"{measures['angle RMS'][0]:.3g} rad RMS, 95 % of its power below "
            f"{measures['bandwidth of the angle'][0]:.3g} Hz"
        )
        rows["signal-to-noise ratio"] = (
            f"{measures['signal-to-noise ratio'][0]:.1f} dB, by the diagnosis"
        )
    columns = page.columns({"what": "", "value": "long"})
    table = page.Table(
        "Data", "Where the data come from, and what was done to them.", columns, _pairs(rows)
    )
    return page.Section("data", "How it was found", [table], contents="Data")


def _pairs(rows: dict[str, str]) -> list[page.Row]:
    return [page.Row(pair) for pair in rows.items()]


def _diagnosed(account: Account) -> page.Section:
    """Return the section on faults of the data and their remedies."""
    title = "What the diagnosis says"
    diagnosis = account.diagnosis
    if diagnosis is None:
        return page.Section(
            "diagnosis", title, [f"Not diagnosed: {account.undiagnosed}."], contents="Diagnosis"
        )
    blocks: list[page.Block] = [sentence(diagnosis.verdict)]
    blocks += findings_table(diagnosis, account.source.get("file", "the ensemble"))
    blocks += [sentence(line) for line in diagnosis.notes]
    what = (
        "the ensemble as it was identified"
        if len(account.found.ensemble) > 1
        else "the record in pieces"
    )
    blocks.append(
        f"This is {what}. tvsysid inspect FILE --diagnose, with the same options, looks at the "
        "recorded rate, where clipped and lost signals show better, and draws what it sees."
    )
    return page.Section("diagnosis", title, blocks, contents="Diagnosis")


def _suited(account: Account) -> page.Section:
    """Return the section on the recommended methods and the properties of the data."""
    suited = account.found.recommendation
    rows = [
        page.Row(
            (
                name,
                page.number(value, decimals=0 if value.is_integer() else None),
                "" if math.isnan(value) else unit,
            )
        )
        for name, (value, unit) in suited.measured.items()
    ]
    columns = [page.Column("property"), page.Column("value", kind="number"), page.Column("unit")]
    caption = (
        "What was measured in the data; nothing where it is not shown, or cannot be told from "
        "these data."
    )
    lines = [sentence(each) for each in (*suited.objections, *suited.caveats)]
    table = page.Table("Properties", caption, columns, rows, narrow=True)
    return page.Section(
        "suited",
        "Which method suits these data",
        [f"{suited.sentence}.", table, page.Bullets(lines)],
    )


def _methods(account: Account, figures: list[page.Block]) -> page.Section:
    """Return the section on all methods side by side, and their differences."""
    found = account.found
    rows = [
        page.Row(
            (
                row["method"],
                *(
                    page.number(row[f"{name} (N·m/rad)"], decimals=1)
                    for name in ("stiffness", "half_band", "lowest", "highest")
                ),
                page.number(row["inertia (kg·m²)"], decimals=4),
                page.number(row["VAF (%)"], decimals=1),
                page.number(account.held_out_mean(row["method"]), decimals=1),
            )
        )
        for row in found.summary().to_dict("records")
    ]
    unit = "N·m/rad"
    headings = {
        "mean": unit,
        "95 % band, ±": unit,
        "lowest": unit,
        "highest": unit,
        "inertia": "kg·m²",
    }
    headings |= {"VAF in sample": "%", "VAF held out": "%"}
    columns = [page.Column("method", kind="label")]
    columns += [page.Column(heading, unit, "number") for heading, unit in headings.items()]
    caption = f"Stiffness, inertia and VAF by each method. {VAF}"
    if account.trust.level == "none":
        caption = f"Not valid, for the reasons above: {caption[0].lower()}{caption[1:]}"
    table = page.Table(
        "Methods", caption, columns, rows, "methods-table", sortable=len(rows) > 1, narrow=True
    )
    return page.Section(
        "methods", "The methods side by side", [table, *figures, _differences(account)], "Methods"
    )


def _differences(account: Account) -> page.Table:
    """Return a table of each method's difference in stiffness, its cause and settings."""
    rows = []
    for label, method in account.found.methods.items():
        if label in account.found.models:
            title = str(getattr(method, "title", type(method).__name__))
            differs = (
                getattr(method, "differs", "")
                or "This is your own method: its assumptions are not known here."
            )
            rows.append(page.Row((label, title, settings_of(method) or "none", str(differs))))
    columns = page.columns(
        {"method": "label", "what it is": "", "settings": "label", "its stiffness": "long"}
    )
    return page.Table(
        "Why they differ", "Why the methods’ stiffness differs, and their settings.", columns, rows
    )


def _beside(account: Account) -> list[page.Section]:
    """Return the section on the reflex and further estimates, if there are any."""
    found = account.found
    rows = [
        page.Row((*words, *map(page.number, numbers)))
        for *words, mean, half_band, lowest, highest in further(found)
        for numbers in [(mean, half_band, lowest, highest)]
    ]
    shapes = {
        label: reflex_shape(model.diagnostics.details) for label, model in found.models.items()
    }
    told = [f"{label}: {shape}." for label, shape in shapes.items() if shape]
    if not rows and not told:
        return []
    columns = [
        page.Column(heading, kind="label" if heading == "method" else "")
        for heading in ("method", "quantity")
    ]
    columns += [page.Column("unit"), page.Column("over")]
    columns += [
        page.Column(heading, kind="number")
        for heading in ("mean", "95 % band, ±", "lowest", "highest")
    ]
    caption = "What methods estimate beside stiffness, viscosity and inertia over time."
    blocks: list[page.Block] = (
        [page.Table("Further estimates", caption, columns, rows, narrow=True)] if rows else []
    )
    return [
        page.Section(
            "beside",
            "Reflex and further estimates",
            [*blocks, *([page.Bullets(told)] if told else [])],
        )
    ]


def _met(account: Account) -> page.Section:
    """Return the section on failures, skipped methods and warnings."""
    found = account.found
    rows = [page.Row((label, "failed", reason)) for label, reason in found.failed.items()]
    rows += [page.Row((label, "skipped", reason)) for label, reason in found.skipped.items()]
    warned = (
        (label, text)
        for label, model in found.models.items()
        for text in model.diagnostics.warnings
    )
    rows += [
        page.Row((", ".join(labels), "warning", text)) for text, labels in by_text(warned).items()
    ]
    columns = page.columns({"method": "label", "what": "", "why": "long"})
    table = page.Table("Warnings", "What failed, was skipped, or gave a warning.", columns, rows)
    blocks: list[page.Block] = (
        [table] if rows else ["No method failed, none was skipped, and none gave a warning."]
    )
    return page.Section("problems", "Warnings", blocks)


def _paragraph(account: Account) -> list[page.Section]:
    """Return what was done, ready for a paper; nothing without a stiffness to report."""
    if account.trust.level == "none":
        return []
    blocks: list[page.Block] = [
        "For the methods section of a paper. Numbers and settings are those of this "
        "identification; say yourself who was measured, with which apparatus, doing what.",
        page.Box([methods_paragraph(account)]),
        "The publications cited, as BibTeX:",
        page.Code("BibTeX", methods_bibliography(account)),
    ]
    return [
        page.Section(
            "paragraph", "Methods paragraph and references", blocks, contents="For a paper"
        )
    ]


def _again(command: str) -> page.Section:
    """Return the section on how to repeat the analysis, and on its files."""
    blocks: list[page.Block] = (
        ["This command made the page:", page.Code("Command", command)] if command else []
    )
    reading = (
        "import xarray as xr\n\nmodels = "
        'xr.open_datatree("models.nc")\nmodels["METHOD"].stiffness  # over time'
    )
    blocks += [
        "All estimates with their standard errors and bands are in models.nc beside this page, and "
        "over time in stiffness.csv. To read them in Python:",
        page.Code("Reading the results", reading),
    ]
    return page.Section("again", "How to repeat it", blocks)
