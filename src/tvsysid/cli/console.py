"""Print text, remarks, tables and progress."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from string import Formatter
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

NUMBER = re.compile(r"-|[-+]?\d[-+.e\d]*( ± [\d.]+| s| min)?")
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


class _Cells(Formatter):
    """Formatter to which a value that is missing, None or NaN is a dash."""

    def get_value(self, key: int | str, args: Any, kwargs: Mapping[Any, Any]) -> Any:
        return kwargs.get(key)

    def format_field(self, value: Any, format_spec: str) -> str:
        is_known = value is not None and not (isinstance(value, float) and math.isnan(value))
        return super().format_field(value, format_spec) if is_known else "-"


def show_table(
    title: str,
    records: Sequence[Mapping[Any, object]],
    columns: Mapping[str, str],
    spaced: bool = False,
) -> None:
    """Print a table.

    Parameters
    ----------
    title
        Line above the table.
    records
        Values of each row, by name.
    columns
        Format of a cell from these values, by heading. A column that is unknown in all rows is left
        out. Numbers are aligned right and never broken; other texts are folded.
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
    for heading, form in columns.items():
        column = [printable(_Cells().vformat(form, (), record)) for record in records]
        if set(column) != {"-"}:
            is_number = all(map(NUMBER.fullmatch, column))
            side: Literal["left", "right"] = "right" if is_number else "left"
            table.add_column(heading, justify=side, no_wrap=is_number, overflow="fold")
            cells.append(column)
    for row in zip(*cells, strict=True):
        table.add_row(*row)
    say(f"\n{title}", "bold")
    output.print(table)


@contextmanager
def shown_progress(title: str) -> Iterator[Progress]:
    """Show a progress bar on a terminal, and yield the function that advances it.

    Say so if the first call reports steps that are done: the work is resumed.
    """
    # A thread that refreshes the bar would make it unsafe to copy this process.
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
            texts = (_method_and_text(str(warning.message)) for warning in caught)
            for text, methods in by_text(texts).items():
                remark("warning", ": ".join(filter(None, [", ".join(methods), text])))


def _method_and_text(message: str) -> tuple[str, str]:
    """Split a warning into the method that it begins with, if any, and the rest."""
    method, _, text = message.partition(": ")
    return (method, text) if text and " " not in method else ("", message)
