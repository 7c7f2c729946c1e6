"""A process for each method of somebody else's, forked from a server, and killed when its time is over.

    this process -> fork server: the package is loaded there, and nobody's method -> a process for each method

The server starts once, in a second. A method's process is a fork of it, which takes milliseconds and knows nothing of
any other method; it is kept for the method's next call. It is killed, with all that it has started in its process
group, when the method takes too long, and when the process that asks ends. Where a system cannot fork (Windows),
methods run in the process that asks, without a limit.
"""

from __future__ import annotations

import atexit
import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, NoReturn

import cloudpickle

from tvsysid.errors import DataQualityWarning, InputError, describe_error, plain_text
from tvsysid.limits import TIME_LIMIT, keep_within_memory
from tvsysid.methods.base import SkippedError
from tvsysid.methods.travel import plain

LARGEST = 2**31  # bytes of what a method's process sends back
LONGEST_S = 1e7  # of what a socket waits for
KEPT = 32  # processes that wait for their method's next call; the one that was not called for longest is ended
MOST_WARNINGS = 20  # warnings of one identification that are kept
FORKS = hasattr(os, "fork")
Answer = tuple[str, Any, list[str]]  # "result", "skipped" or "failed"; the result or the reason; warnings


class MethodError(InputError):
    """Somebody else's method failed; the message says how."""


class HungError(MethodError):
    """Somebody else's method took longer than it may."""


def call(method: bytes, verb: Callable[..., Any], *given: object, limit: float = TIME_LIMIT) -> Any:
    """What ``verb(method, *given)`` gives in the process of a pickled method; warnings are warned of here.

    Raises
    ------
    SkippedError, MethodError
        If it raises, in the words of :func:`tvsysid.errors.describe_error`; HungError if it takes longer than the limit
        in seconds.
    """
    work = pickle.dumps((verb, given))
    if FORKS:
        with _LOCK:
            kind, result, told = _the_server().asked(method, work, limit)
    else:
        kind, result, told = _answer(method, work)
    for text in told:
        warnings.warn(text, DataQualityWarning, stacklevel=3)
    if kind == "skipped":
        raise SkippedError(result)
    if kind == "failed":
        raise MethodError(result)
    return result


@dataclass
class _Child:
    """A method's process, and the socket to it."""

    process: int
    line: socket.socket

    def end(self) -> None:
        """Kill it with all that it has started in its process group."""
        self.line.close()
        with suppress(OSError):
            os.killpg(self.process, signal.SIGKILL)


