"""`tvsysid check-method`."""

from __future__ import annotations

from typing import Annotated

import typer

from tvsysid.cli.console import say


def check_method(
    name: Annotated[
        str,
        typer.Argument(
            metavar="MODULE:CLASS",
            help="Class of the method, in a module that is in the current folder or installed; or "
            "a key that "
            "`tvsysid methods` lists.",
        ),
    ],
) -> None:
    """Check whether a method of your own works with the package.

    The method identifies simulated joints, which takes some seconds. Each check prints what was
    expected and what the method did. The exit code is 0 if it passes every required check, 1 if
    not, and 2 if it cannot be loaded.

    Example: `tvsysid check-method mymethod:SlidingFit`

    Example: `tvsysid check-method mymethod:SlidingFit:window=0.2`
    """
    from tvsysid.check import check_method as check
    from tvsysid.methods import parse

    checks = check(parse(name))
    for item in checks:
        sign = (
            ("✓", "green")
            if item.passed
            else ("✗" if item.run else "–", "red" if item.required else "yellow")
        )
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
