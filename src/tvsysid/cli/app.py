"""Run the command line `tvsysid`, and turn errors into messages and exit codes."""

from __future__ import annotations

import gc
import os
import signal
import sys
import warnings
from importlib import import_module
from io import TextIOWrapper

from cyclopts import App, CycloptsError, Parameter

from tvsysid import __version__
from tvsysid.cli.console import errors, output, remark
from tvsysid.cli.options import option_name, use_saved_settings
from tvsysid.errors import DataQualityWarning, InputError

COMMANDS = (
    "benchmark",
    "leaderboard",
    "experiment",
    "report",
    "identify",
    "explore",
    "inspect",
    "methods",
    "check_method",
    "simulate",
    "plan",
)
STUDIES = {"benchmark", "leaderboard", "experiment"}

app = App(
    name="tvsysid",
    help="Estimate how stiff a human joint is while it moves: time-varying identification of joint "
    "impedance.\n\nAll units are SI: rad, N·m, s, Hz, N·m/rad, N·m·s/rad, kg·m².",
    help_format="markdown",
    help_flags="--help",
    version=f"tvsysid {__version__}",
    console=output,
    error_console=errors,
    default_parameter=Parameter(
        name_transform=option_name,
        negative_iterable=(),
        allow_repeating=True,  # the last one counts
        show_default=lambda value: str(value) if value and value is not True else None,
    ),
    config=use_saved_settings,
    suppress_keyboard_interrupt=False,
    result_action="return_value",
)
for command in COMMANDS:
    app.command(getattr(import_module(f"tvsysid.cli.{command}"), command))


def main() -> None:
    """Run the command line, and exit with 2 after a mistake and 130 after an interruption."""
    # A cluster ends a job by SIGTERM. Handle it like Ctrl-C, so that a study can be resumed.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal may lack ± and ·
    # Looking for garbage in reference cycles would take a tenth of the time of drawing.
    gc.set_threshold(100_000)
    # Methods use one BLAS thread. Starting and stopping more would take 10 % of the time.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    warnings.simplefilter("once", DataQualityWarning)
    warnings.showwarning = lambda message, *_: remark("warning", str(message))
    sys.path.append(os.getcwd())  # for the user's own methods; last, so that they hide no module
    try:
        sys.exit(app(sys.argv[1:], print_error=False, exit_on_error=False) or 0)
    except KeyboardInterrupt:
        code, text = 130, "interrupted"
        if STUDIES.intersection(sys.argv[1:2]):
            text += ". Finished work is kept. To resume, run the same command again"
    except CycloptsError as error:
        error.verbose = False
        problem = str(error).partition(" Available commands")[0].rstrip(".")
        typed = " ".join(["tvsysid", *(error.command_chain or ())])
        code, text = 2, f"{problem} (see {typed} --help)"
    except OSError as error:
        code, text = 2, f"{error.filename or 'system'}: {error.strerror or error}"
    except (InputError, MemoryError) as error:
        code, text = 2, str(error) or "not enough memory. Use less data or a lower rate"
    remark("tvsysid", text)
    sys.exit(code)
