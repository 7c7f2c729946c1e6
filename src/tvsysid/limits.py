"""How much memory there is. Light."""

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


def available() -> int | None:
    """Bytes of memory that can be had: what the machine, the control group and the limit of this process leave.

    None where the system tells nothing.
    """
    return (
        max(0, min(rooms)) if (rooms := [*_machine(), *_control_groups(), *_own_limit()]) else None
    )


def _machine() -> Iterator[int]:
    with suppress(OSError):
        told = re.search(
            r"MemAvailable:\s+(\d+) kB", Path("/proc/meminfo").read_text(encoding="ascii")
        )
        if told:
            yield 1024 * int(told[1])
            return
    with suppress(OSError, ValueError, AttributeError):
        yield os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def _control_groups(
    root: Path = Path("/sys/fs/cgroup"), own: Path = Path("/proc/self/cgroup")
) -> Iterator[int]:
    """What each control group around this process leaves, of either version.

    Caches of files can be had too.
    """
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
                    with suppress(
                        OSError, ValueError
                    ):  # a group without a limit has no number there
                        limit, used = (
                            int((folder / name).read_text(encoding="ascii")) for name in names[:2]
                        )
                        told = re.search(
                            rf"^{names[2]} (\d+)$",
                            (folder / "memory.stat").read_text("ascii"),
                            re.M,
                        )
                        yield limit - used + (int(told[1]) if told else 0)


def _own_limit() -> Iterator[int]:
    if resource is not None and (taken := addresses()) is not None:
        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        if limit != resource.RLIM_INFINITY:
            yield limit - taken


def addresses() -> int | None:
    """Bytes of addresses that this process has taken, which is what its limit counts.

    None where nothing tells.
    """
    try:
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * os.sysconf(
            "SC_PAGE_SIZE"
        )
    except (OSError, ValueError):
        return None
