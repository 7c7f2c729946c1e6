"""Files of a store: written whole or not at all, and known by a checksum when they are read."""

from __future__ import annotations

import os
import stat
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path

from tvsysid.errors import InputError

WHOLE, TORN, DAMAGED = "whole", "torn", "damaged"
PARTIAL = ".partial"  # ending of a file that is being written
SEAL = 18  # bytes at the end of a sealed file: a line with the checksum of the rest
NAMED = 20  # damaged files that are named
BLOCK = 4096  # bytes that a disk writes at once


def content_of(file: str | Path) -> bytes:
    """Return the content of a file; nothing if it does not exist.

    Raises an InputError if it is there and cannot be read.
    """
    try:
        if not stat.S_ISREG(os.stat(file).st_mode):  # opening a pipe would wait for ever
            raise InputError(
                f"{file}: expected a file, found something else; move it away, and run the study "
                "again"
            )
        with open(file, "rb") as opened:
            return opened.read()
    except FileNotFoundError:
        return b""
    except OSError as error:
        raise InputError(
            f"{file}: this file cannot be read: {error.strerror}; make it readable, or move away "
            "what is in its place"
        ) from error


def write(file: str | Path, content: bytes) -> None:
    """Write a file, whole or not at all; its folder is made if need be."""
    os.makedirs(os.path.dirname(file), exist_ok=True)
    with open(f"{file}{PARTIAL}", "wb") as partial:
        partial.write(content)
    os.replace(f"{file}{PARTIAL}", file)


def checksum(content: bytes, key: int = 0) -> int:
    """Return length times 2**32 plus CRC-32, which begins with a key; 0 of nothing."""
    return len(content) << 32 | zlib.crc32(content, key) if content else 0


def key_of(path: str, key: int) -> int:
    """Return the key of a file's checksum, from its path in the store and the store's key."""
    return zlib.crc32(path.encode(), key)


def state(content: bytes, expected: int, key: int = 0) -> str:
    """Return whether a content is whole, torn (by a kill or power loss) or damaged.

    A torn file is missing, cut short, or has blocks of zeros.
    """
    if checksum(content, key) == expected:
        return WHOLE
    blank = any(not any(content[first : first + BLOCK]) for first in range(0, len(content), BLOCK))
    return TORN if blank or len(content) < expected >> 32 else DAMAGED


def sealed(content: bytes, key: int = 0) -> bytes:
    """Return a content with its checksum as the last line."""
    return content + b"\n%016x\n" % checksum(content, key)


def unsealed(content: bytes, key: int = 0) -> bytes | None:
    """Return the content before its checksum line; None if it is not whole."""
    inner = content[:-SEAL]
    return inner if inner and sealed(inner, key) == content else None


def torn(contents: Mapping[str, bytes], expected: Mapping[str, int], folder: Path) -> list[str]:
    """Return the names of contents that are not whole.

    Raises an InputError if there are damaged ones among them.
    """
    states = {name: state(content, expected[name]) for name, content in contents.items()}
    if damaged := [str(folder / name) for name, each in states.items() if each == DAMAGED]:
        raise damage(damaged)
    return [name for name, each in states.items() if each == TORN]


def damage(files: Sequence[str]) -> InputError:
    """Return the error for damaged files."""
    if len(files) == 1:
        what = f"{files[0]}: this file does not hold what was written there; remove it"
    else:
        more = f" and {len(files) - NAMED} more" if len(files) > NAMED else ""
        what = (
            f"{len(files)} files do not hold what was written there; remove them: "
            f"{', '.join(files[:NAMED])}{more}"
        )
    return InputError(
        f"{what}; then the command that ran the study makes {'it' if len(files) == 1 else 'them'} "
        "again"
    )


def to_disk(path: Path) -> None:
    """Flush a file or folder to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
