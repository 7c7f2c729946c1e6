"""What a page is made of, and how it becomes a file: sections of text, tables and pictures."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

import attrs

from tvsysid import __version__
from tvsysid.errors import printable
from tvsysid.figures import Picture
from tvsysid.figures.words import count
from tvsysid.recordings import whole_file

if TYPE_CHECKING:
    from jinja2 import Template

Kind = Literal["", "number", "label", "long", "verdict"]


@attrs.frozen
class Cell:
    """A number as text, and for sorting; ``value`` is None where there is none."""

    text: str
    value: float | None


@attrs.frozen
class Column:
    """Column of a table.

    ``"label"`` breaks within words on paper only, ``"long"`` is wide, ``"verdict"`` is bold.
    """

    heading: str
    unit: str = ""
    kind: Kind = ""


def columns(kinds: Mapping[str, Kind]) -> list[Column]:
    """Return columns without units, by heading and kind."""
    return [Column(heading, kind=kind) for heading, kind in kinds.items()]


@attrs.frozen
class Row:
    """Row of a table, a cell for each column; the first one is its heading.

    ``total``: it sums up others.
    """

    cells: Sequence[Cell | str | float]
    group: str = ""
    total: bool = False


@attrs.frozen
class Table:
    """Table with a caption in full sentences.

    ``label`` is its name for a screen reader. If it is ``sortable``, a click on a heading sorts
    it; in a ``narrow`` one, headings of numbers may be broken. ``groups`` of rows have a name in
    words: the reader chooses one or all, and sees ``chosen`` first.
    """

    kind: ClassVar = "table"
    label: str
    caption: str
    columns: Sequence[Column]
    rows: Sequence[Row]
    anchor: str = ""
    sortable: bool = False
    narrow: bool = False
    groups: Mapping[str, str] = attrs.field(factory=dict)
    chosen: str = ""


@attrs.frozen
class Heading:
    """Heading within a section."""

    kind: ClassVar = "heading"
    text: str
    anchor: str = ""
    level: int = 3


@attrs.frozen
class Bullets:
    """List of short texts."""

    kind: ClassVar = "bullets"
    items: Sequence[str]


@attrs.frozen
class Box:
    """Paragraphs that stand out."""

    kind: ClassVar = "box"
    paragraphs: Sequence[str]


@attrs.frozen
class Code:
    """Something to type, with its name for a screen reader."""

    kind: ClassVar = "code"
    label: str
    text: str


@attrs.frozen
class Fold:
    """Blocks that are shown on demand."""

    kind: ClassVar = "fold"
    summary: str
    blocks: Sequence[Block]


@attrs.frozen
class Figure:
    """Picture with its title and description.

    A number of 0 is not shown, nor the anchor unless a file is ``saved``.
    """

    kind: ClassVar = "figure"
    anchor: str
    picture: Picture
    number: int = 0
    saved: bool = True


Block = str | Table | Heading | Bullets | Box | Code | Fold | Figure
"""A piece of a section; text is a paragraph, escaped unless it is ``markupsafe.Markup``."""


@attrs.frozen
class Section:
    """Part of a page with a heading; the page's contents call it ``contents``, or by its title."""

    anchor: str
    title: str
    blocks: Sequence[Block]
    contents: str = ""
    wide: bool = False


@attrs.frozen
class Page:
    """A whole page, with the version of this package that its results came from.

    A ``notice`` stands at its head.
    """

    title: str
    subtitle: str
    sections: Sequence[Section]
    version: str = __version__
    notice: str = ""

    @property
    def contents(self) -> dict[str, str]:
        """Names of the sections by their anchors."""
        return {part.anchor: part.contents or part.title for part in self.sections}

    @property
    def sortable(self) -> bool:
        """Whether it has a table that can be sorted."""
        return any(
            isinstance(block, Table) and block.sortable
            for part in self.sections
            for block in part.blocks
        )


def write_page(path: str | Path, page: Page) -> None:
    """Write a page as one HTML file, which appears whole or not at all and needs nothing else."""
    render(path, "base.html", page=page)


def render(path: str | Path, template: str, **values: object) -> None:
    """Write a template of this room, filled with values, as one HTML file."""
    content = _template(template).render(values)
    with whole_file(path) as temporary:
        temporary.write_text(printable(content), encoding="utf-8")


def html(blocks: Iterable[Block]) -> str:
    """Return blocks as part of another page, escaped, in the style of this package."""
    show = getattr(_template("blocks.html").module, "show")  # noqa: B009  # a macro
    return printable("".join(str(show(block)) for block in blocks))


def _template(name: str) -> Template:
    from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415  # heavy

    environment = Environment(
        loader=PackageLoader("tvsysid.report", ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"typeset": typeset, "count": count}
    return environment.get_template(name)


def typeset(text: str) -> str:
    """Return text with typographic minus signs, and numbers joined to signs and units.

    Options stay as typed.
    """
    kind = type(text)  # markup stays markup
    text = re.sub(r"(--[\w-]+ -\d)|(?<![\w=-])-(?=\d)", lambda found: found[1] or "−", text)
    return kind(text.replace("± ", "±\u00a0").replace(" %", "\u00a0%"))


def number(value: float, error: float = math.nan, decimals: int | None = None) -> Cell:
    """Return a cell with value ± standard error, as :func:`in_text`."""
    return Cell(in_text(value, error, decimals), value if math.isfinite(value) else None)


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
