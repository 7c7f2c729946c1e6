"""What people see: a line of HTML of an object in a notebook, its picture by ``plot()``, and the progress of work."""

from __future__ import annotations

import html
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING

from tvsysid.errors import printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

Progress = Callable[[int, int], object]
FOLDED = 20  # rows beyond which a table is folded


class Shown:
    """Object whose ``repr`` is a line, and that :mod:`tvsysid.figures` has a picture of."""

    def plot(self, title: str = "") -> Figure:
        """Figure of it, as :func:`tvsysid.figures.plot` draws it; a notebook shows it."""
        # Figures stand above all that they show: no room below imports them until somebody asks for
        # one.
        figure: Figure = import_module("tvsysid.figures").plot(self, title)
        return figure

    def _repr_html_(self) -> str:
        line, *notes = repr(self).split("\n")
        kind, _, about = line.partition("(")
        return summary_html(kind, about.removesuffix(")"), notes=notes)


def summary_html(
    kind: str,
    about: str,
    headings: Sequence[str] = (),
    rows: Iterable[Sequence[object]] = (),
    notes: Iterable[str] = (),
) -> str:
    """What a notebook shows of an object: its kind and a line about it, a table, and further lines.

    All escaped.
    """

    def row(kind: str, cells: Sequence[object]) -> str:
        shown = (f"<{kind} style='text-align:left'>{_escaped(cell)}</{kind}>" for cell in cells)
        return f"<tr>{''.join(shown)}</tr>"

    body = [row("td", each) for each in rows]
    table = (
        f"<table><thead>{row('th', headings)}</thead><tbody>{''.join(body)}</tbody></table>"
        if body
        else ""
    )
    if len(body) > FOLDED:
        table = f"<details><summary>{len(body)} rows</summary>{table}</details>"
    lines = "".join(f"<p>{_escaped(note)}</p>" for note in notes)
    return f"<p><b>{_escaped(kind)}</b>: {_escaped(about)}</p>{table}{lines}"


def _escaped(cell: object) -> str:
    """Text of others as HTML; numbers with four digits, nothing for what is not known."""
    if isinstance(cell, float):
        return "" if math.isnan(cell) else f"{cell:.4g}"
    return html.escape(printable(str(cell)))


@contextmanager
def progress_bar(
    title: str, console: Console | None = None, disable: bool = False
) -> Iterator[Progress]:
    """Show a bar; what it yields is called with what is done and the total."""
    from rich.progress import (  # noqa: PLC0415  # heavy
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    shown = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    with Progress(*shown, console=console, transient=True, disable=disable) as bar:
        task = bar.add_task(title, total=None, rate="")

        def advance(done: int, total: int) -> None:
            speed = bar.tasks[0].speed
            bar.update(task, completed=done, total=total, rate=f"{speed:.1f}/s" if speed else "")

        yield advance


@contextmanager
def reported(progress: Progress | None, title: str) -> Iterator[Progress]:
    """What a function calls with what is done and the total: what it was given, or else in a notebook a bar."""
    if progress is None and "ipykernel" in sys.modules and find_spec("ipywidgets") is not None:
        with progress_bar(title) as advance:
            yield advance
    else:
        yield progress or (lambda done, total: None)
