"""`tvsysid check-method`."""

from __future__ import annotations

from tvsysid.cli.console import say


def check_method(method: str, /) -> int:
    """Check whether a method of your own works with the package.

    The method identifies simulated joints, which takes some seconds. Each check prints what was
    expected and what the method did. The exit code is 0 if it passes every required check, 1 if
    not, and 2 if it cannot be loaded.

    Example: `tvsysid check-method mymethod:SlidingFit`

    Example: `tvsysid check-method mymethod:SlidingFit:window=0.2`

    Parameters
    ----------
    method
        Class of the method, as `module:Class`, in a module that is in the current folder or
        installed; or a key that `tvsysid methods` lists.
    """
    from tvsysid.check import check_method as check
    from tvsysid.methods import parse

    checks = check(parse(method))
    for item in checks:
        sign = "✓" if item.passed else "✗"
        advice = " (recommended)" if not (item.required or item.passed) else ""
        style = "" if item.passed else "red" if item.required else "yellow"
        say(f"{sign} {item.name}{advice}: {item.message}", style)
    if any(item.required and not item.passed for item in checks):
        say(f"{method} does not pass")
        return 1
    say(f"{method} passes; use it: tvsysid benchmark --method {method}")
    return 0
