"""The program `tvsysid`: its commands, its errors and its exit codes."""

from __future__ import annotations

import os
import signal
import sys
from io import TextIOWrapper

from cyclopts import App, CycloptsError, Parameter, default_name_transform

from tvsysid.cli.benchmark import benchmark
from tvsysid.cli.check_method import check_method
from tvsysid.cli.console import errors, output
from tvsysid.cli.experiment import experiment
from tvsysid.cli.explore import explore
from tvsysid.cli.identify import identify
from tvsysid.cli.inspect import inspect
from tvsysid.cli.leaderboard import leaderboard
from tvsysid.cli.methods import methods
from tvsysid.cli.options import NAMES
from tvsysid.cli.plan import plan
from tvsysid.cli.report import report
from tvsysid.cli.simulate import simulate
from tvsysid.errors import InputError, one_line

COMMANDS = (
    *(benchmark, leaderboard, experiment, report, identify, explore, inspect),
    *(methods, check_method, simulate, plan),
)
INTERRUPTED = "interrupted; what is finished is kept, and a study is resumed by the same command"
NO_MEMORY = "not enough memory; give a shorter duration, fewer trials or a lower rate"


def version() -> str:
    """Return the text of ``--version``."""
    from tvsysid import __version__

    return f"tvsysid {__version__}"


def default_text(value: object) -> str | None:
    """Return a default value as it is typed; None for one that need not be shown."""
    if isinstance(value, list | tuple):
        value = ", ".join(map(str, value))
    return str(value) if value and value is not True else None


def option_name(name: str) -> str:
    """Return the name of the option for a parameter or a setting."""
    return NAMES.get(name) or default_name_transform(name)


app = App(
    name="tvsysid",
    help="Estimate how stiff a human joint is while it moves: time-varying identification of joint "
    "impedance.\n\nAll units are SI: rad, N·m, s, Hz, N·m/rad, N·m·s/rad, kg·m².",
    help_format="markdown",
    help_flags="--help",
    version=version,
    console=output,
    error_console=errors,
    default_parameter=Parameter(
        name_transform=option_name,
        negative_iterable=(),
        allow_repeating=True,  # the last one counts
        show_default=default_text,
    ),
    suppress_keyboard_interrupt=False,
    result_action="return_value",
)
for command in COMMANDS:
    app.command(command)


def main() -> None:
    """Run the command line, and exit with 2 after a mistake and 130 after an interruption."""
    # A cluster ends a job by SIGTERM. A study is interrupted by it in order, and can be resumed.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal may lack ± and ·
    try:
        sys.path.append(os.getcwd())  # for methods of one's own; last, so that it hides no module
        code, text = app(sys.argv[1:], print_error=False, exit_on_error=False), ""
    except KeyboardInterrupt as interrupted:
        code, text = 130, str(interrupted) or INTERRUPTED
    except CycloptsError as error:
        error.verbose = False
        words = " ".join(["tvsysid", *(error.command_chain or ())])
        problem = str(error).partition(" Available commands")[0].rstrip(".")
        code, text = 2, f"{problem} (see {words} --help)"
    except InputError as error:
        code, text = 2, str(error)
    except OSError as error:
        code, text = 2, f"{error.filename or 'system'}: {error.strerror or error}"
    except MemoryError:
        code, text = 2, NO_MEMORY
    if text:
        errors.print(f"tvsysid: {one_line(text)}", soft_wrap=True)
    sys.exit(code or 0)
