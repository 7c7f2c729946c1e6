"""Page of one identification: the stiffness to report, its reasons and its trustworthiness."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path

import numpy as np

from tvsysid.errors import by_text
from tvsysid.figures import (
    Illustration,
    draw_all,
    identified_impedance,
    scheduled_estimates,
    variable_of,
)
from tvsysid.figures.identification import drawn_quantities
from tvsysid.figures.words import count, unit_name
from tvsysid.methods.adaptive.model import AdaptiveModel
from tvsysid.numerics.bands import mean_of
from tvsysid.recommendation.trust import sentence
from tvsysid.report import page
from tvsysid.report.answer import (
    IMPEDANCE_UNITS,
    Account,
    answer,
    further,
    others,
    reflex_shape,
    switches,
    taken,
    why_leading,
    with_reflex,
)
from tvsysid.report.diagnosis import findings_table
from tvsysid.report.paragraph import methods_bibliography, methods_paragraph, settings_of

BAND = (
    "At each time, the true value should lie in the band with a probability of 95 %. The band "
    "counts noise, and nothing that the method smooths away."
)
ADAPTIVE_BAND = (
    "At each time, the true value should lie in the band with a probability of 95 %. The band "
    "counts noise, and how unsure the method is of how fast stiffness changes and of when it "
    "switches."
)
VAF = (
    "VAF is the share of the torque’s variance that a model predicts; a prediction worse than none "
    "counts as 0. In sample, it is that of the data that the model was identified from, and rises "
    "with every parameter, whatever it means. Held out, it is that of realizations that the model "
    "was not identified from: compare methods by this one. For this, adaptive keeps the smooth "
    "part and the number of switches that it found in all realizations, and fits their amplitudes "
    "and places anew. Noise of the torque, which nothing predicts, keeps both below 100 %. A high "
    "VAF does not make a stiffness right: a reflex that is taken for stiffness is predicted too."
)


def write_identification(path: str | Path, account: Account, command: str = "") -> None:
    """Write one HTML file that says what was identified and how, and needs nothing else.

    Parameters
    ----------
    path
        Of the file, which appears whole or not at all.
    account
        What was found, and what is known of it.
    command
        What was typed, if it is to be mentioned.

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
    pictures = draw_all(_illustrations(account))
    figures: list[page.Block] = [
        page.Figure(f"{stem}-figure", picture, place, saved=False)
        for place, (stem, picture) in enumerate(pictures.items(), 1)
    ]
    in_front = ("answer" in pictures) + ("variable" in pictures)
    parts = [
        _outcome(account, figures[:in_front]),
        _made(account),
        _diagnosed(account),
        _suited(account),
        _methods(account, figures[in_front:]),
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


def _illustrations(account: Account) -> dict[str, Illustration]:
    """Return the answer, estimates over a variable, and a comparison if methods are several."""
    found, label = account.found, account.found.leading
    withdrawn = account.trust.level == "none"
    shown = {} if withdrawn else {"answer": {label: found.models[label]}}
    shown |= {"methods": dict(found.models)} if withdrawn or len(found.models) > 1 else {}
    titles = {
        "answer": f"Impedance over time by {label}",
        "methods": "Impedance over time by all methods",
    }
    vaf, variable = found.time_varying_vaf, variable_of(found.models, found.ensemble)
    below = ", and the time-varying VAF" if vaf else ""
    drawn = {}
    for stem, models in shown.items():
        *names, last = (name.replace("_", " ") for name in drawn_quantities(models, variable))
        what = f"{', '.join(names)} and {last}"
        text = f"{what.capitalize()} by {label}" if stem == "answer" else f"Each method’s {what}"
        picture = partial(identified_impedance, models, vaf, but_over=variable)
        drawn[stem] = Illustration(picture, titles[stem], f"{text}, with 95 % bands{below}.")
    if not variable or withdrawn:
        return drawn
    text = (
        f"Quantities that follow {variable}, with 95 % bands, above how long {variable} was near "
        "each of its values."
    )
    picture = partial(scheduled_estimates, found.models, found.ensemble, variable)
    return {
        "answer": drawn.pop("answer"),
        "variable": Illustration(picture, f"Estimates over {variable}", text),
    } | drawn


def _outcome(account: Account, figures: list[page.Block]) -> page.Section:
    """Return the answer in a box, in pictures and in numbers."""
    found, trust, label = account.found, account.trust, account.found.leading
    first, *rest = answer(account)
    lines = [sentence(first), *([" ".join(map(sentence, rest))] if rest else [])]
    if trust.level == "none":
        blocks: list[page.Block] = [page.Box([*lines, _judged(account)]), *figures]
        return page.Section("outcome", "No stiffness is stated", blocks, contents="Stiffness")
    lines += [*filter(None, [why_leading(account)]), *_differing(account), _trust(account)]
    band = ADAPTIVE_BAND if isinstance(found.models[label], AdaptiveModel) else BAND
    blocks = [page.Box(lines), band, *figures, *_quantities(account), *_switches(account)]
    return page.Section("outcome", "The stiffness to report", blocks, contents="Stiffness")


def _differing(account: Account) -> list[str]:
    """Describe the mean results of the other methods, and where the page explains them."""
    from markupsafe import Markup  # noqa: PLC0415  # only a page needs it

    if not (means := others(account.found)):
        return []
    blamed = with_reflex(account)
    who = "all" if len(blamed) == len(account.found.models) - 1 else ", ".join(blamed)
    told = f" ({who} have one pathway, which takes a reflex for stiffness)" if blamed else ""
    text = 'By the other methods it is {} on average{}; <a href="#methods">why they differ</a>.'
    return [Markup(text).format(means, told)]


def _trust(account: Account) -> str:
    """Describe held-out VAF and diagnosis in a sentence each."""
    held_out, inside = (
        account.held_out_mean(account.found.leading),
        mean_of(account.found.vaf[account.found.leading]),
    )
    sentences = []
    if math.isfinite(held_out):
        where = account.where_held_out
        sentences.append(
            f"It predicts {held_out:.1f} % of the torque’s variance in {where} that were held out."
        )
    elif math.isfinite(inside):
        sentences.append(
            f"It predicts {inside:.1f} % of the variance of the torque that it was identified from."
        )
    return " ".join([*sentences, _judged(account)])


def _judged(account: Account) -> str:
    """Return the diagnosis in a sentence."""
    if account.diagnosis is None:
        return f"The data were not diagnosed: {account.undiagnosed}."
    titles = ", ".join(each.fault.title.lower() for each in account.diagnosis.findings)
    return f"Diagnosis of the data: {account.diagnosis.verdict}{': ' if titles else ''}{titles}."


def _quantities(account: Account) -> list[page.Block]:
    """Return a table of every quantity over time by the leading method."""
    found, label = account.found, account.found.leading
    model, rows = found.models[label], []
    for name, (lower, upper) in found.bands[label].items():
        values = model.over_time(name)
        if not np.isfinite(values).any():
            continue
        low, high = int(np.nanargmin(values)), int(np.nanargmax(values))
        ends = [
            cell
            for at in (low, high)
            for cell in (page.number(values[at]), page.number(model.time[at], decimals=2))
        ]
        unit = IMPEDANCE_UNITS.get(name) or unit_name(model.estimates[name].unit)
        half = page.number(mean_of(upper - lower) / 2)
        rows.append(
            page.Row((name.replace("_", " "), unit, page.number(mean_of(values)), half, *ends))
        )
    caption = (
        f"By {label}: mean over time, half width of the pointwise 95 % band (also its mean), and "
        "both extremes."
    )
    columns = [page.Column("quantity"), page.Column("unit")]
    columns += [page.Column(heading, kind="number") for heading in ("mean", "95 % band, ±")]
    for end in ("lowest", "highest"):
        columns += [page.Column(end, kind="number"), page.Column("at", "s", "number")]
    return [page.Table("What to report", caption, columns, rows, narrow=True)] if rows else []


def _switches(account: Account) -> list[page.Block]:
    """Return tables of the sudden changes that the leading method found, likely and unlikely."""
    model = account.found.models[account.found.leading]
    rows: dict[bool, list[page.Row]] = {True: [], False: []}
    for name in IMPEDANCE_UNITS:
        for each in switches(model, name):
            cells = (
                name,
                page.number(each.time, decimals=3),
                f"{each.earliest:.3f} to {each.latest:.3f}",
                page.number(each.size, 1.96 * each.size_error, 1 if name == "stiffness" else 3),
                page.number(100 * each.probability, decimals=0),
            )
            rows[each.probability > 0.5].append(page.Row(cells))
    told = "when, most probably between which times (95 %), and by how much (± its 95 % band)."
    captions = {
        True: f"Sudden changes: {told}",
        False: f"More likely no sudden change than one, but if there is: {told}",
    }
    columns = [
        page.Column("quantity"),
        page.Column("at", "s", "number"),
        page.Column("between", "s", "number"),
    ]
    columns += [page.Column("change", kind="number"), page.Column("probability", "%", "number")]
    labels = {True: "Switches", False: "Switches that are unlikely"}
    return [
        page.Table(labels[there], captions[there], columns, rows[there], narrow=True)
        for there in rows
        if rows[there]
    ]


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
        page.Row(
            (
                *(each.method, each.quantity, each.unit, each.over),
                *(page.number(value) for value in (each.values.mean(), each.half_band)),
                *(page.number(value) for value in (each.values.min(), each.values.max())),
            )
        )
        for each in further(found)
        if each.values.size
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
