"""`tvsysid methods`."""

from __future__ import annotations

from tvsysid.cli.console import say, show_table
from tvsysid.errors import InputError


def methods() -> None:
    """List the methods by their purpose, with needs, results, assumptions and settings."""
    from tvsysid.methods import CLOSED_LOOP, describe, names

    groups: dict[str, list[dict[str, str]]] = {}
    for key in (*names(), *CLOSED_LOOP):
        try:
            method = describe(key)
        except InputError as error:
            group, about = "Cannot be loaded", [str(error)]
        else:
            details = {
                "needs": "; ".join(method.needs),
                "reports": ", ".join(method.reports),
                "assumes": " ".join(method.assumptions),
                "settings": ", ".join(method.settings).replace(" = ", "="),
            }
            lines = [f"{name}: {text}" for name, text in details.items() if text]
            group, about = f"For {method.purpose}", [method.title, *lines, ""]
        groups.setdefault(group, []).append({"key": key, "about": "\n".join(about)})
    for title, records in groups.items():
        show_table(title, records, {"key": "key", "method": "about"})
    say(
        "Beside realizations of angle and torque. Durations are in s, frequencies in Hz. Settings "
        "follow the key: sds:window=0.2,max_lag=0.1\nkbr also takes preset=simulation (the "
        "default) or preset=experiment: the paper's settings for either study.\nA method of your "
        "own is module:Class or module:Class:setting=value; tvsysid check-method checks it."
    )
