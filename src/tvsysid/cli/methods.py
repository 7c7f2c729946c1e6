"""`tvsysid methods`."""

from __future__ import annotations

from tvsysid.cli.console import say, show_table


def methods() -> None:
    """List the methods by their purpose, with needs, results, assumptions and settings."""
    from tvsysid.methods import CLOSED_LOOP, METHODS, describe
    from tvsysid.methods.registry import installed

    groups: dict[str, list[dict[str, str]]] = {}
    for key in (*METHODS, *CLOSED_LOOP, *installed()):
        method = describe(key)
        details = {
            "needs": "; ".join(method.needs),
            "reports": ", ".join(method.reports),
            "assumes": " ".join(method.assumptions),
            "settings": ", ".join(method.settings).replace(" = ", "="),
        }
        lines = [f"{name}: {text}" for name, text in details.items() if text]
        record = {"key": key, "about": "\n".join([method.title, *lines, ""])}
        groups.setdefault(method.purpose, []).append(record)
    for purpose, records in groups.items():
        show_table(f"For {purpose}", records, {"key": "key", "method": "about"})
    say(
        "Beside realizations of angle and torque. Durations are in s, frequencies in Hz. Settings "
        "follow the key: sds:window=0.2,max_lag=0.1\nA method of your own is module:Class or "
        "module:Class:setting=value; tvsysid check-method checks it."
    )
