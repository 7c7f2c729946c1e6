"""Where the program starts and ends: signals, streams, errors, exit codes.

Light, so that it is ready at once.
"""

from __future__ import annotations

import atexit
import errno
import io
import os
import signal
import sys
import time
from contextlib import suppress

TYPE_CHECKING = False  # importing typing takes a while, in which Ctrl-C would show a traceback
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

INTERRUPTED = (
    130  # exit code after Ctrl-C; 128 and the signal's number after any other that ends a program
)
# seconds within which a second signal is the same request: a job's end is often announced twice
TWICE_S = 1.0


def main() -> None:
    """Run the command line.

    An error that the user can correct is one line on standard error, with exit code 2. Ctrl-C
    and the signal by which a cluster ends a job end the program in order wherever it is; a
    second one ends it at once.
    """
    _open_standard_streams()
    stopped: dict[int, float] = {}

    def stop(number: int, frame: FrameType | None) -> None:
        if stopped and time.monotonic() - max(stopped.values()) > TWICE_S:
            os._exit(128 + number)
        elif not stopped:
            stopped[number] = time.monotonic()
            raise KeyboardInterrupt

    _on_signals(stop)
    try:
        import threading

        before = threading.enumerate()
        code, text = _run()
    except BaseException as error:
        if not stopped and not isinstance(error, KeyboardInterrupt):
            raise
        code, text = INTERRUPTED, ""
    if stopped:
        code = 128 + next(iter(stopped))
        text = (
            text
            if text.startswith("interrupted")
            else "interrupted; the files that were written are complete"
        )
    elif code == INTERRUPTED:
        code, text = (
            2,
            "nobody interrupted it, but the code of a method or system raised KeyboardInterrupt; "
            "mend that",
        )
    _say_end(code, text)
    # Python may insist on ending by SIGINT, if what was interrupted was code that it made while it
    # ran; and it would
    # wait for the threads that a method's module leaves behind.
    if stopped or not all(each.daemon for each in threading.enumerate() if each not in before):
        atexit._run_exitfuncs()
        os._exit(code)
    sys.exit(code)


def _open_standard_streams() -> None:
    """Put something in the place of streams that are closed: files of results must not be opened as these."""
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(
            stream, io.TextIOWrapper
        ):  # a terminal that lacks a character shows a question mark
            stream.reconfigure(errors="replace")


def _on_signals(do: Callable[[int, FrameType | None], object]) -> None:
    """Handle what ends a program, unless it was started such that it ignores that (nohup, or behind &)."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # Windows has no SIGHUP
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, do)


def _run() -> tuple[int, str]:
    """Exit code of the command, and what is to be said of its end."""
    from tvsysid.cli.app import app, usage_error
    from tvsysid.cli.console import output
    from tvsysid.errors import InputError

    try:
        if os.getcwd() not in sys.path:
            sys.path.append(os.getcwd())  # at the end, so that no file in it hides a module
        code = app(prog_name="tvsysid", standalone_mode=False)
    except SystemExit as ended:
        read_no_further = isinstance(ended.__context__, BrokenPipeError)  # as by --help | head
        code = 0 if read_no_further else ended.code
    except InputError as error:
        return 2, str(error)
    except OSError as error:
        return 2, _of_the_system(error)
    except MemoryError:
        return (
            2,
            "there is not enough memory for this; give a shorter duration, fewer trials or a "
            "lower rate",
        )
    except Exception as error:
        text = usage_error(error)
        if text is None:
            raise
        return (2, text) if text else (0, "")  # no command: the help was printed
    if (
        output.lost is not None and output.lost.errno != errno.EPIPE
    ):  # who reads the first lines only loses nothing
        return (
            2,
            f"standard output: {output.lost.strerror}; what was not printed is lost, the files "
            "are complete",
        )
    return (1, code) if isinstance(code, str) else (code if isinstance(code, int) else 0, "")


def _of_the_system(error: OSError) -> str:
    what = error.strerror or str(error)
    if isinstance(error, FileNotFoundError) and not error.filename:
        return "the current folder is gone; go to one that is there"
    where = f"{error.filename!s}: {what}" if error.filename else f"the system reports: {what}"
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return (
            f"{where}; make room there, or give another folder. What was written before is complete"
        )
    return f"{where}; give another file or folder"


def _say_end(code: int, text: str) -> None:
    """Say why the program ends; from here on, a signal only ends it sooner."""
    _on_signals(lambda number, frame: os._exit(code))
    from tvsysid.errors import one_line

    if sys.stderr is not None and text:
        with suppress(OSError):
            print(f"tvsysid: {one_line(text)}", file=sys.stderr, flush=True)
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None:
                stream.flush()
        except OSError:  # it would fail again, and be reported, when the interpreter ends
            with suppress(OSError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
