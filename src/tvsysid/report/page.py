"""Fill templates, and write numbers as text."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING

from tvsysid import __version__
from tvsysid.errors import printable
from tvsysid.figures.words import count
from tvsysid.recommendation.trust import sentence
from tvsysid.recordings import whole_file

if TYPE_CHECKING:
    from jinja2 import Template


def render(path: str | Path, name: str, /, **values: object) -> None:
    """Write a template of this package, filled with values, as one HTML file.

    The file appears whole or not at all, and loads nothing.
    """
    content = template(name).render({"version": __version__, **values})
    with whole_file(path) as temporary:
        temporary.write_text(printable(content), encoding="utf-8")


def template(name: str) -> Template:
    """Return a template of this package, with the filters that its sentences use."""
    from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415  # heavy

    environment = Environment(
        loader=PackageLoader("tvsysid.report", ""),
        autoescape=name.endswith(".html"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"typeset": typeset, "count": count, "sentence": sentence}
    return environment.get_template(name)


def typeset(text: str) -> str:
    """Return text with typographic minus signs, and numbers joined to signs and units.

    Options stay as typed.
    """
    kind = type(text)  # markup stays markup
    text = re.sub(r"(--[\w-]+ -\d)|(?<![\w=-])-(?=\d)", lambda found: found[1] or "−", text)
    return kind(text.replace("± ", "±\u00a0").replace(" %", "\u00a0%"))


def in_text(value: float, error: float = math.nan, decimals: int | None = None) -> str:
    r"""Return value ± standard error with so many decimals, or to three digits.

    A dash where there is no value.

    Examples
    --------
    >>> in_text(49.125, 1.5, 1), in_text(-0.01234), in_text(float("nan"))
    ('49.1 ±\xa01.5', '−0.0123', '–')
    """
    if not math.isfinite(value):
        return "–"
    if decimals is None:
        decimals = 2 - math.floor(math.log10(abs(value))) if value else 0
    texts = [
        f"{round(each, decimals):.{max(decimals, 0)}f}"
        for each in (value, error)
        if math.isfinite(each)
    ]
    return " ±\u00a0".join(texts).replace("-", "−")
