"""The unit of work: one method identifies bootstrap draws from one recording, and is scored."""

from __future__ import annotations

import re
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import cloudpickle
import numpy as np
from numpy.typing import NDArray

from tvsysid import metrics
from tvsysid.errors import InputError, describe_error
from tvsysid.preprocess import block_weights, bootstrap_weights
from tvsysid.signals import Ensemble
from tvsysid.study.task import Outcome, Task, identified, versions

Array = NDArray[np.float64]

NUMBERS = ("stiffness", "time_varying_vaf", "vaf", "bandpassed_vaf", "parameters")
"""Measured in each draw; the first two over time."""


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
    samples
        Of a realization.
    realizations, contiguous
        How many a draw has, and whether in one piece.
    bootstraps
        Number of draws.
    seed
        Of the draws.
    methods
        The one method, pickled, by its name.
    """

    label: str
    ensemble: Ensemble | None
    digest: str
    samples: int
    realizations: int
    contiguous: bool
    bootstraps: int
    seed: int
    methods: Mapping[str, bytes]
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
            Arrays of ``NUMBERS`` over (bootstrap, ...), with NaN where a draw failed; ``seconds``, ``doubts`` and
            ``failure`` of all together.
        """
        (name, pickled), *_ = self.methods.items()
        if name in self.left_out:
            return self.all_failed(self.left_out[name])
        if self.ensemble is None:
            return self.all_failed(self.reason)
        try:
            draw = block_weights if self.contiguous else bootstrap_weights
            weights = draw(len(self.ensemble), self.realizations, self.bootstraps, self.seed)
        except InputError as error:
            return self.all_failed(str(error))
        distinct, place = np.unique(weights, axis=0, return_inverse=True)
        found = [self._one(pickled, counts) for counts in distinct]
        rows = [found[number] for number in place.ravel()]
        numbers = {key: np.array([row[key] for row in rows], dtype=np.float64) for key in NUMBERS}
        return numbers | self._told([row["doubts"] for row in rows], [row["failure"] for row in rows], found)

    def all_failed(self, reason: str) -> Outcome:
        """Outcome where the method gave no result."""
        numbers = {key: np.full((self.bootstraps, *self._shape(key)), np.nan) for key in NUMBERS}
        return numbers | self._texts("", reason) | {"seconds": np.array(np.nan)}

    def _one(self, pickled: bytes, counts: NDArray[np.int64]) -> dict[str, Any]:
        """What one draw gives. A method that calls sys.exit() has failed like any other."""
        assert self.ensemble is not None
        drawn = self.ensemble.select(np.repeat(np.arange(len(counts)), counts))
        started = time.perf_counter()
        try:
            # Unpickled for each draw, so that nothing that it remembers passes from one to the next.
            model, doubts = identified(cloudpickle.loads(pickled), drawn)
            seconds = time.perf_counter() - started
            torque, predicted = drawn.torque[:, drawn.core], model.predict(drawn)
            return {
                "stiffness": model.stiffness,
                "time_varying_vaf": metrics.time_varying_vaf(torque, predicted),
                "vaf": _mean(metrics.vaf(torque, predicted)),
                "bandpassed_vaf": _mean(metrics.bandpassed_vaf(torque, predicted, drawn.sampling_rate)),
                "parameters": model.diagnostics.parameters,
                "seconds": seconds,
                "doubts": doubts,
                "failure": "",
            }
        except (Exception, SystemExit) as error:
            numbers = {key: np.full(self._shape(key), np.nan) for key in NUMBERS}
            return numbers | {"seconds": time.perf_counter() - started, "doubts": [], "failure": describe_error(error)}

    def _shape(self, key: str) -> tuple[int, ...]:
        return (self.samples,) if key in ("stiffness", "time_varying_vaf") else ()

    def _told(self, doubts: list[list[str]], failures: list[str], found: list[dict[str, Any]]) -> Outcome:
        """Each doubt once, whatever its numbers, with how often it was met; failure where no draw gave a result.

        Draws are the same each time: what failed in some will fail in them again, and is a doubt about the rest.
        """
        assert self.ensemble is not None
        count = len(self.ensemble)
        told = []
        if self.realizations > count:
            told.append(
                f"{self.realizations} realizations are drawn from {count}: they vary less than so many recorded ones "
                f"would; draw {count} at most"
            )
        failed = [text for text in failures if text]
        if 0 < len(failed) < len(failures):
            told.append(f"{len(failed)} of {len(failures)} draws failed, the first: {failed[0]}")
        kinds: dict[str, list[str]] = {}
        for text in (text for texts in doubts for text in dict.fromkeys(texts)):
            kinds.setdefault(re.sub(r"\d[\d.e+-]*", "#", text), []).append(text)
        told += [f"{texts[0]} ({len(texts)} of {len(doubts)} draws)" for texts in kinds.values()]
        failure = f"every draw failed, the first: {failed[0]}" if len(failed) == len(failures) else ""
        return self._texts("; ".join(told), failure) | {"seconds": np.array(sum(row["seconds"] for row in found))}

    def _texts(self, doubts: str, failure: str) -> Outcome:
        texts = {"doubts": doubts, "digest": self.digest, "failure": failure}
        return {name: np.array(text, dtype=np.dtypes.StringDType()) for name, text in texts.items()}


def _mean(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else np.nan
