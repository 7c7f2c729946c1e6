"""Print text, remarks, tables, warnings and progress."""

from __future__ import annotations

import math
import re
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

from tvsysid.errors import DataQualityWarning, by_text, one_line, printable
from tvsysid.progress import Progress

# Nothing is markup: names and messages come from users and files.
output = Console(markup=False, emoji=False, highlight=False)
errors = Console(markup=False, emoji=False, highlight=False, stderr=True)

METHOD_AND_TEXT = re.compile(r"(?:(\S+): )?(.*)", re.DOTALL)


def say(text: str, style: str = "") -> None:
    """Print text as it is."""
    output.print(Text(printable(text), style), soft_wrap=True)


def say_written(out: Path, names: Iterable[str]) -> None:
    """Print which files were written to a folder."""
    say(f"wrote {', '.join(names)} to {out}/")


def remark(kind: Literal["note", "warning", "error"], text: str) -> None:
    """Print a line on standard error."""
    style = "red" if kind == "error" else "yellow"
    errors.print(Text.assemble((f"{kind}:", style), f" {one_line(text)}"), soft_wrap=True)


def show_table(
    title: str,
    records: Sequence[Mapping[Any, object]],
    columns: Mapping[str, str],
    spaced: bool = False,
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
    spaced
        Whether to separate rows by empty lines.
    """
    table = Table(
        box=box.SIMPLE_HEAD,
        show_edge=False,
        show_lines=spaced,
        padding=(0, 1, 0, 0),
        pad_edge=False,
    )
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


@contextmanager
def shown_warnings() -> Iterator[None]:
    """Print the package's warnings when the block ends, each once with the methods that gave it."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataQualityWarning)
        try:
            yield
        finally:
            # A warning begins with the method that gave it, if any.
            parts = (METHOD_AND_TEXT.findall(str(each.message))[0] for each in caught)
            for text, methods in by_text(parts).items():
                remark("warning", ": ".join(filter(None, [", ".join(methods), text])))
