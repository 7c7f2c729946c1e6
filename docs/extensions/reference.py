"""Generate reference pages from the package: functions, classes, commands, settings, checks."""

from __future__ import annotations

import importlib
import inspect
import re
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING

import tvsysid as tv
from tvsysid.cli.app import app as program

if TYPE_CHECKING:  # its test has no Sphinx
    from sphinx.application import Sphinx

PACKAGES = (
    "tvsysid",
    "tvsysid.recordings",
    "tvsysid.preprocess",
    "tvsysid.methods",
    "tvsysid.uncertainty",
    "tvsysid.quality",
    "tvsysid.metrics",
    "tvsysid.simulate",
    "tvsysid.planning",
    "tvsysid.study",
    "tvsysid.figures",
    "tvsysid.report",
)


def command_line() -> str:
    """Every command with its arguments and options, as ``--help`` explains them."""
    text = program.generate_docs().replace("# tvsysid", "# Command line", 1)
    contents = r"## Table of Contents.*?(?=\*\*Commands)"  # the same list stands below it
    text = re.sub(contents, "", text, flags=re.DOTALL).replace("```console", "```text")
    return text.replace(" -m sphinx", "")  # taken from the command that builds the site


def settings() -> str:
    """Settings of every method with their defaults."""
    lines = [
        "# Settings of the methods",
        "",
        "Settings follow the key, `--method sds:window=0.2,max_lag=0.1`, or are arguments of the "
        "class,",
        "`tv.ShortDataSegments(window=0.2, max_lag=0.1)`. Durations are in s, frequencies in Hz. "
        "What each means",
        "stands with the class. `--tune`, or `method.tuned(ensemble)`, [chooses them from the "
        "data](../tuning.md).",
        "",
    ]
    for key in tv.methods.METHODS:
        told, kind = tv.methods.describe(key), type(tv.methods.parse(key)).__name__
        lines += [f"## `{key}`: {told.title.lower()}", ""]
        lines += [
            f"Class {{class}}`tvsysid.{kind}`, for {told.purpose}. It reports "
            f"{', '.join(told.reports)}.",
            "",
        ]
        lines += [f"It needs {'; '.join(told.needs)}.", ""] if told.needs else []
        lines += [*(f"- {each}" for each in told.assumptions), ""]
        rows = [each.partition(" = ") for each in told.settings]
        if rows:
            lines += ["| setting | default |", "|---|---|"]
            lines += [f"| `{name}` | `{default}` |" for name, _, default in rows]
        lines += [""] if rows else ["It has no settings.", ""]
    return "\n".join(lines)


def checks() -> str:
    """What the diagnosis looks for: measure and limit, effect and remedy of each fault."""
    lines = []
    for name, fault in tv.quality.FAULTS.items():
        lowest = f" or below {fault.lowest:g} {fault.unit}" if fault.lowest else ""
        limit = f"{fault.wrong} {fault.limit:g} {fault.unit}{lowest}"
        lines += [f"### `{name}`: {fault.title}", ""]
        lines += [f"- Measure: {fault.measure}; wrong {limit}."]
        lines += [f"- Effect: {fault.effect}.", f"- Remedy: {fault.remedy}.", ""]
    return "\n".join(lines)


def package(name: str) -> str:
    """Functions and classes of one package, but those that stand in `tvsysid` itself."""
    module = importlib.import_module(name)
    found = {each: getattr(module, each) for each in getattr(module, "__all__", vars(module))}
    own = {
        each: value
        for each, value in sorted(found.items(), key=lambda item: item[0].lower())
        if (inspect.isfunction(value) or inspect.isclass(value))
        and value.__module__.startswith("tvsysid")
        and not each.startswith("_")
        and (name == "tvsysid" or each not in tv.__all__)
    }
    lines = [
        name,
        "=" * len(name),
        "",
        f".. automodule:: {name}",
        "",
        f".. currentmodule:: {name}",
        "",
    ]
    lines += [".. autosummary::", "   :nosignatures:", "", *(f"   {each}" for each in own), ""]
    for each, value in own.items():
        lines += [each, "-" * len(each), ""]
        lines += [f".. autoclass:: {each}", "   :members:", ""] if inspect.isclass(value) else []
        lines += [f".. autofunction:: {each}", ""] if inspect.isfunction(value) else []
    return "\n".join(lines)


def write(app: Sphinx) -> None:
    """Write the pages where the builder finds them, if they have changed."""
    folder = Path(app.srcdir) / "generated"
    folder.mkdir(exist_ok=True)
    pages = {"command-line.md": command_line(), "settings.md": settings(), "checks.md": checks()}
    pages |= {f"{name}.rst": package(name) for name in PACKAGES}
    for name, text in pages.items():
        place = folder / name
        if not place.exists() or place.read_text(encoding="utf-8") != text:
            place.write_text(text, encoding="utf-8")


def skip(
    app: Sphinx, what: str, name: str, member: object, skipped: bool, options: object
) -> bool | None:
    """Skip the fields of named tuples: their docstrings only count them.

    The docstring of the class describes them. So it does the attributes that a class passes on.
    """
    is_field = str(getattr(member, "__doc__", "")).startswith("Alias for field number")
    is_passed_on = isinstance(getattr(member, "fget", None), attrgetter)
    return True if is_field or is_passed_on else None


def shorten(
    app: Sphinx, what: str, name: str, member: object, options: object, text: str, returned: str
) -> tuple[str, str] | None:
    """Leave the numbers of arrays out of a signature's defaults."""
    found = re.sub(r"array\(\[.*?\]\)", "...", text or "", flags=re.DOTALL)
    return (found, returned) if found else None


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages before any page is read."""
    app.connect("builder-inited", write)
    app.connect("autodoc-skip-member", skip)
    app.connect("autodoc-process-signature", shorten)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
