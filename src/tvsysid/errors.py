"""The package's error and its warning, and text that is safe to show."""

from __future__ import annotations

import os
import re
import sysconfig
import traceback
import warnings
from collections.abc import Iterable
from functools import cache
from pathlib import Path

# Control characters other than tab and line feed, invisible format characters such as those that
# reverse the reading order, and bytes of file names that are not UTF-8.
HIDDEN = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\xad\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff"
    "\ud800-\udfff\U000e0000-\U000e007f]"
)


class InputError(ValueError):
    """Input that cannot be used. The message says what came, what was expected and what to do."""


class DataQualityWarning(UserWarning):
    """Valid input that makes the result doubtful. A model's diagnostics keep these warnings."""


def without_quality_warnings() -> warnings.catch_warnings[None]:
    """Return a context in which warnings about the quality of data are ignored."""
    return warnings.catch_warnings(action="ignore", category=DataQualityWarning)


def printable(text: str) -> str:
    r"""Replace characters that are invisible or that control a terminal by their escapes.

    Examples
    --------
    >>> print(printable("caf\udce9 \x1b[31mred\u202e"))
    caf\udce9 \x1b[31mred\u202e
    """
    return HIDDEN.sub(lambda found: repr(found[0])[1:-1], text)


def one_line(text: str) -> str:
    """Return a text in one printable line."""
    return " ".join(line.strip() for line in printable(text).split("\n"))


def by_cause(warned: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    """Group pairs of a source and its warning by the cause: texts that differ in numbers alone.

    The first text of a cause stands for all. Two warnings of one source stay apart.

    Examples
    --------
    >>> by_cause([("sds", "21 realizations are too few"), ("esm", "20 realizations are too few")])
    {'21 realizations are too few': ['sds', 'esm']}
    """
    first: dict[str, str] = {}
    groups: dict[str, list[str]] = {}
    for source, text in dict.fromkeys(warned):
        shown = first.setdefault(re.sub(r"\d", "", text), text)
        shown = text if source in groups.get(shown, ()) else shown
        groups.setdefault(shown, []).append(source)
    return groups


def describe_error(error: BaseException) -> str:
    """Describe an exception in one line: type, message, and the last line of the user's code.

    The type of an :class:`InputError` is left out.
    """
    # A method that was sent to a worker has lost the file name in its code.
    lines = [
        (frame.f_globals.get("__file__") or frame.f_code.co_filename, line)
        for frame, line in traceback.walk_tb(error.__traceback__)
    ]
    own = [line for line in lines if not line[0].startswith(("<", *library_folders()))]
    kind = "" if isinstance(error, InputError) else f"{type(error).__name__}: "
    place = "".join(f" ({Path(file).name}, line {line})" for file, line in own[-1:])
    return one_line(f"{kind}{error}".removesuffix(": ") + place)


@cache
def library_folders() -> tuple[str, ...]:
    """Return folders of code that is not the user's: this package, Python, installed packages."""
    installed = (
        sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")
    )
    return tuple(f"{folder}{os.sep}" for folder in (Path(__file__).parent, *installed))
