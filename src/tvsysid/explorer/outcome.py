"""From settings to what is shown of them.

What does not change is kept from one change to the next.
"""

from __future__ import annotations

import asyncio
import warnings
from collections.abc import Callable
from functools import cached_property, lru_cache
from threading import Lock
from typing import TypeVar

import attrs

from tvsysid.comparison import Comparison, PreparedRecording, compare, prepare_recording
from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.explorer.settings import Cutting, Settings, SourceFile, command, python
from tvsysid.figures import drawn, identified_quantity
from tvsysid.methods import centered_channels, parse
from tvsysid.quality import Diagnosis, diagnose
from tvsysid.report.answer import Account, answer
from tvsysid.signals import Recording

T = TypeVar("T")
TURN_S = 0.02  # between two looks whether it is one's turn
Noted = tuple[T, tuple[str, ...]]  # what a step made, and what it warned of
ONE_AT_A_TIME = Lock()  # warnings and the figures' look are those of all threads


@attrs.frozen(eq=False)
class Outcome:
    """What was found with some settings, and the package's warnings."""

    settings: Settings
    cut: PreparedRecording
    found: Comparison
    notes: tuple[str, ...]

    @property
    def lines(self) -> list[str]:
        """The answer in words, as ``tvsysid identify`` prints it; takes a while."""
        with ONE_AT_A_TIME:
            return answer(Account(self.found))

    @property
    def command(self) -> str:
        """The same on the command line."""
        return command(self.settings)

    @property
    def python(self) -> str:
        """The same in Python."""
        delay = float(self.cut.ensemble.delay_removed)
        return python(self.settings, delay, self.cut.mains, self.cut.deviating)

    @cached_property
    def diagnosis(self) -> Diagnosis | str:
        """What may be wrong with the ensemble, or why nobody can say; takes a while."""
        with ONE_AT_A_TIME:
            try:
                return self.found.recommendation.diagnosis or diagnose(self.found.ensemble)
            except InputError as error:
                return str(error)

    def picture(self, quantity: str = "stiffness", simultaneous: bool = False) -> bytes:
        """Return a quantity over time with its band, as SVG."""
        with ONE_AT_A_TIME:
            return drawn(
                identified_quantity(self.found.models, quantity, simultaneous=simultaneous), "svg"
            )


async def in_turn(work: Callable[..., T], *given: object) -> T:
    """What some work returns, in a thread of its own, when nothing else is at work.

    Not begun if cancelled before.
    """
    while ONE_AT_A_TIME.locked():
        await asyncio.sleep(TURN_S)
    return await asyncio.to_thread(work, *given)


def forget() -> None:
    """Let go of the recordings and what was found in them."""
    for kept in (_found, _cut, _read):
        kept.cache_clear()


def outcome(settings: Settings) -> Outcome:
    """Read, cut and identify, as ``tvsysid identify`` does.

    Raises
    ------
    InputError
        For what ``tvsysid identify`` refuses.
    """
    source, file = settings.source, getattr(settings.source, "file", None)
    with ONE_AT_A_TIME:
        changed = file.stat().st_mtime_ns if file is not None and file.exists() else 0
        (cut, found), notes = _found(source, changed, settings.cutting, settings.method)
    return Outcome(settings, cut, found, notes)


@lru_cache(maxsize=16)
def _found(
    source: SourceFile | Recording, changed: int, how: Cutting, method: str
) -> Noted[tuple[PreparedRecording, Comparison]]:
    cut, before = _cut(source, changed, how, tuple(centered_channels([parse(method)])))
    found, notes = _noted(lambda: compare(cut.ensemble, [method]))
    return (cut, found), (*before, *notes)


@lru_cache(maxsize=8)
def _cut(
    source: SourceFile | Recording, changed: int, how: Cutting, deviating: tuple[str, ...]
) -> Noted[PreparedRecording]:
    recording, before = (source, ()) if isinstance(source, Recording) else _read(source, changed)
    prepared, notes = _noted(
        lambda: prepare_recording(recording, how, deviating, align_channels=how.align_channels)
    )
    return prepared, (*before, *prepared.notes, *notes)


@lru_cache(maxsize=4)
def _read(source: SourceFile, changed: int) -> Noted[Recording]:
    return _noted(lambda: source.reading.read(source.file))


def _noted(work: Callable[[], T]) -> Noted[T]:
    """Return the result of a function and its warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataQualityWarning)
        made = work()
    return made, tuple(dict.fromkeys(str(each.message) for each in caught))
