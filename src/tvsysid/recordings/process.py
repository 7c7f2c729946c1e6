"""Files are read in a process of their own, so that no file can crash, stop or fill the one that asks.

The libraries beneath are not made for damaged files: a changed byte makes some of them (ezc3d,
SciPy's and mat-io's readers of MAT files, at times HDF5) follow a wild pointer, run in circles,
or ask for all memory. So one process reads all files, with limits (:mod:`.limits`) that befit
each; if it dies, that is an InputError, and the next file gets a new one. It starts with the
first file, which takes some tenths of a second, and ends with the process that asks. What comes
back are JSON and the bytes of arrays: nothing is unpickled.
"""

from __future__ import annotations

import atexit
import json
import math
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError
from tvsysid.recordings.channel import Channel
from tvsysid.recordings.limits import PATIENCE, SMALLER, seconds_for

PROGRAM = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); from tvsysid.recordings.serve "
    "import serve; serve()"
)
SETTINGS = {
    "HDF5_PLUGIN_PRELOAD": "::",  # HDF5 loads no filters from folders
    "ARROW_DEFAULT_MEMORY_POOL": "system",  # the others reserve addresses, which are limited
    **dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
}
Answer = tuple[dict[str, Any], dict[str, NDArray[Any]]]


def describe_file(path: str | Path, header: bool = True) -> dict[str, Channel]:
    """Channels that a file holds, each with shape, type, and unit and sampling rate where the file states them.

    By name, in the file's order, for any format that :func:`tvsysid.read_recording` reads.
    Values are read when asked for: ``channel.read(name)``. Of text without a line of names
    (``header=False``), columns are called 1, 2, ... An InputError is raised if the file cannot
    be read, or is not what its ending says.
    """
    file = Path(path)
    told, arrays = _reader.ask("describe", file, header)

    def values(name: str) -> NDArray[Any]:
        return _reader.ask("values", file, name)[1][name]

    channels = {}
    for name, (shape, dtype, unit, rate, starts, readable) in told["channels"].items():
        read: Callable[[], NDArray[Any]] | None = None
        if readable:
            read = partial(np.asarray, arrays[name]) if name in arrays else partial(values, name)
        channels[name] = Channel(
            tuple(shape), dtype, unit, rate, tuple(starts), read, held=name in arrays
        )
    return channels


def contents_of(file: Path) -> dict[str, Any]:
    """Variables and attributes, as arrays and texts, of a file that this package wrote."""
    told, arrays = _reader.ask("contents", file)
    return {**told["texts"], **arrays}


class _Reader:
    """The process that reads files, as long as it lives.

    One for all threads, and none that a fork would share.
    """

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.process: subprocess.Popen[bytes] | None = None

    def ask(self, action: str, file: Path, *more: str | bool) -> Answer:
        """What it answers; an InputError if that is an error, or if it dies of the file."""
        seconds = seconds_for(file.stat().st_size if file.is_file() else 0)
        with self.lock:
            process, late = self._running(), threading.Event()

            def end() -> None:
                late.set()
                process.kill()

            watch = threading.Timer(PATIENCE * seconds, end)
            watch.daemon = True
            watch.start()
            try:
                told, arrays = _exchange(process, [action, _folder(), str(file), *more])
            except (OSError, EOFError, ValueError):
                with suppress(subprocess.TimeoutExpired):
                    process.wait(1)
                self.stop()
                raise InputError(
                    f"{file}: {_why(process.returncode, late.is_set(), seconds)}"
                ) from None
            except MemoryError as error:
                self.stop()
                raise InputError(
                    f"{file}: there is not enough memory for its values; {SMALLER}"
                ) from error
            except BaseException:  # Ctrl-C: its answer would be taken for the next one
                self.stop()
                raise
            finally:
                watch.cancel()
        if "error" in told:
            raise InputError(told["error"])
        return told, arrays

    def _running(self) -> subprocess.Popen[bytes]:
        if self.process is None or self.process.poll() is not None:
            self.stop()
            folders = json.dumps([folder for folder in sys.path if folder])
            try:
                self.process = subprocess.Popen(
                    [sys.executable, "-P", "-c", PROGRAM, folders],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.DEVNULL,
                    env=os.environ | SETTINGS,
                )
            except OSError as error:
                raise InputError(
                    f"the process that reads files cannot be started: {error.strerror or error}"
                ) from error
        return self.process

    def stop(self) -> None:
        """End it, whatever it is doing."""
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            for stream in (self.process.stdin, self.process.stdout):
                with suppress(OSError):  # what could not be written
                    stream.close()  # type: ignore[union-attr]
            self.process = None


def _exchange(process: subprocess.Popen[bytes], request: list[str | bool]) -> Answer:
    """Send a request and receive its answer; an EOFError if the process is gone."""
    asked, answers = process.stdin, process.stdout
    if asked is None or answers is None:
        raise EOFError
    asked.write(json.dumps(request).encode() + b"\n")
    asked.flush()
    if not (line := answers.readline()).endswith(b"\n"):
        raise EOFError
    told = json.loads(line)
    return told, {name: _received(answers, *layout) for name, *layout in told.pop("arrays")}


def _received(stream: IO[bytes], dtype: str, shape: list[int], by_columns: bool) -> NDArray[Any]:
    """Array of the bytes that come next."""
    values = np.empty(math.prod(shape), np.dtype(dtype))
    rest = values.view(np.uint8).data
    while rest:
        if not (count := stream.readinto(rest)):  # type: ignore[attr-defined]
            raise EOFError
        rest = rest[count:]
    values.flags.writeable = False  # so that recordings need no copy
    return values.reshape(shape, order="F" if by_columns else "C")


def _folder() -> str:
    try:
        return os.getcwd()
    except OSError:  # it is gone
        return os.sep


def _why(code: int | None, late: bool, seconds: float) -> str:
    """What happened to the process that read a file, and what to do."""
    signals = {-item.value: item.name for item in signal.Signals}
    name = signals.get(code or 0, f"code {code}")
    if late or name in ("SIGPROF", "SIGXCPU"):
        took = "too long" if late else f"more than {seconds:.0f} s of processor time"
        return f"reading it took {took}, and was stopped; it is probably damaged: copy it again"
    if name == "SIGKILL":
        return f"the system ended its reading, as it does when memory runs out; {SMALLER}"
    return f"the library that reads such files crashed ({name}); it is damaged: copy it again"


_reader = _Reader()
atexit.register(_reader.stop)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_reader.__init__)  # type: ignore[misc]
