"""`tvsysid methods`."""

from __future__ import annotations

from tvsysid.cli.console import say, show_table
from tvsysid.errors import InputError


def methods() -> None:
    """List the methods by what they are for, with what they need, report and assume, and their settings."""
    from tvsysid.methods import CLOSED_LOOP, describe, names

    groups: dict[str, list[tuple[str, str]]] = {}
    for text in (*names(), *CLOSED_LOOP):
        try:
            told = describe(text)
        except InputError as error:
            groups.setdefault("Cannot be loaded", []).append((text, str(error)))
            continue
        settings = (each.replace(" = ", "=") for each in told.settings)
        about = {"needs": "; ".join(told.needs), "reports": ", ".join(told.reports)}
        about |= {"assumes": " ".join(told.assumptions), "settings": ", ".join(settings)}
        lines = [told.title, *(f"{heading}: {words}" for heading, words in about.items() if words)]
        row = (text.replace(":", ":\n").replace(",", ",\n"), "\n".join(lines))
        groups.setdefault(f"For {told.purpose}", []).append(row)
    order = [f"For {each}" for each in ("repeated behaviour", "two pathways", "closed loops")]
    for group in (*order, *(each for each in groups if each not in order)):
        show_table(group, ["key", "method"], groups[group], "ll", lines=True)
    say(
        "Beside realizations of angle and torque. Durations are in s, frequencies in Hz. Settings "
        "follow the key: "
        "sds:window=0.2,max_lag=0.1\n"
        "kbr also takes preset=simulation (the default) or preset=experiment: the paper's "
        "settings for either study.\n"
        "A method of your own is module:Class or module:Class:setting=value; tvsysid check-method "
        "checks it."
    )
