"""`tvsysid methods`."""

from __future__ import annotations

from tvsysid.cli.console import say, show_table
from tvsysid.errors import InputError

FIRST = ("repeated behaviour", "two pathways", "closed loops")


def methods() -> None:
    """List the methods by their purpose, with needs, results, assumptions and settings."""
    from tvsysid.methods import CLOSED_LOOP, describe, names

    groups: dict[str, list[tuple[str, str]]] = {f"For {purpose}": [] for purpose in FIRST}
    for text in (*names(), *CLOSED_LOOP):
        try:
            method = describe(text)
        except InputError as error:
            groups.setdefault("Cannot be loaded", []).append((text, str(error)))
            continue
        lines = {
            "needs": "; ".join(method.needs),
            "reports": ", ".join(method.reports),
            "assumes": " ".join(method.assumptions),
            "settings": ", ".join(method.settings).replace(" = ", "="),
        }
        about = [method.title, *(f"{name}: {words}" for name, words in lines.items() if words)]
        row = (text.replace(":", ":\n").replace(",", ",\n"), "\n".join(about))
        groups.setdefault(f"For {method.purpose}", []).append(row)
    for group, rows in groups.items():
        show_table(group, ["key", "method"], rows, "ll", lines=True)
    say(
        "Beside realizations of angle and torque. Durations are in s, frequencies in Hz. Settings "
        "follow the key: sds:window=0.2,max_lag=0.1\n"
        "kbr also takes preset=simulation (the default) or preset=experiment: the paper's "
        "settings for either study.\n"
        "A method of your own is module:Class or module:Class:setting=value; tvsysid check-method "
        "checks it."
    )