@dataclass
class _Server:
    """The fork server of this process, and the methods' processes by pickled method."""

    program: subprocess.Popen[bytes]
    control: socket.socket
    owner: int = field(default_factory=os.getpid)
    children: dict[bytes, _Child] = field(default_factory=dict)

    @classmethod
    def start(cls) -> _Server:
        """Start it in a session of its own, so that an interruption from the terminal is left to this process."""
        ours, theirs = socket.socketpair()
        path = f"import sys; sys.path[:] = {[*map(str, sys.path)]!r}"
        code = f"{path}; from tvsysid.methods import apart, forkserver; forkserver.serve()"
        single = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "VECLIB_MAXIMUM")}
        with theirs:
            program = subprocess.Popen(
                [sys.executable, "-c", code, str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                pass_fds=[theirs.fileno()],
                env=os.environ | single,
                start_new_session=True,
            )
        return cls(program, ours)

    def asked(self, method: bytes, work: bytes, limit: float) -> Answer:
        """Kind of answer, the answer, and the texts of warnings."""
        child = self.children.pop(method, None) or self._forked()
        self.children[method] = child  # at the end: the last one called
        while len(self.children) > KEPT:
            self.children.pop(next(iter(self.children))).end()
        try:
            folder = os.getcwd() if os.path.exists(".") else None
            until = time.monotonic() + min(limit, LONGEST_S)
            _send(child.line, pickle.dumps((sys.path, folder, method)), until)
            _send(child.line, work, until)
            content = _received(child.line, until)
            try:
                answer: Answer = plain(content)
            except Exception as error:
                raise MethodError(f"what it gave cannot be read: {plain_text(error)}") from error
        except BaseException as error:
            self.children.pop(method).end()
            if isinstance(error, TimeoutError):
                raise HungError(
                    f"it took longer than the time limit of {limit:g} s and was ended; give a longer one "
                    "(--time-limit, time_limit=) if it needs that"
                ) from error
            if isinstance(error, (EOFError, OSError)):
                raise MethodError(
                    "its process ended without a result: it crashed, left it by os._exit, or took more memory than "
                    "there is"
                ) from error
            raise
        return answer

    def _forked(self) -> _Child:
        ours, theirs = socket.socketpair()
        try:
            with theirs:
                socket.send_fds(self.control, [b"fork"], [theirs.fileno()])
            return _Child(int.from_bytes(_exactly(self.control, 8, None), "little"), ours)
        except BaseException as error:
            self.end()  # who asks next must not get this answer
            if isinstance(error, (EOFError, OSError)):
                raise MethodError("no process could be started for it; is there enough memory?") from error
            raise

    def end(self) -> None:
        """Kill all processes."""
        for child in self.children.values():
            child.end()
        self.children.clear()
        self.control.close()
        self.program.kill()
        self.program.wait()


_LOCK = threading.RLock()  # one method at a time
_servers: list[_Server] = []  # none, or the one of this process


def _the_server() -> _Server:
    """Fork server of this process; another where there is none, or a method has killed it."""
    if _servers and (_servers[0].owner != os.getpid() or _servers[0].program.poll() is not None):
        lost = _servers.pop()
        if lost.owner == os.getpid():
            lost.end()
    if not _servers:
        _servers.append(_Server.start())
    return _servers[0]


@atexit.register
def _end() -> None:
    for server in _servers:
        if server.owner == os.getpid():
            server.end()


def serve() -> NoReturn:
    """Be the fork server, until the process that it serves ends; then kill all that it has started."""
    control = socket.socket(fileno=int(sys.argv[1]))
    warnings.simplefilter("ignore", DeprecationWarning)  # of forking where BLAS has threads, which it sees to
    children: list[int] = []
    while True:
        with suppress(OSError):
            message, lines, *_ = socket.recv_fds(control, 4, 1)
            if message:
                for process in [each for each in children if os.waitpid(each, os.WNOHANG)[0]]:
                    children.remove(process)
                if not (process := os.fork()):
                    control.close()
                    _work(socket.socket(fileno=lines[0]))
                os.close(lines[0])
                children.append(process)
                control.sendall(process.to_bytes(8, "little"))
                continue
        for process in children:
            with suppress(OSError):
                os.killpg(process, signal.SIGKILL)
        os._exit(0)


def _work(line: socket.socket) -> NoReturn:
    """Be the process of one method, until it is no longer asked."""
    os.setsid()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.register_at_fork(after_in_child=line.close)  # what a method forks answers nobody
    try:
        while True:
            path, folder, method = pickle.loads(_received(line, None))
            work = _received(line, None)
            sys.path[:] = path
            if folder is not None:
                os.chdir(folder)
            keep_within_memory()
            answer = _answer(method, work)
            with suppress(Exception):
                sys.stdout.flush()
            _send(line, _packed(answer), None)
    finally:
        os._exit(0)  # whatever threads it has left


def _answer(method: bytes, work: bytes | bytearray) -> Answer:
    """Kind of answer, the answer, and the texts of warnings; whatever is raised has failed."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataQualityWarning)
        try:
            verb, given = pickle.loads(work)
            kind, result = "result", verb(cloudpickle.loads(method), *given)
        except SkippedError as error:
            kind, result = "skipped", plain_text(error)
        except BaseException as error:  # this process is the method's own, and no interruption reaches it
            if isinstance(error, KeyboardInterrupt) and not FORKS:
                raise
            kind, result = "failed", describe_error(error)
    return kind, result, _told(item.message for item in caught if issubclass(item.category, DataQualityWarning))


def _told(messages: Iterable[object]) -> list[str]:
    """Texts of warnings, each once, and not of more than anyone reads."""
    texts = list(dict.fromkeys(map(plain_text, messages)))
    more = len(texts) - MOST_WARNINGS
    return texts if more <= 0 else [*texts[:MOST_WARNINGS], f"and {more} more warnings"]


def _packed(answer: Answer) -> bytes:
    try:
        content = pickle.dumps(answer)
    except BaseException as error:
        content = pickle.dumps(("failed", f"what it gave cannot be sent: {describe_error(error)}", []))
    if len(content) > LARGEST:
        reason = f"what it gave has {len(content) / 1e9:.1f} GB; expected {LARGEST / 1e9:.1f} GB at most"
        content = pickle.dumps(("failed", reason, []))
    return content


def _send(line: socket.socket, content: bytes, until: float | None) -> None:
    """Send a message, its length before it; a TimeoutError where it is not taken in time."""
    line.settimeout(_left(until))
    line.sendall(len(content).to_bytes(8, "little"))
    line.settimeout(_left(until))
    line.sendall(content)


def _received(line: socket.socket, until: float | None) -> bytearray:
    """Receive a message."""
    return _exactly(line, int.from_bytes(_exactly(line, 8, until), "little"), until)


def _exactly(line: socket.socket, length: int, until: float | None) -> bytearray:
    content = bytearray(length)
    view = memoryview(content)
    while view:
        line.settimeout(_left(until))
        if not (count := line.recv_into(view)):
            raise EOFError
        view = view[count:]
    return content


def _left(until: float | None) -> float | None:
    """Seconds that are left; a TimeoutError where none are."""
    if until is None:
        return None
    if (left := until - time.monotonic()) <= 0:
        raise TimeoutError
    return left
