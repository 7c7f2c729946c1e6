"""The program `tvsysid`: its commands, and what becomes of errors."""

from __future__ import annotations

import io
import os
import signal
import sys
from contextlib import suppress
from typing import Annotated

import typer

from tvsysid.cli.benchmark import benchmark
from tvsysid.cli.check_method import check_method
from tvsysid.cli.console import errors, say
from tvsysid.cli.experiment import experiment
from tvsysid.cli.identify import identify
from tvsysid.cli.inspect import inspect
from tvsysid.cli.methods import methods
from tvsysid.cli.report import report
from tvsysid.cli.running import INTERRUPTED
from tvsysid.cli.simulate import simulate
from tvsysid.errors import InputError

app = typer.Typer(
    name="tvsysid",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    help="Estimate how stiff a human joint is while it moves: time-varying identification of joint impedance.\n\n"
    "All units are SI: rad, N·m, s, Hz, N·m/rad, N·m·s/rad, kg·m².",
)
for command in (benchmark, experiment, report, identify, inspect, methods, check_method, simulate):
    app.command()(command)


@app.callback(invoke_without_command=True)
def tvsysid(
    version: Annotated[bool, typer.Option("--version", metavar="", help="Print the version and stop.")] = False,
) -> None:
    """Handle the options before the command."""
    if version:
        from tvsysid import __version__

        say(f"tvsysid {__version__}")
        raise typer.Exit


def main() -> None:
    """Run the command line; an error that the user can correct is one line on standard error, with exit code 2."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal that lacks a character shows a question mark
            stream.reconfigure(errors="replace")
    # A cluster ends a job by SIGTERM: treat it as Ctrl-C.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with suppress(OSError):  # the current folder may be gone
        if os.getcwd() not in sys.path:
            sys.path.append(os.getcwd())  # at the end, so that no file in it hides a module
    try:
        code = app(prog_name="tvsysid", standalone_mode=False)
    except InputError as error:
        _stop(str(error))
    except OSError as error:
        _stop(f"{error.filename or 'output'}: {error.strerror or error}; give another file or folder")
    except MemoryError:
        _stop("there is not enough memory for this; give a shorter duration, fewer trials or a lower rate")
    except Exception as error:
        # The usage errors of the parser within typer have a message of their own.
        message = getattr(error, "format_message", None)
        if message is None:
            raise
        if not (text := message().replace("Value error, ", "")):  # no command: the help was printed
            sys.exit(0)
        context = getattr(error, "ctx", None)
        _stop(f"{text} (see {context.command_path if context else 'tvsysid'} --help)")
    else:
        if code == INTERRUPTED:
            errors.print("tvsysid: interrupted; the files that were written are complete")
        sys.exit(code if isinstance(code, int) else 0)


def _stop(message: str) -> None:
    errors.print(f"tvsysid: {' '.join(message.split())}", soft_wrap=True)
    sys.exit(2)
