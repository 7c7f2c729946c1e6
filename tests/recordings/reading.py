"""A process that reads the files whose paths come in, one a line, and says of each what happened (`fuzzing.py`)."""

import contextlib
import faulthandler
import gc
import json
import math
import os
import re
import resource
import sys
import traceback
import warnings
from pathlib import Path

from tvsysid import InputError
from tvsysid.recordings import describe_file, load_ensemble, load_recording, worker

GIB = 2**30
ADDRESSES = (
    16 * GIB
)  # a net below: memory that is taken is what is judged, and what is refused far sooner
SECONDS = 20  # of processor time that a file may take
LOADERS = {"recording": load_recording, "ensemble": load_ensemble}  # of files with such a name


def memory(what, process="self"):
    """Bytes that a process and those that it started take (``VmRSS``) or took at most (``VmHWM``)."""
    with contextlib.suppress(OSError, TypeError):  # it ends
        told = Path(f"/proc/{process}/status").read_text(encoding="utf-8", errors="replace")
        return 1024 * int(re.search(rf"{what}:\s+(\d+)", told)[1]) + sum(
            memory(what, pid) for pid in children(process)
        )
    return 0


def children(process="self"):
    tasks = Path(f"/proc/{process}/task").glob("*/children")
    with contextlib.suppress(OSError):
        return [pid for task in tasks for pid in task.read_text(encoding="ascii").split()]
    return []


def attempt(file):
    """What went wrong, how many channels were read, and the bytes that the file states for the largest."""
    wrong, count, size = [], 0, 0

    @contextlib.contextmanager
    def judged(what):
        try:
            yield
        except InputError as error:
            if not str(error).strip() or file.name not in str(error):
                wrong.append(f"{what}: the message does not name the file: {error!r}")
        except BaseException as error:
            wrong.append(f"{what}: {error!r} at {traceback.extract_tb(error.__traceback__)[-1]}")

    channels = {}
    with judged("describe"):
        channels = describe_file(file)
    for name, channel in channels.items():
        with judged(f"read {name!r}"):
            channel.described.encode("utf-8")
            size = max(size, 8 * math.prod(channel.shape))
            channel.read(f"{file.name}: {name}")
            count += 1
    for kind, load in LOADERS.items():
        if kind in file.name:
            with judged("load"):
                load(file)
    return wrong, count, size


def used():
    """Seconds of the processor, of this process and those that it started."""
    ended = sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2]) + sum(
        resource.getrusage(resource.RUSAGE_SELF)[:2]
    )
    with contextlib.suppress(OSError):
        for pid in children():
            fields = (
                Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
            )
            ended += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return ended


def report(file):
    """What happened, and what it took: seconds of the processor, and bytes beyond those that were taken before."""
    for pid in ("self", *children()):
        with contextlib.suppress(OSError):  # it has ended
            Path(f"/proc/{pid}/clear_refs").write_text(
                "5", encoding="ascii"
            )  # the peak begins anew
    before, started, largest = (
        memory("VmRSS"),
        used(),
        resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss,
    )
    wrong, count, size = attempt(file)
    peak, seconds = max(0, memory("VmHWM") - before), used() - started
    if (
        ended := resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    ) > largest:  # of those that have ended
        peak = max(peak, 1024 * ended)
    gc.collect()  # what objects complain of when they go
    if printed := os.pread(2, 1000, 0).decode("utf-8", "replace"):
        wrong.append(f"printed: {printed}")
    if peak > GIB + min(size, 4 * GIB):
        wrong.append(f"{peak / 1e9:.3g} GB of memory, and the file states {size / 1e9:.3g} GB")
    if seconds > SECONDS:
        wrong.append(f"{seconds:.0f} s")
    return {"wrong": wrong, "read": count, "seconds": seconds, "bytes": peak}


def main():
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # libraries may print
    faulthandler.enable()
    warnings.simplefilter("ignore")
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    worker.SECONDS = 1.5  # so small a file need not wait for its end
    for file in sys.argv[1:]:  # sound ones: all libraries are loaded before anything is measured
        wrong, count, _ = attempt(Path(file))
        if wrong or not count:
            sys.exit(f"{file}: {wrong}")
    gc.freeze()  # what is collected later is of files alone
    print("{}", file=answers)
    for line in sys.stdin:
        print(json.dumps(report(Path(line.rstrip("\n")))), file=answers)


if __name__ == "__main__":
    main()
