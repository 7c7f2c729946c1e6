"""How much memory there is, and how much of it and of time the code of others may take. Light."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

try:
    import resource
except ImportError:  # not on Windows
    resource = None  # type: ignore[assignment]

TIME_LIMIT = 600.0
"""Seconds that one identification by somebody else's method may take, if nothing else is said."""


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
    if resource is not None and (taken := addresses()) is not None:
        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        if limit != resource.RLIM_INFINITY:
            yield limit - taken


def addresses() -> int | None:
    """Bytes of addresses that this process has taken, which is what its limit counts; None where nothing tells."""
    return _pages(0)


def _pages(place: int) -> int | None:
    """Bytes of this process by their place in the system's account of it; None where there is none."""
    try:
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[place]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError):
        return None


def keep_within_memory() -> None:
    """Have this process get a MemoryError when it has taken what there is; the computer need not end another one.

    What it may fill is limited, not its addresses, of which some libraries reserve many more (on Linux).
    """
    with suppress(OSError):  # several such processes may take too much together: one of them is to be ended then
        Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")
    room, taken = available(), _pages(5)
    if resource is not None and room is not None and taken is not None:
        hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
        with suppress(ValueError, OSError):
            resource.setrlimit(resource.RLIMIT_DATA, (taken + room, hard))
