"""`tvsysid check-method`."""

from __future__ import annotations

import pickle
from typing import TYPE_CHECKING, Annotated

import typer

from tvsysid.cli.console import say
from tvsysid.cli.options import option
from tvsysid.errors import InputError
from tvsysid.limits import TIME_LIMIT

if TYPE_CHECKING:
    from tvsysid.check import Check


def check_method(
    name: Annotated[
        str,
        typer.Argument(
            metavar="MODULE:CLASS",
            help="Class of the method, in a module that is in the current folder or installed; or a key that "
            "`tvsysid methods` lists.",
        ),
    ],
    time_limit: Annotated[float, option("S", "Seconds that all checks together may take.")] = TIME_LIMIT,
) -> None:
    """Check whether a method of your own works with the package.

    The method identifies simulated joints, which takes some seconds. Each check prints what was expected and what the
    method did. The exit code is 0 if it passes every required check, 1 if not, and 2 if it cannot be loaded, ends its
    process or takes too long.

    Example: `tvsysid check-method mymethod:SlidingFit`

    Example: `tvsysid check-method mymethod:SlidingFit:window=0.2`
    """
    from tvsysid.methods.apart import checked_limit

    checks = _checked_apart(name, checked_limit(time_limit))
    for item in checks:
        sign = ("✓", "green") if item.passed else ("✗" if item.run else "–", "red" if item.required else "yellow")
        advice = " (recommended)" if item.run and not (item.required or item.passed) else ""
        say(sign, " ", (item.name, "bold"), f"{advice}: {item.message}")
    failed = [item for item in checks if item.run and not item.passed]
    required, advised = (sum(item.required is kind for item in failed) for kind in (True, False))
    not_run = sum(not item.run for item in checks)
    recommended = f"{advised} recommended check{'s' * (advised > 1)}"
    if required:
        also = f", {recommended} too" if advised else ""
        also += f"; {not_run} of {len(checks)} were not run" if not_run else ""
        say(f"{name} does not pass: {required} check{'s' * (required > 1)} failed{also}")
        raise typer.Exit(1)
    also = f"; {recommended} failed" if advised else ""
    say(f"{name} passes{also}; use it: tvsysid benchmark --method {name}")


def _checked_apart(name: str, limit: float) -> list[Check]:
    """Results of the checks, run in a process of their own, in case the method crashes it."""
    from tvsysid.methods import parse
    from tvsysid.methods.forkserver import HungError, MethodError, call

    parse(name)  # a wrong name is reported from this process
    try:
        checks: list[Check] = call(pickle.dumps(name), _checks_of, limit=limit)
    except HungError as error:
        raise InputError(f"method {name}: {error}") from error
    except MethodError as error:
        raise InputError(f"method {name}: {error}; a method must return a model or raise an error") from error
    return checks


def _checks_of(name: str) -> list[Check]:
    from tvsysid.check import check_method as check
    from tvsysid.methods import parse

    return check(parse(name))
