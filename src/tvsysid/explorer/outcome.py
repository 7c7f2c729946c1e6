"""Identify with the settings of the page. Steps whose settings do not change are kept."""

from __future__ import annotations

import asyncio
import warnings
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import TypeVar

import attrs

from tvsysid.comparison import Comparison, PreparedRecording, compare, prepare_recording
from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.explorer.settings import Settings
from tvsysid.figures import drawn, identified_quantity
from tvsysid.methods import centered_channels, parse
from tvsysid.quality import Diagnosis, diagnose
from tvsysid.recordings import Reading, Segmentation, read_recording
from tvsysid.report.answer import Account, answer
from tvsysid.signals import Recording

T = TypeVar("T")
POLL_S = 0.02
Warned = tuple[T, tuple[str, ...]]  # the result of a step, and its warnings
ONE_AT_A_TIME = Lock()  # warnings and the figures' style belong to all threads


@attrs.frozen(eq=False)
class Outcome:
    """Everything that the page shows of an identification."""

    settings: Settings
    prepared: PreparedRecording
    found: Comparison
    notes: tuple[str, ...]
    lines: list[str]  # the answer, as ``tvsysid identify`` prints it
    diagnosis: Diagnosis | str  # or why there is none
    picture: bytes  # SVG


async def in_turn(work: Callable[..., T], *given: object) -> T:
    """Return the result of a function that runs in a thread when no other does.

    It does not start if it is cancelled before its turn.
    """
    while ONE_AT_A_TIME.locked():
        await asyncio.sleep(POLL_S)
    return await asyncio.to_thread(work, *given)


def forget() -> None:
    """Release the recordings and their results."""
    for kept in (_found, _prepared, _read):
        kept.cache_clear()


def outcome(settings: Settings, quantity: str = "stiffness", simultaneous: bool = False) -> Outcome:
    """Read, cut, identify, diagnose, and draw a quantity, as ``tvsysid identify`` does.

    Raises
    ------
    InputError
        For what ``tvsysid identify`` refuses.
    """
    source = settings.source
    with ONE_AT_A_TIME:
        changed = source.stat().st_mtime_ns if isinstance(source, Path) and source.exists() else 0
        (prepared, found), notes = _found(settings, changed)
        try:
            diagnosis: Diagnosis | str = found.recommendation.diagnosis or diagnose(found.ensemble)
        except InputError as error:
            diagnosis = str(error)
        figure = identified_quantity(found.models, quantity, simultaneous=simultaneous)
        lines = answer(Account(found))
        return Outcome(settings, prepared, found, notes, lines, diagnosis, drawn(figure, "svg"))


@lru_cache(maxsize=16)
def _found(settings: Settings, changed: int) -> Warned[tuple[PreparedRecording, Comparison]]:
    prepared, before = _prepared(
        settings.source,
        changed,
        settings.reading,
        settings.cutting,
        settings.align_channels,
        tuple(centered_channels([parse(settings.method)])),
    )
    found, notes = _warned(lambda: compare(prepared.ensemble, [settings.method]))
    return (prepared, found), (*before, *notes)


@lru_cache(maxsize=8)
def _prepared(
    source: Path | Recording,
    changed: int,
    reading: Reading,
    cutting: Segmentation,
    align_channels: bool,
    centered: tuple[str, ...],
) -> Warned[PreparedRecording]:
    recording, before = (
        _read(source, changed, reading) if isinstance(source, Path) else (source, ())
    )
    prepared, notes = _warned(
        lambda: prepare_recording(recording, cutting, centered, align_channels=align_channels)
    )
    return prepared, (*before, *prepared.notes, *notes)


@lru_cache(maxsize=4)
def _read(source: Path, changed: int, reading: Reading) -> Warned[Recording]:
    return _warned(lambda: read_recording(source, reading))


def _warned(work: Callable[[], T]) -> Warned[T]:
    """Return the result of a function and its warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataQualityWarning)
        made = work()
    return made, tuple(dict.fromkeys(str(each.message) for each in caught))
