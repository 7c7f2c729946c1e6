"""`tvsysid check-method`."""

from __future__ import annotations

from tvsysid.cli.console import say


def check_method(method: str, /) -> int:
    """Check whether a method of your own works with the package.

    The method identifies simulated joints, which takes some seconds. Each check prints what was
    expected and what the method did. The exit code is 0 if it passes every check, 1 if not, and 2
    if it cannot be loaded.

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

    results = check(parse(method))
    for item in results:
        say(f"{'✓' if item.passed else '✗'} {item.name}: {item.message}")
    passed = all(item.passed for item in results)
    advice = f"passes; use it: tvsysid benchmark --method {method}"
    say(f"{method} {advice if passed else 'does not pass'}")
    return int(not passed)
