"""What goes wrong at the border: one error for what cannot be used, one warning for what is doubtful."""

from __future__ import annotations

import os
import sysconfig
import textwrap
import traceback
from functools import cache
from pathlib import Path


class InputError(ValueError):
    """Input that cannot be used: says what came, what was expected and what to do."""


class DataQualityWarning(UserWarning):
    """Input that is legal, but makes the result doubtful; kept in the model's diagnostics too."""


def describe_error(error: BaseException, file: str | None = None) -> str:
    """Describe an exception in one line: its type, its message, and the last line of the user's code that it reached.

    That is one of the user's ``file``, if that is known.
    """
    text, (name, line) = str(error), _place(error, file)
    if isinstance(error, SyntaxError):
        text, name, line = str(error.msg), error.filename, error.lineno
    said = textwrap.shorten(f"{type(error).__name__}: {text}".rstrip(": "), 300, placeholder=" …")
    return f"{said} ({Path(name).name}, line {line})" if name and line else said


def _place(error: BaseException, file: str | None) -> tuple[str | None, int | None]:
    package, *libraries = library_folders()
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if not frame.filename.startswith(package)]
    of_file = [frame for frame in frames if frame.filename == file]
    of_user = [frame for frame in frames if not frame.filename.startswith(("<frozen", *libraries))]
    for chosen in (of_file, of_user, frames):
        if chosen:
            return chosen[-1].filename, chosen[-1].lineno
    return None, None


@cache
def library_folders() -> tuple[str, ...]:
    """Folders of code that is not the user's: this package first, then Python's and all that is installed."""
    paths = sysconfig.get_paths()
    folders = (str(Path(__file__).parent), *(paths[name] for name in ("stdlib", "platstdlib", "purelib", "platlib")))
    return tuple(f"{folder}{os.sep}" for folder in folders)
