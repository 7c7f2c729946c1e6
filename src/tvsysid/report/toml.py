"""Settings as TOML text, which the standard library reads but does not write."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any


def toml_text(settings: Mapping[str, Any]) -> str:
    """Settings as TOML; those that are None are left out, for TOML has no word for them.

    Parameters
    ----------
    settings
        Texts, numbers, truth values, lists of them, and mappings of such settings.

    Examples
    --------
    >>> print(toml_text({"trials": 20, "snr_db": [10.0, float("inf")], "options": {"name": "a"}}))
    trials = 20
    snr_db = [10.0, inf]
    <BLANKLINE>
    [options]
    name = "a"
    """
    return "\n".join(_lines(settings, ""))


def _lines(settings: Mapping[str, Any], prefix: str) -> list[str]:
    lines = [f"{_key(key)} = {_value(value)}" for key, value in settings.items() if _is_plain(value)]
    for key, value in settings.items():
        if isinstance(value, Mapping):
            name = f"{prefix}{_key(key)}"
            lines += ["", f"[{name}]", *_lines(value, f"{name}.")]
    return lines


def _is_plain(value: Any) -> bool:
    return value is not None and not isinstance(value, Mapping)


def _key(key: str) -> str:
    return key if key.replace("_", "").replace("-", "").isalnum() and key.isascii() else _text(key)


def _text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return f"[{', '.join(_value(item) for item in value if item is not None)}]"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(key)} = {_value(item)}" for key, item in value.items()) + "}"
    return _text(value) if isinstance(value, str) else repr(value)
