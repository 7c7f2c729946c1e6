"""`tvsysid check-method`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from tvsysid.cli.console import say
from tvsysid.errors import InputError

if TYPE_CHECKING:
    from tvsysid.check import Check


def check_method(
    name: Annotated[
        str,
        typer.Argument(
            metavar="MODULE:CLASS", help="Module in the current folder or installed, and the class in it; or any key."
        ),
    ],
) -> None:
    """Check a method of your own against all that is expected of a method.

    Lets it identify simulated joints, says in plain words what was expected and what came, and takes some seconds. The
    exit code is 0 if it passes all that is required, 1 if not, and 2 if it cannot be loaded.

    Example: `tvsysid check-method mymethod:SlidingFit`, or with settings `mymethod:SlidingFit:window=0.2`
    """
    checks = _checked_apart(name)
    for item in checks:
        sign = ("✓", "green") if item.passed else ("✗", "red" if item.required else "yellow")
        advice = "" if item.required or item.passed else " (advice)"
        say(sign, " ", (item.name, "bold"), f"{advice}: {item.message}")
    required, advised = (
        sum(1 for item in checks if not item.passed and item.required is kind) for kind in (True, False)
    )
    also = f"; {advised} of the advice given {'is' if advised == 1 else 'are'} not followed" if advised else ""
    if required:
        say(f"{name} does not pass: {required} of {len(checks)} checks failed or were not reached{also}")
        raise typer.Exit(1)
    say(f"{name} passes{also}: enter it with tvsysid benchmark --method {name}")


def _checked_apart(name: str) -> list[Check]:
    """Checks of a method in a process of its own, which it may end."""
    from concurrent.futures import BrokenExecutor

    from tvsysid.execution import processes
    from tvsysid.methods import parse

    parse(name)  # what is wrong with the name is told from here
    with processes(1) as pool:
        try:
            return pool.submit(_checks_of, name).result()
        except BrokenExecutor as error:
            raise InputError(
                f"method {name}: it ends the whole process, as os._exit or a crash in compiled code does; a method "
                "must return a model, or raise an error"
            ) from error


def _checks_of(name: str) -> list[Check]:
    from tvsysid.check import check_method as check
    from tvsysid.methods import parse

    return check(parse(name))
