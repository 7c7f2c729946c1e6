"""What does not fit in memory is refused before it is read."""

from __future__ import annotations

import os
import re
from contextlib import suppress
from pathlib import Path

from tvsysid.errors import InputError


def available() -> int | None:
    """Bytes of memory that can be had, or None where the system does not tell."""
    with suppress(OSError, AttributeError):
        told = re.search(r"MemAvailable:\s+(\d+) kB", Path("/proc/meminfo").read_text(encoding="ascii"))
        if told:
            return 1024 * int(told[1])
    with suppress(OSError, ValueError, AttributeError):
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return None


def check_fits(name: str, size: int) -> None:
    """Raise an InputError if so many bytes are more than there is memory for.

    Parameters
    ----------
    name
        What takes them, for the message.
    size
        In bytes.
    """
    room = available()
    if room is not None and size > room:
        raise InputError(
            f"{name}: reading it takes {size / 1e9:.3g} GB, and {room / 1e9:.3g} GB of memory are free; save the part "
            "that is needed to a file of its own"
        )
