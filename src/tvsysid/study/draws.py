"""Task of an experiment: one method identifies bootstrap draws of one recording."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

import attrs
import numpy as np

from tvsysid.errors import InputError
from tvsysid.models import Model
from tvsysid.preprocess import bootstrap_weights
from tvsysid.signals import Ensemble
from tvsysid.study import task
from tvsysid.study.task import Known, Outcome, Row


@attrs.frozen(kw_only=True)
class DrawsTask(task.Task):
    """Draws of so many realizations from one recording, identified by the one method there is.

    The ensemble, of that ``digest``, is None where nothing could be prepared, for that
    ``reason``. Draws that are ``contiguous`` are in one piece.
    """

    ensemble: Ensemble | None
    pathways: Known
    scheduled: Mapping[str, int]
    digest: str
    realizations: int
    contiguous: bool
    bootstraps: int
    seed: int
    quantities: tuple[str, ...]
    reason: str

    def work(self) -> Outcome:
        """Identify every draw.

        Equal ones once, for a draw is no more than a weight on each realization.

        Gives arrays of ``shapes`` over (bootstrap, ...), with NaN where a draw failed;
        ``seconds``, ``warnings`` and ``failure`` of all together.
        """
        (name,) = self.methods
        ensemble = self.ensemble
        if ensemble is None:
            return self.all_failed(self.reason)
        try:
            weights = bootstrap_weights(
                len(ensemble), self.realizations, self.bootstraps, self.seed, self.contiguous
            )
        except InputError as error:
            return self.all_failed(str(error))
        distinct, place = np.unique(weights, axis=0, return_inverse=True)
        every = np.arange(len(ensemble))
        found = [self._row(name, ensemble, np.repeat(every, counts)) for counts in distinct]
        rows = [found[number] for number in place.ravel()]
        failures = [row["failure"] for row in rows if row["failure"]]
        failure = (
            f"every draw failed, the first: {failures[0]}" if len(failures) == len(rows) else ""
        )
        warned = "; ".join(self._warnings(len(ensemble), rows, failures))
        return self._outcome(rows, warned, failure, sum(row["spent"] for row in found))

    def all_failed(self, reason: str) -> Outcome:
        """Return the outcome of a method without a result."""
        return self._outcome([task.failed(reason)] * self.bootstraps, "", reason, np.nan)

    def _row(self, name: str, ensemble: Ensemble, chosen: np.ndarray) -> Row:
        """Return the results of one draw; VAFs are means over its realizations."""
        drawn = ensemble.select(chosen)

        def measure(model: Model) -> Row:
            own = model.pathways(drawn)
            known = {
                name: None if torque is None else torque[chosen]
                for name, torque in self.pathways.items()
            }
            found = task.explained(
                drawn.torque[:, drawn.core], np.asarray(sum(own.values())), drawn.sampling_rate
            )
            found |= task.of_pathways(own, known)
            found |= {
                name: found[name][..., 0]
                for name in ("vaf", "bandpassed_vaf", "pathway_vaf")
                if name in found
            }
            found |= {"estimate": task.over_time(model, self.quantities)}
            return found | task.over_schedule(model, self.scheduled)

        return self.attempt(name, drawn, measure)

    def _warnings(self, count: int, rows: list[Row], failures: list[str]) -> Iterator[str]:
        """Yield each warning once, whatever its numbers, with its count.

        Draws are the same each time: what failed in some will fail in them again, and is a
        warning about the rest.
        """
        if self.realizations > count:
            yield (
                f"{self.realizations} realizations are drawn from {count}: they vary less than so "
                "many recorded ones "
                f"would; draw {count} at most"
            )
        if 0 < len(failures) < len(rows):
            yield f"{len(failures)} of {len(rows)} draws failed, the first: {failures[0]}"
        kinds: dict[str, list[str]] = {}
        for text in (text for row in rows for text in dict.fromkeys(row["warnings"])):
            kinds.setdefault(re.sub(r"\d[\d.e+-]*", "#", text), []).append(text)
        yield from (f"{texts[0]} ({len(texts)} of {len(rows)} draws)" for texts in kinds.values())

    def _outcome(self, rows: list[Row], warned: str, failure: str, seconds: float) -> Outcome:
        texts = {"warnings": warned, "digest": self.digest, "failure": failure}
        stored = {name: task.as_text(text) for name, text in texts.items()}
        return task.stacked(rows, self.shapes) | stored | {"seconds": np.array(seconds)}
