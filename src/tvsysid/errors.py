"""What goes wrong at the border: one error for what cannot be used, one warning for what is doubtful, and texts."""

from __future__ import annotations

import os
import re
import sysconfig
import textwrap
import traceback
import unicodedata
from collections.abc import Iterable
from functools import cache
from itertools import chain
from pathlib import Path

UNSEEN = {"Cc", "Cf", "Cs", "Zl", "Zp"}
"""Unicode's categories of what is not text to be seen."""

PERCENTAGE = re.compile(r"(\d+(?:\.\d+)?) %")


class InputError(ValueError):
    """Input that cannot be used: says what came, what was expected and what to do."""


class DataQualityWarning(UserWarning):
    """Input that is legal, but makes the result doubtful; kept in the model's diagnostics too."""


def printable(text: str) -> str:
    r"""Text of others such that it can be shown anywhere: what steers a terminal, and what is no text, as an escape.

    Control characters (but for line breaks and tabs), invisible ones, such as those that reverse
    the order of reading, and bytes of a file's name that are not UTF-8.

    Examples
    --------
    >>> print(printable("caf\udce9 \x1b[31mred\u202e"))
    caf\udce9 \x1b[31mred\u202e
    """
    lines = (line if line.isprintable() else "".join(map(_seen, line)) for line in text.split("\n"))
    return "\n".join(lines)


def _seen(sign: str) -> str:
    return repr(sign)[1:-1] if unicodedata.category(sign) in UNSEEN and sign != "\t" else sign


def one_line(text: str) -> str:
    """Text of others, printable, in one line."""
    return " ".join(line.strip() for line in printable(text).split("\n"))


def by_text(warned: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    """Who gave a warning, by its text: texts that differ in a percentage alone are one, with the range of it.

    Examples
    --------
    >>> by_text([("sds", "negative at 92 % of the samples"), ("esm", "negative at 100 % of the samples")])
    {'negative at 92 to 100 % of the samples': ['sds', 'esm']}
    """
    groups: dict[str, dict[str, list[str]]] = {}
    for who, text in warned:
        groups.setdefault(PERCENTAGE.sub("%", text), {}).setdefault(text, []).append(who)
    return {
        _ranged(list(texts)): list(dict.fromkeys(chain(*texts.values())))
        for texts in groups.values()
    }


def _ranged(texts: list[str]) -> str:
    """Text of several that differ in percentages alone, with lowest and highest of each."""
    found = zip(*(PERCENTAGE.findall(text) for text in texts), strict=True)
    ends = ((min(values, key=float), max(values, key=float)) for values in found)
    ranges = (" to ".join(dict.fromkeys(each)) for each in ends)
    return PERCENTAGE.sub(lambda _: f"{next(ranges)} %", texts[0])


def describe_error(error: BaseException, file: str | None = None) -> str:
    """Describe an exception in one line: its type, its message, and the last line of the user's code that it reached.

    That is one of the user's ``file``, if that is known. An :class:`InputError` speaks for itself.
    """
    text, (name, line) = plain_text(error), _place(error, file)
    if isinstance(error, SyntaxError):
        text, name, line = str(error.msg), error.filename, error.lineno
    kind = "" if isinstance(error, InputError) else f"{type(error).__name__}: "
    said = f"{kind}{text}".rstrip(": ")
    return printable(f"{said} ({Path(name).name}, line {line})" if name and line else said)


def plain_text(message: object) -> str:
    """Text of anybody's exception or warning: what can be printed of it, in one line of at most 1000 characters."""
    try:
        text = str(message)
    except BaseException:  # its text is code that anybody wrote
        return "its text cannot be read"
    return textwrap.shorten(one_line(text[:10_000]), 1000, placeholder=" …")


def _place(error: BaseException, file: str | None) -> tuple[str | None, int | None]:
    package, *libraries = library_folders()
    frames = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if not frame.filename.startswith(package)
    ]
    of_file = [frame for frame in frames if frame.filename == file]
    of_user = [frame for frame in frames if not frame.filename.startswith(("<", *libraries))]
    for chosen in (of_file, of_user, frames):
        if chosen:
            return chosen[-1].filename, chosen[-1].lineno
    return None, None


@cache
def library_folders() -> tuple[str, ...]:
    """Folders of code that is not the user's: this package first, then Python's and all that is installed."""
    paths = sysconfig.get_paths()
    folders = (
        str(Path(__file__).parent),
        *(paths[name] for name in ("stdlib", "platstdlib", "purelib", "platlib")),
    )
    return tuple(f"{folder}{os.sep}" for folder in folders)
