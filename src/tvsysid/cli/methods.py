"""`tvsysid methods`."""

from __future__ import annotations

from tvsysid.cli.console import say, show_table
from tvsysid.errors import InputError

FIRST = ("repeated behaviour", "two pathways", "closed loops")


def methods() -> None:
    """List the methods by their purpose, with needs, results, assumptions and settings."""
    from tvsysid.methods import CLOSED_LOOP, describe, names

    groups: dict[str, list[dict[str, str]]] = {f"For {purpose}": [] for purpose in FIRST}
    for key in (*names(), *CLOSED_LOOP):
        try:
            method = describe(key)
        except InputError as error:
            groups.setdefault("Cannot be loaded", []).append({"key": key, "about": str(error)})
            continue
        lines = {
            "needs": "; ".join(method.needs),
            "reports": ", ".join(method.reports),
            "assumes": " ".join(method.assumptions),
            "settings": ", ".join(method.settings).replace(" = ", "="),
        }
        about = [method.title, *(f"{name}: {text}" for name, text in lines.items() if text)]
        groups.setdefault(f"For {method.purpose}", []).append(
            {"key": key, "about": "\n".join(about)}
        )
    for title, records in groups.items():
        show_table(title, records, {"key": "{key}", "method": "{about}"}, spaced=True)
    say(
        "Beside realizations of angle and torque. Durations are in s, frequencies in Hz. Settings "
        "follow the key: sds:window=0.2,max_lag=0.1\nkbr also takes preset=simulation (the "
        "default) or preset=experiment: the paper's settings for either study.\nA method of your "
        "own is module:Class or module:Class:setting=value; tvsysid check-method checks it."
    )
