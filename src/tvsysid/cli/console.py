"""Print text, remarks, tables and progress."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import Any, Literal

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar
from rich.table import Table
from rich.text import Text

from tvsysid.errors import DataQualityWarning, by_text, one_line, printable
from tvsysid.progress import Progress

# Nothing is markup: names and messages come from users and files.
output = Console(markup=False, emoji=False, highlight=False)
errors = Console(markup=False, emoji=False, highlight=False, stderr=True)

MIN_WIDTH = 10  # of a column with text
UNKNOWN = re.compile(r"(± )?\b(nan|None)\b")
STYLES = {"note": "yellow", "warning": "yellow", "error": "red"}


def say(text: str, style: str = "") -> None:
    """Print text as it is."""
    output.print(Text(printable(text), style), soft_wrap=True)


def remark(kind: Literal["note", "warning", "error"], text: str) -> None:
    """Print a line on standard error."""
    errors.print(Text.assemble((f"{kind}:", STYLES[kind]), f" {one_line(text)}"), soft_wrap=True)


def say_written(out: Path, names: Iterable[str]) -> None:
    """Print which files were written to a folder."""
    say(f"wrote {', '.join(names)} to {out}/")


def show_table(
    title: str,
    headings: Sequence[str],
    rows: Iterable[Sequence[str]],
    align: str = "l",
    caption: str | None = None,
    lines: bool = False,
) -> None:
    """Print a table.

    Parameters
    ----------
    title, caption
        Lines above and below it.
    headings
        Headings of the columns.
    rows
        Texts of the cells.
    align
        A letter, l or r, for each of the first columns; the others are aligned right. Columns
        that are aligned right hold numbers, which are not broken: where the terminal is too narrow
        for them, each row is a list.
    lines
        Whether to separate rows by lines.
    """
    table = Table(title=printable(title), title_justify="left", caption=caption, show_lines=lines)
    cells = [[printable(cell) for cell in row] for row in rows]
    letters = align.ljust(len(headings), "r")
    for heading, letter, *column in zip(headings, letters, *cells, strict=True):
        width = max(len(line) for text in (heading, *column) for line in text.split("\n"))
        if letter == "l":
            table.add_column(heading, overflow="fold", min_width=min(width, MIN_WIDTH))
        else:
            table.add_column(heading, justify="right", min_width=width)
    for row in cells:
        table.add_row(*row)
    if 1 + sum(3 + (column.min_width or 0) for column in table.columns) <= output.width:
        output.print(table)
        return
    say(title)
    for row in cells:
        named = (f"{name}: {text}" for name, text in zip(headings, row, strict=True))
        say("\n  ".join(line.replace("\n", " ") for line in named))


def show_records(
    title: str,
    records: Iterable[Mapping[Any, Any]],
    columns: Mapping[str, str],
    align: str = "l",
    caption: str | None = None,
) -> None:
    """Print a table of records: ``columns`` are formats of a record, by heading."""
    rows = [
        [UNKNOWN.sub("-", form.format_map(record)) for form in columns.values()]
        for record in records
    ]
    show_table(title, list(columns), rows, align, caption)


@contextmanager
def progress(title: str) -> Iterator[Progress]:
    """Show a progress bar on a terminal, and yield the function that advances it."""
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    with Bar(*columns, console=errors, transient=True, disable=not errors.is_terminal) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def waiting(title: str) -> AbstractContextManager[object]:
    """Show that work of unknown duration is under way."""
    return errors.status(title) if errors.is_terminal else nullcontext()


@contextmanager
def shown_warnings() -> Iterator[None]:
    """Print the package's warnings when the block ends, each once with the methods that gave it."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataQualityWarning)
        try:
            yield
        finally:
            for text, methods in by_text(
                _method_and_text(str(warning.message)) for warning in caught
            ).items():
                if len(methods) > 1:
                    remark("warning", f"{text} ({', '.join(methods)})")
                else:
                    remark("warning", f"{methods[0]}: {text}" if methods[0] else text)


def _method_and_text(message: str) -> tuple[str, str]:
    """Split a warning into the method that it begins with, if any, and the rest."""
    method, _, text = message.partition(": ")
    return (method, text) if text and " " not in method else ("", message)
