"""Identify with the settings of the page. Steps whose settings do not change are kept."""

from __future__ import annotations

import warnings
from functools import lru_cache
from pathlib import Path
from threading import Lock

import attrs

from tvsysid.comparison import Comparison, PreparedRecording, compare, prepare
from tvsysid.errors import DataQualityWarning
from tvsysid.explorer.settings import Settings
from tvsysid.figures import drawn, identified_quantity

ONE_AT_A_TIME = Lock()  # warnings and the figures' style belong to all threads


@attrs.frozen(eq=False)
class Outcome:
    """Everything that the page shows of an identification."""

    settings: Settings
    prepared: PreparedRecording
    found: Comparison
    notes: tuple[str, ...]
    picture: bytes  # SVG


def forget() -> None:
    """Release the recordings and their results."""
    _identify.cache_clear()
    _prepare.cache_clear()


def outcome(settings: Settings, quantity: str = "stiffness", simultaneous: bool = False) -> Outcome:
    """Read, cut, identify, diagnose, and draw a quantity, as ``tvsysid identify`` does.

    Raises
    ------
    InputError
        For what ``tvsysid identify`` refuses.
    """
    source = settings.source
    changed = source.stat().st_mtime_ns if isinstance(source, Path) and source.exists() else 0
    prepared, found, notes = _identify(settings, changed)
    figure = identified_quantity(found.models, quantity, simultaneous=simultaneous)
    return Outcome(settings, prepared, found, notes, drawn(figure, "svg"))


@lru_cache(maxsize=16)
def _identify(
    settings: Settings, changed: int
) -> tuple[PreparedRecording, Comparison, tuple[str, ...]]:
    prepared, before = _prepare(attrs.evolve(settings, method=""), changed)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataQualityWarning)
        found = compare(prepared, settings.methods)
    return prepared, found, (*before, *dict.fromkeys(str(each.message) for each in caught))


@lru_cache(maxsize=8)
def _prepare(settings: Settings, changed: int) -> tuple[PreparedRecording, tuple[str, ...]]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataQualityWarning)
        prepared = prepare(settings.source, **settings.preparation)
    messages = (str(each.message) for each in caught)
    return prepared, tuple(dict.fromkeys((*map(str, prepared.corrections), *messages)))
