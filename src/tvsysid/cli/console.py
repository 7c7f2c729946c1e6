"""Everything that is printed: text, remarks, tables, progress."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any, Literal

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

from tvsysid.errors import DataQualityWarning, by_text, one_line, printable
from tvsysid.showing import Progress, progress_bar


class Stream(Console):
    """A console on which nothing is markup, because names and messages come from users and files.

    Where nobody reads it any more, or its disk is full, it falls silent, because what a command
    computes and writes to files must not be lost with it; ``lost`` is the reason.
    """

    lost: OSError | None = None

    def __init__(self, stderr: bool = False) -> None:
        super().__init__(markup=False, emoji=False, highlight=False, stderr=stderr)

    def print(self, *objects: object, **how: Any) -> None:
        """Print, as long as that can be done."""
        try:
            super().print(*objects, **how)
        except OSError as error:
            self.lost, self.quiet = error, True
            with suppress(OSError):  # what is left in the buffer would fail again at the end
                os.dup2(os.open(os.devnull, os.O_WRONLY), self.file.fileno())

    def on_broken_pipe(self) -> None:
        """Leave a broken pipe to :meth:`print`."""
        raise  # noqa: PLE0704  # called while it is handled


output = Stream()
errors = Stream(stderr=True)

SHORTEST_NAME, LONGEST_NAME = 10, 32  # letters
MOST_LINES = 3  # of a name that is broken
STYLES = {"note": "yellow", "warning": "yellow", "error": "red"}


def say(*parts: str | tuple[str, str]) -> None:
    """Print text as it is; a part may be a pair of text and style."""
    shown = [
        printable(part) if isinstance(part, str) else (printable(part[0]), part[1])
        for part in parts
    ]
    output.print(Text.assemble(*shown), soft_wrap=True)


def remark(kind: Literal["note", "warning", "error"], text: str) -> None:
    """Print a line on standard error."""
    errors.print(Text.assemble((f"{kind}:", STYLES[kind]), f" {one_line(text)}"), soft_wrap=True)


def say_written(out: Path, names: Iterable[str]) -> None:
    """Print which files were written to a folder."""
    say(f"wrote {', '.join(names)} to {out}/")


def show_table(
    title: str | None,
    headings: Sequence[str],
    rows: Iterable[Sequence[str]],
    align: str = "l",
    caption: str | None = None,
    lines: bool = False,
) -> None:
    """Print a table.

    `align` has a letter, l or r, for each of the first columns, and the others are aligned right.

    Where the terminal is too narrow for its longest words and numbers, each row is a list.
    """
    told = [[printable(cell) for cell in row] for row in rows]
    columns = [list(column) for column in zip(headings, *told, strict=True)]
    least = [max(map(cell_len, " ".join(column).split()), default=0) for column in columns]
    most = [
        max(cell_len(line) for cell in column for line in cell.split("\n")) for column in columns
    ]
    longest = max((cell_len(row[0]) for row in told), default=0)
    # Names such as those of methods are broken behind their punctuation only, and before numbers
    # are.
    if longest <= LONGEST_NAME or not any(" " in row[0] for row in told):
        least[0] = most[0]
    room = output.width - 3 * len(columns) - 1
    if sum(least) > room:
        left = room - sum(least[1:])
        if left < SHORTEST_NAME or left * MOST_LINES < longest:
            say("\n".join(filter(None, (title, *(_lines(headings, row) for row in told), caption))))
            return
        told, least[0], most[0] = [[_broken(row[0], left), *row[1:]] for row in told], left, left
    table = Table(
        title=title and printable(title), title_justify="left", caption=caption, show_lines=lines
    )
    widths = _widths(least, most, room)
    for heading, letter, width in zip(
        headings, align.ljust(len(headings), "r"), widths, strict=True
    ):
        table.add_column(
            heading, overflow="fold", justify="left" if letter == "l" else "right", width=width
        )
    for row in told:
        table.add_row(*row)
    output.print(table)


def _widths(least: Sequence[int], most: Sequence[int], room: int) -> list[int]:
    """Widths of columns that fit: what is left beyond the least is dealt evenly to those that need it."""
    widths, spare = list(least), room - sum(least)
    order = sorted(range(len(widths)), key=lambda place: most[place] - least[place])
    for done, place in enumerate(order):
        more = min(most[place] - least[place], spare // (len(order) - done))
        widths[place] += more
        spare -= more
    return widths


def _broken(name: str, width: int) -> str:
    """Name in lines of so many letters, broken behind its punctuation where that can be."""
    lines = [""]
    for piece in re.findall(r"[^:,=(. ]*[:,=(. ]|[^:,=(. ]+", name):
        for start in range(0, len(piece), width):
            part = piece[start : start + width]
            if len(lines[-1]) + len(part) > width:
                lines.append("")
            lines[-1] += part
    return "\n".join(filter(None, lines))


def _lines(headings: Sequence[str], row: Sequence[str]) -> str:
    """Row of a table whose numbers a narrow terminal would break: a line for each."""
    lines = (
        f"{heading}: {cell}".replace("\n", " ") for heading, cell in zip(headings, row, strict=True)
    )
    return "\n  ".join(lines)


def progress(title: str) -> AbstractContextManager[Progress]:
    """Show a bar; what it yields is called with what is done and the total."""
    return progress_bar(title, errors, disable=not errors.is_terminal)


def waiting(title: str) -> AbstractContextManager[object]:
    """Show that work is under way whose end is not known."""
    return errors.status(title) if errors.is_terminal else nullcontext()


@contextmanager
def shown_warnings() -> Iterator[None]:
    """Print the package's warnings when the block ends, however it ends: a line each, and who gave it, if several."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataQualityWarning)
        try:
            yield
        finally:
            for text, names in by_text(
                _said_by(str(warning.message)) for warning in caught
            ).items():
                if len(names) > 1:
                    remark("warning", f"{text} ({', '.join(names)})")
                else:
                    remark("warning", f"{names[0]}: {text}" if names[0] else text)


def _said_by(message: str) -> tuple[str, str]:
    """Method that gave a warning, if it begins with one, and the rest."""
    who, _, text = message.partition(": ")
    return (who, text) if text and " " not in who else ("", message)


def duration_text(seconds: float) -> str:
    """Seconds in the unit that suits them: s, min or h."""
    minutes = seconds / 60
    return (
        f"{seconds:.0f} s"
        if minutes < 2
        else f"{minutes:.0f} min"
        if minutes < 120
        else f"{minutes / 60:.1f} h"
    )
