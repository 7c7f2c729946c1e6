"""Sections that the page of every study has, and what they are made of."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np

from tvsysid import __version__
from tvsysid.figures import Picture
from tvsysid.figures.words import count
from tvsysid.methods import METHODS
from tvsysid.report.page import (
    Block,
    Bullets,
    Code,
    Figure,
    Fold,
    Heading,
    Row,
    Section,
    Table,
    columns,
    number,
)
from tvsysid.study.dataset import axes_of
from tvsysid.study.measure import SKIPPED
from tvsysid.study.settings import in_words

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

CLAIM = columns(
    {
        **{"claim": "long", "verdict": "verdict", "finding": "long"},
        **{"estimate": "number", "limits": "number", "unit": "", "remark": "long"},
    }
)
SYMBOLS = {"holds": "✓", "does not hold": "✗", "undecided": "?", "not studied": "–"}


class Problem(TypedDict):
    """Identifications of one method that failed, were skipped, or gave warnings."""

    method: str
    kind: str
    count: int
    trials: int
    first: str


def problems(results: xr.Dataset) -> list[Problem]:
    """Return failures and warnings of a study: how often, and the first reason.

    A dict for each: ``method`` (label of the method, or of a recording of which nothing could be
    identified), ``kind`` (``"failed"``, ``"skipped"`` or ``"warning"``), ``count`` of how many
    ``trials``, and the ``first`` reason.
    """
    case, draw, method = axes_of(results)
    found: list[Problem] = []
    failure = results.failure.transpose(case, method, draw).values
    lost = (failure != "").all(axis=(1, 2)) & (failure == failure[:, :1, :1]).all(axis=(1, 2))
    lost &= failure.shape[1] > 1
    for label, texts in zip(results[case].values[lost], failure[lost], strict=True):
        found.append(_problem(str(label), "failed", texts.ravel(), texts.size))
    left = results.isel({case: ~lost})
    prefixes = [f"{label}: " if results.sizes[case] > 1 else "" for label in left[case].values]
    for label in map(str, left[method].values):
        mine = left.sel({method: label})
        texts = {name: mine[name].transpose(case, draw).values for name in ("failure", "warnings")}
        is_skipped = np.char.startswith(texts["warnings"].astype(str), SKIPPED)
        for kind, told in (
            ("failed", texts["failure"]),
            ("skipped", np.where(is_skipped, texts["warnings"], "")),
            ("warning", np.where(is_skipped, "", texts["warnings"])),
        ):
            reasons = [
                f"{prefix}{str(text).removeprefix(SKIPPED)}"
                for prefix, row in zip(prefixes, told, strict=True)
                for text in row
                if text
            ]
            if reasons:
                found.append(_problem(label, kind, reasons, told.size))
    return found


def _problem(method: str, kind: str, reasons: Sequence[str], trials: int) -> Problem:
    return {
        "method": method,
        "kind": kind,
        "count": len(reasons),
        "trials": trials,
        "first": str(reasons[0]),
    }


LEFT_OUT = "What failed or was skipped is left out of the metrics; what gave a warning counts."


def problems_section(found: Iterable[Problem], what: str, caption: str = LEFT_OUT) -> Section:
    """Return the section on failures and warnings of a study."""
    rows = [
        Row((each["method"], each["kind"], f"{each['count']} of {each['trials']}", each["first"]))
        for each in found
    ]
    headings = columns({what: "label", "what": "", "how many": "number", "first reason": "long"})
    table = Table("Failures and warnings", caption, headings, rows)
    blocks = [table] if rows else ["No identification failed, and none gave a warning."]
    return Section("problems", "Failures and warnings", blocks)


def claims_section(claims: pd.DataFrame, caption: str, fold: bool = False) -> Section:
    """Return the section on a paper's claims, and whether the study confirms them.

    Claims that it does not bear on may be folded away.
    """
    folded = claims[claims.verdict == "not studied"] if fold else claims[:0]
    shown = claims.drop(folded.index)
    blocks: list[Block] = (
        [_claims("Published claims", caption, shown)] if len(shown) else ["No claim was examined."]
    )
    if len(folded):
        table = _claims(
            "Claims that were not studied", "Claims that these recordings do not bear on.", folded
        )
        blocks.append(Fold(f"{count(len(folded), 'claim')} not studied, and why", [table]))
    return Section("claims", "Published claims", blocks, contents="Claims")


def _claims(label: str, caption: str, claims: pd.DataFrame) -> Table:
    rows = []
    for claim in claims.fillna({"remark": "", "finding": "", "source": "", "unit": ""}).to_dict(
        "records"
    ):
        low, high, estimate = (number(float(claim[name])) for name in ("low", "high", "estimate"))
        limits = (
            f"{low.text} to {high.text}" if low.value is not None and high.value is not None else ""
        )
        verdict = f"{SYMBOLS.get(claim['verdict'], '')} {claim['verdict']}".strip()
        said = f"{claim['claim']} ({claim['source']})"
        rows.append(
            Row(
                (
                    said,
                    verdict,
                    claim["finding"],
                    estimate.text,
                    limits,
                    claim["unit"],
                    claim["remark"],
                )
            )
        )
    return Table(label, caption, CLAIM, rows)


def verdicts(claims: pd.DataFrame) -> list[str]:
    """Return a sentence on how many claims hold, if there are any."""
    if not len(claims):
        return []
    counts = claims.verdict.value_counts()
    parts = ", ".join(f"{verdict}: {counts[verdict]}" for verdict in SYMBOLS if verdict in counts)
    return [f"Of {len(claims)} published claims: {parts}."]


def methods_section(labels: Iterable[str]) -> Section:
    """Return the names and assumptions of the methods.

    Nothing is known of those that are not this package's.
    """
    blocks: list[Block] = []
    for label in labels:
        method = METHODS.get(label.partition(":")[0])
        if method is None:
            blocks += [
                Heading(label),
                "This is your own method: its assumptions are not known here.",
            ]
        else:
            blocks += [Heading(f"{label}: {method.title}"), Bullets(method.assumptions)]
    return Section("methods", "What each method assumes", blocks, contents="Assumptions")


def run_section(
    results: xr.Dataset, settings: Mapping[str, object], seconds: float, failed: str
) -> Section:
    """Return the section on the settings of a study and its machine."""
    versions = settings_of(results, "versions")
    rows = [(name, in_words(value)) for name, value in settings.items()]
    rows.append(("version of tvsysid", version_of(results)))
    rows += [
        (f"version of {name}", str(each)) for name, each in versions.items() if name != "tvsysid"
    ]
    if results.attrs.get("machine"):
        rows.append(("machine", str(results.attrs["machine"])))
    rows += [
        ("computing time", f"{round(seconds):,} s on one core"),
        ("failed identifications", failed),
    ]
    caption = "Settings of the study, and the machine that it ran on."
    table = Table(
        "What was run", caption, columns({"setting": "", "value": ""}), [Row(row) for row in rows]
    )
    return Section("run", "What was run", [table])


def again_section(command: str, selection: str, toml: str = "", same: str = "") -> Section:
    """Return the section on how to repeat a study and read its results in Python."""
    blocks: list[Block] = []
    if command:
        blocks += ["This command made the page:", Code("Command", command)]
    if toml:
        again = (
            "The study as TOML. The same settings and version give the same numbers, except for "
            "computing times:"
        )
        blocks += [again, Code("Study as TOML", toml)]
    if same:
        blocks.append(same)
    reading = f'import xarray as xr\n\nresults = xr.open_dataset("results.nc")\n{selection}'
    blocks += [
        "All results are in the file results.nc beside this page. To read them in Python:",
        Code("Reading the results", reading),
    ]
    return Section("again", "How to repeat it", blocks)


def numbered(pictures: Mapping[str, Picture], first: int = 1) -> list[Block]:
    """Return pictures as the figures of a page."""
    return [
        Figure(stem, picture, place)
        for place, (stem, picture) in enumerate(pictures.items(), start=first)
    ]


def metrics_there(summary: pd.DataFrame, metrics: Iterable[str]) -> list[str]:
    """Return the metrics that have a value somewhere, in order."""
    known = summary[np.isfinite(summary.value.astype(float))]
    return [name for name in metrics if (known.metric == name).any()]


def version_of(results: xr.Dataset) -> str:
    """Return the version of this package that made the results."""
    return str(settings_of(results, "versions").get("tvsysid", __version__))


def settings_of(results: xr.Dataset, name: str) -> dict[str, Any]:
    """Return the settings in an attribute with JSON text.

    Empty where it is missing or is something else.
    """
    try:
        settings = json.loads(results.attrs.get(name, "{}"))
    except (TypeError, ValueError):
        return {}
    return settings if isinstance(settings, dict) else {}
