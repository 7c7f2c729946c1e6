"""Fill templates, and write numbers as text."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from tvsysid import __version__
from tvsysid.errors import printable
from tvsysid.figures.words import count
from tvsysid.recommendation.answer import sentence
from tvsysid.recordings import whole_file

if TYPE_CHECKING:
    import pandas as pd
    from jinja2 import Environment

SYMBOLS = {"holds": "✓", "does not hold": "✗", "undecided": "?", "not studied": "–"}
SYMBOLS |= {"in order": "✓", "found": "✗", "uncertain": "?", "not judged": "–"}
"""Symbols of the verdicts on claims and on faults."""


def render(path: str | Path, name: str, /, **values: object) -> None:
    """Write a template of this package, filled with values, as one HTML file.

    The file appears whole or not at all, and loads nothing.
    """
    with whole_file(path) as temporary:
        temporary.write_text(printable(filled(name, **values)), encoding="utf-8")


def filled(name: str, /, **values: object) -> str:
    """Return a template of this package, filled with values."""
    return _environment().get_template(name).render(values)


@cache
def _environment() -> Environment:
    """Return templates with the filters and tests that they use."""
    import jinja2  # noqa: PLC0415  # heavy

    environment = jinja2.Environment(
        extensions=["jinja2.ext.do"],
        loader=jinja2.PackageLoader("tvsysid.report", ""),
        autoescape=jinja2.select_autoescape(),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"typeset": typeset, "count": count, "sentence": sentence}
    environment.filters |= {"frame": frame, "texts": texts}
    environment.tests["known"] = math.isfinite
    environment.globals |= {"version": __version__, "symbols": SYMBOLS}
    return environment


def frame(items: Iterable[object], columns: Mapping[str, str]) -> pd.DataFrame:
    """Return a table with a row for each item.

    ``columns`` are attributes such as ``"fault.title"``, or places such as ``"0"``, by heading.
    """
    import pandas as pd  # noqa: PLC0415  # heavy
    from jinja2.filters import make_attrgetter  # noqa: PLC0415  # heavy

    getters = {name: make_attrgetter(_environment(), each) for name, each in columns.items()}
    rows = [{name: get(item) for name, get in getters.items()} for item in items]
    return pd.DataFrame(rows, columns=list(columns))


def texts(table: pd.DataFrame, decimals: Mapping[str, int] = MappingProxyType({})) -> pd.DataFrame:
    """Return a table whose numbers are texts, ± those of their columns ``_error``.

    Columns have so many ``decimals``, others three digits. Whole numbers stay.
    """
    shown: dict[str, Any] = {}
    for name in [name for name in map(str, table) if not name.endswith("_error")]:
        shown[name] = values = table[name]
        if values.dtype.kind == "f":
            errors = table.get(f"{name}_error", [math.nan] * len(table))
            pairs = zip(values, errors, strict=True)
            shown[name] = [in_text(*pair, decimals.get(name)) for pair in pairs]
    return table[[]].assign(**shown)


def typeset(text: str) -> str:
    """Return text with typographic minus signs, and numbers joined to signs and units.

    Options stay as typed.
    """
    kind = type(text)  # markup stays markup
    text = re.sub(r"(--[\w-]+ -\d)|(?<![\w=-])-(?=\d)", lambda found: found[1] or "−", text)
    return kind(text.replace("± ", "±\u00a0").replace(" %", "\u00a0%"))


def in_text(value: float, error: float = math.nan, decimals: int | None = None) -> str:
    r"""Return value ± standard error with so many decimals, or to three digits.

    A whole number has no decimals. A dash stands where there is no value.

    Examples
    --------
    >>> in_text(49.125, 1.5, 1), in_text(-0.01234), in_text(float("nan"))
    ('49.1 ±\xa01.5', '−0.0123', '–')
    """
    if not math.isfinite(value):
        return "–"
    if decimals is None and value == round(value):
        decimals = 0
    elif decimals is None:
        decimals = 2 - math.floor(math.log10(abs(value)))
    texts = [
        f"{round(each, decimals):.{max(decimals, 0)}f}"
        for each in (value, error)
        if math.isfinite(each)
    ]
    return " ±\u00a0".join(texts).replace("-", "−")
