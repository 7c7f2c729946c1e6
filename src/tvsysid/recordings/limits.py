"""How much memory there is, and how much of it and of time the reading of one file may take."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tvsysid.errors import InputError

try:
    import resource
except ImportError:  # not on Windows
    resource = None  # type: ignore[assignment]

SMALLER = "save the part that is needed to a file of its own"
SPARE = 768 * 2**20  # bytes that a file may take beyond those that it accounts for: libraries, their tables and blocks
# Processor time that a file may take, and each byte of it and of its values: ten times that of a sound one.
SECONDS, SECONDS_PER_BYTE, SECONDS_PER_VALUE_BYTE = 5.0, 1e-6, 5e-8
CLOCK = getattr(signal, "ITIMER_PROF", None)  # of the processor's time; Windows has none
PATIENCE = 60 if CLOCK is not None else 4  # how much more time may go by, while other programs are at work


def available() -> int | None:
    """Bytes of memory that can be had: what the machine, the control group and the limit of this process leave.

    None where the system tells nothing.
    """
    return max(0, min(rooms)) if (rooms := [*_machine(), *_control_groups(), *_own_limit()]) else None


def _machine() -> Iterator[int]:
    with suppress(OSError):
        told = re.search(r"MemAvailable:\s+(\d+) kB", Path("/proc/meminfo").read_text(encoding="ascii"))
        if told:
            yield 1024 * int(told[1])
            return
    with suppress(OSError, ValueError, AttributeError):
        yield os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def _control_groups(root: Path = Path("/sys/fs/cgroup"), own: Path = Path("/proc/self/cgroup")) -> Iterator[int]:
    """What each control group around this process leaves, of either version; caches of files can be had too."""
    with suppress(OSError, ValueError):
        for line in own.read_text(encoding="utf-8", errors="replace").splitlines():
            number, kinds, path = line.split(":", 2)
            if number == "0":
                mount, names = root, ("memory.max", "memory.current", "inactive_file")
            elif "memory" in kinds.split(","):
                mount, names = (
                    root / "memory",
                    ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
                )
            else:
                continue
            inner = mount / path.lstrip("/")
            for folder in (inner, *inner.parents):
                if folder.is_relative_to(mount):
                    with suppress(OSError, ValueError):  # a group without a limit has no number there
                        limit, used = (int((folder / name).read_text(encoding="ascii")) for name in names[:2])
                        told = re.search(rf"^{names[2]} (\d+)$", (folder / "memory.stat").read_text("ascii"), re.M)
                        yield limit - used + (int(told[1]) if told else 0)


def _own_limit() -> Iterator[int]:
    if resource is not None and (addresses := _addresses()) is not None:
        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        if limit != resource.RLIM_INFINITY:
            yield limit - addresses


def _addresses() -> int | None:
    """Bytes of addresses that this process has taken, which is what its limit counts; None where nothing tells."""
    try:
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError):
        return None


def check_fits(name: str, size: int) -> None:
    """Raise an InputError if so many bytes are more than there is memory for; ``name`` is what takes them."""
    room = _reading.room if _reading.room is not None else available()
    if room is not None and size > room:
        raise InputError(
            f"{name}: reading it takes {size / 1e9:.3g} GB, and {room / 1e9:.3g} GB of memory are free; {SMALLER}"
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
    """Limits of this process while it reads a file; only the process that does nothing else has any."""

    room: int | None = None
    """Bytes that were available when it began."""
    seconds = SECONDS

    @contextmanager
    def limited(self, size: int) -> Iterator[None]:
        """Let a file of ``size`` bytes take memory and time as befits it; beyond its time the system ends the process.

        Memory is limited where the system counts addresses (Linux), time where it has such a clock (not on Windows).
        """
        outer = None
        if resource is not None:
            outer = resource.getrlimit(resource.RLIMIT_AS)
            resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))
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
        addresses = _addresses()
        if resource is None or addresses is None:
            return
        room = size if self.room is None else min(size, self.room)
        hard = resource.getrlimit(resource.RLIMIT_AS)[1]
        wanted = addresses + SPARE + room
        with suppress(ValueError, OSError):
            resource.setrlimit(
                resource.RLIMIT_AS, (wanted if hard == resource.RLIM_INFINITY else min(wanted, hard), hard)
            )


_reading = _Reading()
limited = _reading.limited
