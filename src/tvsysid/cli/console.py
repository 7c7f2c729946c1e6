"""Print text, remarks, tables and progress."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

from rich import box
from rich.console import Console
from rich.progress import Progress as Bar
from rich.table import Table
from rich.text import Text

from tvsysid.errors import DataQualityWarning, one_line, printable
from tvsysid.progress import Progress

# Nothing is markup: names and messages come from users and files.
output = Console(markup=False, emoji=False, highlight=False)
errors = Console(markup=False, emoji=False, highlight=False, stderr=True)


def say(text: str, style: str = "") -> None:
    """Print text as it is."""
    output.print(Text(printable(text), style), soft_wrap=True)


def say_written(out: Path, names: Iterable[str]) -> None:
    """Print which files were written to a folder."""
    say(f"wrote {', '.join(names)} to {out}/")


def remark(kind: Literal["note", "warning", "error", "tvsysid"], text: str) -> None:
    """Print a line on standard error."""
    style = "yellow" if kind in ("note", "warning") else "red"
    errors.print(Text.assemble((f"{kind}:", style), f" {one_line(text)}"), soft_wrap=True)


@contextmanager
def warnings_last() -> Iterator[None]:
    """Print each warning once, below what is printed meanwhile."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataQualityWarning)
        try:
            yield
        finally:
            for text in dict.fromkeys(str(each.message) for each in caught):
                remark("warning", text)


def show_table(
    title: str, records: Sequence[Mapping[Any, object]], columns: Mapping[str, str]
) -> None:
    """Print a table, if it has rows.

    Parameters
    ----------
    title
        Line above the table.
    records
        Values of each row by name. A value that is missing, None or NaN is printed as a dash.
    columns
        Name of the values by heading. A format may follow: ``"mean:.1f"``. Values with a format
        are aligned right and never broken; others are folded. A column without values is left out.
    """
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, padding=(0, 1, 0, 0), pad_edge=False)
    cells = []
    for heading, column in columns.items():
        name, _, form = column.partition(":")
        texts = [_cell(record.get(name), form) for record in records]
        if set(texts) != {"-"}:
            side: Literal["left", "right"] = "right" if form else "left"
            table.add_column(heading, justify=side, no_wrap=bool(form), overflow="fold")
            cells.append(texts)
    for row in zip(*cells, strict=True):
        table.add_row(*row)
    if records:
        say(f"\n{title}", "bold")
        output.print(table)


def _cell(value: object, form: str) -> str:
    is_missing = value is None or (isinstance(value, float) and math.isnan(value))
    return "-" if is_missing else printable(format(value, form))


@contextmanager
def shown_progress(title: str) -> Iterator[Progress]:
    """Show a progress bar on a terminal, and yield the function that advances it.

    Print a line if the first call reports steps that are done, because the work is resumed then.
    """
    # A thread that refreshes the bar would make it unsafe to fork this process.
    bar = Bar(console=errors, transient=True, auto_refresh=False, disable=not errors.is_terminal)
    task = bar.add_task(title, total=None)

    def advance(done: int, total: int) -> None:
        if done and bar.tasks[task].total is None:
            errors.print(f"resuming: {done} of {total} tasks are done already")
        bar.update(task, completed=done, total=total, refresh=True)

    with bar:
        yield advance
