"""The program `tvsysid`: its commands, and what its parser says of mistakes."""

from __future__ import annotations

from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from tvsysid.cli.benchmark import benchmark
from tvsysid.cli.check_method import check_method
from tvsysid.cli.console import say
from tvsysid.cli.experiment import experiment
from tvsysid.cli.explore import explore
from tvsysid.cli.identify import identify
from tvsysid.cli.inspect import inspect
from tvsysid.cli.leaderboard import leaderboard
from tvsysid.cli.methods import methods
from tvsysid.cli.plan import plan
from tvsysid.cli.report import report
from tvsysid.cli.simulate import simulate


def _flag(option: Any) -> Any:
    """The option ``--help``, which takes no value, though the parser's own help shows the type of one."""
    option.metavar = ""
    return option


class _Command(TyperCommand):
    def get_help_option(self, ctx: Any) -> Any:
        return _flag(super().get_help_option(ctx))


class _Commands(TyperGroup):
    def get_help_option(self, ctx: Any) -> Any:
        return _flag(super().get_help_option(ctx))


app = typer.Typer(
    name="tvsysid",
    cls=_Commands,
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    help="Estimate how stiff a human joint is while it moves: time-varying identification of "
    "joint impedance.\n\n"
    "All units are SI: rad, N·m, s, Hz, N·m/rad, N·m·s/rad, kg·m².",
)
for command in (
    benchmark,
    leaderboard,
    experiment,
    report,
    identify,
    explore,
    inspect,
    methods,
    check_method,
    simulate,
    plan,
):
    app.command(cls=_Command)(command)


@app.callback(invoke_without_command=True)
def tvsysid(
    version: Annotated[
        bool, typer.Option("--version", metavar="", help="Print the version and stop.")
    ] = False,
) -> None:
    """Handle the options before the command."""
    if version:
        from tvsysid import __version__

        say(f"tvsysid {__version__}")
        raise typer.Exit


def usage_error(error: Exception) -> str | None:
    """What a mistake on the command line was.

    Nothing if only the help was asked for, None if it is another error.
    """
    message = getattr(error, "format_message", None)  # of the parser within typer
    if message is None:
        return None
    context = getattr(error, "ctx", None)
    text = (
        _missing(context)
        if type(error).__name__ == "MissingParameter"
        else message().replace("Value error, ", "")
    )
    return f"{text} (see {context.command_path if context else 'tvsysid'} --help)" if text else ""


def _missing(context: Any) -> str:
    """All that is missing.

    The parser has taken in first what was given, and reports only the first that is not.
    """
    needed = [
        each
        for each in context.command.get_params(context)
        if each.required and each.name not in context.params
    ]
    return "missing: " + ", ".join(each.get_error_hint().strip("'") for each in needed)
