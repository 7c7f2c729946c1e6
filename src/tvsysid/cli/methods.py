"""`tvsysid methods`."""

from __future__ import annotations

from tvsysid.cli.console import remark, say, show_table
from tvsysid.errors import InputError


def methods() -> None:
    """List the methods by what they are for, with their assumptions and settings."""
    from tvsysid.methods import clashes, describe, names

    groups: dict[str, list[tuple[str, ...]]] = {}
    for key in names():
        try:
            title, purpose, assumptions, settings = describe(key)
        except InputError as error:
            groups.setdefault("Cannot be loaded", []).append((key, str(error), "", ""))
            continue
        row = (key, title, "\n".join(f"- {text}" for text in assumptions), "\n".join(settings))
        groups.setdefault(f"For {purpose}", []).append(row)
    for group, rows in groups.items():
        show_table(group, ["key", "method", "assumes", "settings and defaults"], rows, "llll", lines=True)
    say(
        "Durations are in s, frequencies in Hz. Settings follow the key: sds:window=0.2,max_lag=0.1\n"
        "kbr also takes preset=simulation (the default) or preset=experiment: the paper's settings for either study.\n"
        "A method of your own is module:Class or module:Class:setting=value; tvsysid check-method checks it."
    )
    for text in clashes():
        remark("note", text)
