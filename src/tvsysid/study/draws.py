"""The unit of work of an experiment: one method identifies bootstrap draws from one recording, and is scored."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from tvsysid.errors import InputError
from tvsysid.models import Model
from tvsysid.preprocess import block_weights, bootstrap_weights
from tvsysid.signals import Ensemble
from tvsysid.study.task import (
    Outcome,
    Row,
    Shapes,
    Task,
    as_text,
    attempt,
    explained,
    failed,
    over_time,
    stacked,
    versions,
)


@dataclass(frozen=True)
class DrawsTask(Task):
    """Draws from one recording, identified by one method.

    Parameters
    ----------
    label
        What is identified, for messages.
    ensemble
        To draw from; None where nothing could be prepared.
    digest
        Of the ensemble.
    realizations, contiguous
        How many a draw has, and whether in one piece.
    bootstraps
        Number of draws.
    seed
        Of the draws.
    quantities
        Whose estimates are measured.
    methods
        The one method, pickled, by its name.
    shapes, versions, left_out
        As of :class:`Task`.
    reason
        Why nothing could be prepared.
    """

    label: str
    ensemble: Ensemble | None
    digest: str
    realizations: int
    contiguous: bool
    bootstraps: int
    seed: int
    quantities: tuple[str, ...]
    methods: Mapping[str, bytes]
    shapes: Shapes
    reason: str = ""
    versions: Mapping[str, str] = field(default_factory=versions)
    left_out: Mapping[str, str] = field(default_factory=dict)

    def __str__(self) -> str:
        return self.label

    def work(self) -> Outcome:
        """Identify every draw.

        Draws of the same realizations are identified once: a draw is no more than a weight on each realization.

        Returns
        -------
        dict
            Arrays of ``shapes`` over (bootstrap, ...), with NaN where a draw failed; ``seconds``, ``warnings`` and
            ``failure`` of all together.
        """
        (name, method), *_ = self.methods.items()
        ensemble = self.ensemble
        if name in self.left_out:
            return self.all_failed(self.left_out[name])
        if ensemble is None:
            return self.all_failed(self.reason)
        try:
            draw = block_weights if self.contiguous else bootstrap_weights
            weights = draw(len(ensemble), self.realizations, self.bootstraps, self.seed)
        except InputError as error:
            return self.all_failed(str(error))
        distinct, place = np.unique(weights, axis=0, return_inverse=True)
        every = np.arange(len(ensemble))
        found = [self._row(method, ensemble.select(np.repeat(every, counts))) for counts in distinct]
        rows = [found[number] for number in place.ravel()]
        failures = [row["failure"] for row in rows if row["failure"]]
        failure = f"every draw failed, the first: {failures[0]}" if len(failures) == len(rows) else ""
        return self._outcome(
            rows, "; ".join(self._warnings(rows, failures)), failure, sum(row["spent"] for row in found)
        )

    def all_failed(self, reason: str) -> Outcome:
        """Outcome where the method gave no result."""
        return self._outcome([failed(reason)] * self.bootstraps, "", reason, np.nan)

    def _row(self, method: bytes, drawn: Ensemble) -> Row:
        """What one draw gives; VAFs are means over its realizations."""

        def measure(model: Model) -> Row:
            found = explained(drawn.torque[:, drawn.core], model.predict(drawn), drawn.sampling_rate)
            found |= {name: found[name][0] for name in ("vaf", "bandpassed_vaf")}
            return found | {"estimate": over_time(model, self.quantities)}

        return attempt(method, drawn, measure)

    def _warnings(self, rows: list[Row], failures: list[str]) -> Iterator[str]:
        """Each warning once, whatever its numbers, with how often it was met.

        Draws are the same each time: what failed in some will fail in them again, and is a warning about the rest.
        """
        assert self.ensemble is not None
        count = len(self.ensemble)
        if self.realizations > count:
            yield (
                f"{self.realizations} realizations are drawn from {count}: they vary less than so many recorded ones "
                f"would; draw {count} at most"
            )
        if 0 < len(failures) < len(rows):
            yield f"{len(failures)} of {len(rows)} draws failed, the first: {failures[0]}"
        kinds: dict[str, list[str]] = {}
        for text in (text for row in rows for text in dict.fromkeys(row["warnings"])):
            kinds.setdefault(re.sub(r"\d[\d.e+-]*", "#", text), []).append(text)
        yield from (f"{texts[0]} ({len(texts)} of {len(rows)} draws)" for texts in kinds.values())

    def _outcome(self, rows: list[Row], warned: str, failure: str, seconds: float) -> Outcome:
        texts = {"warnings": as_text(warned), "digest": as_text(self.digest), "failure": as_text(failure)}
        return stacked(rows, self.shapes) | texts | {"seconds": np.array(seconds)}
