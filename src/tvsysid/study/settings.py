"""The file that says what is studied."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from tvsysid.errors import InputError


def settings_in(path: str | Path) -> dict[str, Any]:
    """Settings that stand in a TOML file, by their keys.

    Raises
    ------
    InputError
        For a file that is missing or no TOML.
    """
    try:
        with Path(path).open("rb") as file:
            return tomllib.load(file)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a TOML file: {error}") from error
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; give a TOML file") from error


def overridden(settings: dict[str, Any], others: dict[str, Any]) -> dict[str, Any]:
    """Settings with others in their place; further scenarios follow where they are of the kind expected."""
    merged = settings | others
    further = merged.get("also", ())
    if "also" not in others and isinstance(further, (list, tuple)) and all(isinstance(item, dict) for item in further):
        kept = [{name: value for name, value in item.items() if name not in others} for item in further]
        merged["also"] = [item for item in kept if item]
    return merged
