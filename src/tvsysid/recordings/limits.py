"""How much memory and time the reading of one file may take."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from tvsysid.errors import InputError
from tvsysid.limits import addresses, available

try:
    import resource
except ImportError:  # not on Windows
    resource = None  # type: ignore[assignment]

SMALLER = "save the part that is needed to a file of its own"
SPARE = (
    768 * 2**20
    # bytes that a file may take beyond those that it accounts for: libraries, their tables and blocks
)
# Processor time that a file may take, and each byte of it and of its values: ten times that of a
# sound one.
SECONDS, SECONDS_PER_BYTE, SECONDS_PER_VALUE_BYTE = 5.0, 1e-6, 5e-8
CLOCK = getattr(signal, "ITIMER_PROF", None)  # of the processor's time; Windows has none
PATIENCE = (
    60 if CLOCK is not None else 4
)  # how much more time may go by, while other programs are at work


def check_fits(name: str, size: int) -> None:
    """Raise an InputError if so many bytes are more than there is memory for.

    ``name`` is what takes them.
    """
    room = _reading.room if _reading.room is not None else available()
    if room is not None and size > room:
        raise InputError(
            f"{name}: reading it takes {size / 1e9:.3g} GB, and {room / 1e9:.3g} GB of memory are "
            f"free; {SMALLER}"
        )


def claim(name: str, least: int, most: int) -> None:
    """Check as :func:`check_fits` does that ``least`` bytes can be had, and let the file being read take ``most``."""
    check_fits(name, least)
    if _reading.room is not None:
        _reading.allow(most, least)


def seconds_for(size: int) -> float:
    """Processor time that a file of so many bytes may take before more is known of it."""
    return SECONDS + SECONDS_PER_BYTE * size


class _Reading:
    """Limits of this process while it reads a file.

    Only the process that does nothing else has any.
    """

    room: int | None = None
    """Bytes that were available when it began."""
    seconds = SECONDS

    @contextmanager
    def limited(self, size: int) -> Iterator[None]:
        """Let a file of ``size`` bytes take memory and time as befits it.

        Beyond its time the system ends the process.

        Memory is limited where the system counts addresses (Linux), time where it has such a
        clock (not on Windows).
        """
        outer = None
        if resource is not None:
            outer = resource.getrlimit(resource.RLIMIT_AS)
            resource.setrlimit(
                resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1])
            )
        self.room, self.seconds = available(), seconds_for(size)
        self.allow(2 * size)
        try:
            yield
        finally:
            if CLOCK is not None:
                signal.setitimer(CLOCK, 0)
            if outer is not None:
                with suppress(ValueError, OSError):
                    resource.setrlimit(resource.RLIMIT_AS, outer)
            self.room = None

    def allow(self, size: int, values: int = 0) -> None:
        """Let it have ``size`` bytes, and those to spare, beyond what it has, and time for so many of values."""
        if CLOCK is not None:
            signal.setitimer(CLOCK, self.seconds + SECONDS_PER_VALUE_BYTE * values)
        taken = addresses()
        if resource is None or taken is None:
            return
        room = size if self.room is None else min(size, self.room)
        hard = resource.getrlimit(resource.RLIMIT_AS)[1]
        wanted = taken + SPARE + room
        with suppress(ValueError, OSError):
            resource.setrlimit(
                resource.RLIMIT_AS,
                (wanted if hard == resource.RLIM_INFINITY else min(wanted, hard), hard),
            )


_reading = _Reading()
limited = _reading.limited
