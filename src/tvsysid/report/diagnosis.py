"""What a diagnosis found, as a page of its own or as a part of another."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from tvsysid.errors import InputError
from tvsysid.figures import Picture, diagnosis_illustration, draw_all
from tvsysid.figures.words import count
from tvsysid.quality import Diagnosis
from tvsysid.report import page

SYMBOLS = {"found": "✗", "uncertain": "?", "in order": "✓", "not judged": "–"}
HOW = (
    "A joint of second order, with stiffness and viscosity free in bins of 50 ms, is fitted to the "
    "deviations from the mean over realizations. The fit reveals wrong units, signs and rates; its "
    "residual reveals feedback and lost signals; how both vary over realizations reveals drift and "
    "misalignment. Models with and without one, judged by what they predict, reveal reflexes."
)
FOUND = page.columns(
    {
        **{"found": "label", "what was seen": "long", "how strong": ""},
        **{"what it does to the result": "long", "what to do": "long"},
    }
)
CHECKED = page.columns(
    {
        "what": "label",
        "verdict": "verdict",
        "how strong": "",
        "what was seen": "long",
        "measure": "long",
    }
)
MEASURED = page.columns({"measure": "", "value": "number", "unit": ""})


def write_diagnosis(
    path: str | Path,
    diagnoses: Mapping[str, Diagnosis],
    command: str = "",
    beside: Mapping[str, str] = MappingProxyType({}),
) -> None:
    """Write one HTML file that holds all that was seen and needs nothing else.

    Parameters
    ----------
    path
        Of the file, which appears whole or not at all.
    diagnoses
        Of :func:`tvsysid.diagnose`, by what the ensembles are called. ``InputError`` for anything
        else, and for none.
    command
        What was typed, if it is to be mentioned.
    beside
        What else is known of ensembles, in sentences, by their names.
    """
    from markupsafe import Markup  # noqa: PLC0415  # only a page needs it

    blocks = _blocks(diagnoses)
    lines = []
    for (name, each), anchor in zip(diagnoses.items(), _anchors(diagnoses), strict=True):
        found = "; ".join(f"{_lower(one.fault.title)} ({one.strength})" for one in each.findings)
        text = f"{each.verdict}{': ' if found else ''}{found}. {beside.get(name, '')}".rstrip()
        lines.append(Markup('<a href="#{}">{}</a>: {}').format(anchor, name, text))
    parts = [
        page.Section("outcome", "Outcome", [page.Box(lines), HOW]),
        page.Section("seen", "What was seen", blocks),
    ]
    if command:
        again: list[page.Block] = ["This command made the page:", page.Code("Command", command)]
        parts.append(page.Section("again", "How to repeat it", again))
    title = f"Diagnosis of {next(iter(diagnoses))}" if len(diagnoses) == 1 else "Diagnosis"
    recordings = count(len(diagnoses), "recording")
    subtitle = f"Faults that would spoil the identified stiffness, looked for in {recordings}."
    page.write_page(path, page.Page(title, subtitle, parts))


def diagnosis_section(diagnoses: Mapping[str, Diagnosis]) -> str:
    """Return the part of a page with the findings of each ensemble, remedies, pictures and checks.

    HTML, escaped, whose headings are of the third and fourth level; it takes the style of the
    report's pages.
    """
    return page.html(_blocks(diagnoses))


def _blocks(diagnoses: Mapping[str, Diagnosis]) -> list[page.Block]:
    if not isinstance(diagnoses, Mapping) or not all(
        isinstance(each, Diagnosis) for each in diagnoses.values()
    ):
        raise InputError(
            f"write_diagnosis: expected diagnoses by name, got {type(diagnoses).__name__}; give "
            "{'ankle': tvsysid.diagnose(ensemble)}"
        )
    if not diagnoses:
        raise InputError(
            "write_diagnosis: expected diagnoses by name, got none; give {'ankle': diagnosis}"
        )
    pictures = draw_all(
        {name: diagnosis_illustration(each, name) for name, each in diagnoses.items()}
    )
    each = zip(diagnoses.items(), _anchors(diagnoses), strict=True)
    return [
        block
        for (name, diagnosis), anchor in each
        for block in _one(name, diagnosis, anchor, pictures[name])
    ]


def _anchors(diagnoses: Mapping[str, Diagnosis]) -> list[str]:
    return [f"diagnosis-{place}" for place in range(1, len(diagnoses) + 1)]


def _one(name: str, diagnosis: Diagnosis, anchor: str, picture: Picture) -> list[page.Block]:
    """Return the blocks about one ensemble."""
    checks = [
        page.Row(
            (
                each.name,
                f"{SYMBOLS[each.state]} {each.state}",
                each.strength,
                each.what,
                each.fault.measure,
            )
        )
        for each in diagnosis.checks
    ]
    measures = [
        page.Row((key, page.number(value).text, "" if unit == "1" else unit))
        for key, (value, unit) in diagnosis.measures.items()
        if math.isfinite(value)
    ]
    looked_at = f"All checks of {name}"
    limits = (
        "All that was looked for. A fault is beyond its limit and, where noise reaches it, "
        "significant (p < 0.00001)."
    )
    values = (
        f"Useful values about {name}; its impedance is taken as constant over time, and fitted by "
        "least squares."
    )
    return [
        page.Heading(name, anchor),
        f"{diagnosis.ensemble}: {diagnosis.verdict}.",
        *(f"{line[:1].upper()}{line[1:]}." for line in diagnosis.notes),
        *findings_table(diagnosis, name),
        page.Figure(f"{anchor}-figure", picture),
        page.Heading(looked_at, f"{anchor}-checks", 4),
        page.Table(looked_at, limits, CHECKED, checks),
        page.Table(f"Values about {name}", values, MEASURED, measures),
    ]


def findings_table(diagnosis: Diagnosis, name: str) -> list[page.Block]:
    """Return the findings of an ensemble, their effects and remedies.

    None if nothing is.
    """
    rows = [
        page.Row(
            (
                f"{each.fault.title} ({each.name})",
                each.what,
                each.strength,
                each.fault.effect,
                each.fault.remedy,
            )
        )
        for each in diagnosis.findings
    ]
    caption = f"What was found in {name}, what it does to the result, and what to do."
    return [page.Table(f"Findings in {name}", caption, FOUND, rows)] if rows else []


def _lower(title: str) -> str:
    return title[:1].lower() + title[1:]
