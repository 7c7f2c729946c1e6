"""Bootstraps of an experiment: one method identifies draws from one recording."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import attrs
import numpy as np

from tvsysid.errors import InputError, printable
from tvsysid.methods import label_of
from tvsysid.preprocess import bootstrap_weights
from tvsysid.signals import Array, Ensemble
from tvsysid.study.dataset import EXPERIMENT, complete, dataset_of
from tvsysid.study.experiment import Experiment
from tvsysid.study.measure import STATISTICS, Scores, Truth, no_scores, stack
from tvsysid.study.prepared import Prepared, prepared_recordings
from tvsysid.study.tasks import Task, digests_of, pickled

if TYPE_CHECKING:
    import xarray as xr

STEPS = {"alignment": "alignment", "task": "task component", "residual": "residual"}
"""Steps that exclude realizations, by the ending of the variable that counts them."""
UNITS = {"target": "N m", "mean": "N m", "alignment": "N m/rad"}
"""Units of variables on the preparation, by the beginnings of their names."""


@attrs.frozen(kw_only=True)
class Bootstraps(Task):
    """Draws of some realizations from one recording, identified by the only method.

    Parameters
    ----------
    ensemble
        Realizations of the recording; None if there are none, for a ``reason``.
    pathways
        Noiseless torque of each pathway, if it is known.
    contiguous
        Whether the realizations of a draw follow each other.
    """

    ensemble: Ensemble | None
    pathways: Mapping[str, Array]
    realizations: int
    contiguous: bool
    bootstraps: int
    seed: int
    samples: int
    reason: str

    def scores(self) -> Scores:
        """Identify every draw; equal ones once, as a draw is a weight for each realization.

        Variables of :func:`measure` are over the draws. Seconds, warnings and failure are those of
        all draws together.
        """
        (label,) = self.methods
        ensemble = self.ensemble
        if ensemble is None:
            return self._failed(self.reason)
        try:
            weights = bootstrap_weights(
                len(ensemble), self.realizations, self.bootstraps, self.seed, self.contiguous
            )
        except InputError as error:
            return self._failed(str(error))
        distinct, place = np.unique(weights, axis=0, return_inverse=True)
        every = np.arange(len(ensemble))
        scored = [self._draw(label, ensemble, np.repeat(every, counts)) for counts in distinct]
        rows = [scored[number] for number in place.ravel()]
        failures = [str(row["failure"]) for row in rows if row["failure"]]
        every_failed = len(failures) == len(rows)
        return stack(rows) | {
            "seconds": np.nansum([row["seconds"] for row in scored]),
            "warnings": np.array("; ".join(self._warnings(len(ensemble), rows, failures))),
            "failure": np.array(
                f"every draw failed, the first: {failures[0]}" if every_failed else ""
            ),
        }

    def _failed(self, reason: str) -> Scores:
        nothing = {name: np.asarray(value) for name, value in no_scores(self.samples).items()}
        texts = {"warnings": np.array(""), "failure": np.array(printable(reason))}
        return stack([nothing] * self.bootstraps) | texts | {"seconds": np.array(np.nan)}

    def _draw(self, label: str, ensemble: Ensemble, chosen: np.ndarray) -> Scores:
        """Return the scores of one draw."""
        drawn = ensemble.select(chosen)
        pathways = {name: torque[chosen] for name, torque in self.pathways.items()}
        truth = Truth(np.asarray(drawn.torque[:, drawn.core]), pathways=pathways)
        return self.measure(label, drawn, truth)

    def _warnings(
        self, count: int, rows: Sequence[Scores], failures: Sequence[str]
    ) -> Iterator[str]:
        """Yield each warning once, whatever its numbers, with its count."""
        if self.realizations > count:
            yield (
                f"{self.realizations} realizations are drawn from {count}: they vary less than so "
                f"many recorded ones would; draw {count} at most"
            )
        if 0 < len(failures) < len(rows):
            yield f"{len(failures)} of {len(rows)} draws failed, the first: {failures[0]}"
        kinds: dict[str, list[str]] = {}
        for text in (text for row in rows for text in str(row["warnings"]).splitlines()):
            kinds.setdefault(re.sub(r"\d[\d.e+-]*", "#", text), []).append(text)
        yield from (f"{texts[0]} ({len(texts)} of {len(rows)} draws)" for texts in kinds.values())


class Recordings:
    """Tasks and results of an experiment."""

    def __init__(self, experiment: Experiment, prepared: Sequence[Prepared] | None) -> None:
        self._methods = {
            name: pickled(f"method {name}", method)
            for name, method in experiment.named_methods.items()
        }
        self._digests = digests_of(experiment.named_methods)
        self._experiment = experiment
        self._prepared = prepared_recordings(experiment) if prepared is None else prepared
        if [item.recorded for item in self._prepared] != list(experiment.recordings):
            given = ", ".join(item.recorded.label for item in self._prepared)
            raise InputError(
                f"run: the recordings prepared are not the experiment's: {given}; give what "
                "prepared_recordings(experiment) returns"
            )

    @property
    def tasks(self) -> dict[tuple[int, int], Task]:
        """Tasks by the places of recording and analysis; the last methods take longest."""
        analyses = list(enumerate(self._experiment.analyses))
        return {
            (place, number): self._task(item, number)
            for number, _ in reversed(analyses)
            for place, item in enumerate(self._prepared)
        }

    def _task(self, item: Prepared, number: int) -> Bootstraps:
        experiment, analysis = self._experiment, self._experiment.analyses[number]
        seed = experiment.seed_of(item.recorded, analysis.realizations)
        draws: dict[str, Any] = {
            "realizations": analysis.realizations,
            "contiguous": analysis.contiguous,
            "bootstraps": experiment.bootstraps,
            "seed": seed,
        }
        return Bootstraps(
            label=f"{analysis.label} of {item.recorded.label}",
            methods={analysis.name: self._methods[analysis.name]},
            settings={
                "recording": item.recorded.label,
                "data": item.digest,
                "method": label_of(analysis.method),
                "digest": self._digests.get(analysis.name),
                **draws,
            },
            ensemble=item.ensemble,
            pathways=item.pathways,
            samples=len(item.mean_torque),
            reason=item.failure,
            **draws,
        )

    def results(self, scores: Mapping[tuple[int, int], Scores]) -> xr.Dataset:
        """Return the results of all analyses, and what became of each recording."""
        experiment, preparing = self._experiment, self._experiment.preparation
        recordings, analyses = experiment.recordings, experiment.analyses
        results = dataset_of(
            {place: each | self._truth(place[0]) for place, each in scores.items()},
            {
                "recording": [each.label for each in recordings],
                "analysis": [each.label for each in analyses],
            },
            {"bootstrap": range(experiment.bootstraps)},
            {"statistic": list(STATISTICS)},
            period=preparing.period,
            rate=preparing.rate,
        )
        results = results.sel(statistic="mean", drop=True).assign_coords(
            participant=("recording", [each.participant for each in recordings]),
            perturbation=("recording", [each.perturbation for each in recordings]),
            method_key=("analysis", [each.name for each in analyses]),
            realizations=("analysis", [each.realizations for each in analyses]),
        )
        results = results.assign(truth=results.truth.isel(analysis=0, drop=True))
        rows = [_preparation_of(prepared) for prepared in self._prepared]
        for name in rows[0]:
            values = np.array([row[name] for row in rows])
            unit = UNITS.get(name.partition("_")[0])
            attributes = {"units": unit} if unit else {}
            results[name] = (("recording", "time")[: values.ndim], values, attributes)
        return complete(results, EXPERIMENT, experiment=experiment.to_json())

    def _truth(self, recording: int) -> Scores:
        prepared = self._prepared[recording]
        truth = np.zeros((0, len(prepared.mean_torque)))
        return {
            "known_quantity": np.array(list(prepared.truth), dtype=str),
            "truth": np.array(list(prepared.truth.values())) if prepared.truth else truth,
        }


def _preparation_of(prepared: Prepared) -> dict[str, Any]:
    """Return what became of a recording, by the names of variables."""
    table, ensemble = prepared.table, prepared.ensemble
    excluded = {} if table is None else dict(table.excluded_by.value_counts())
    effects = prepared.alignment._asdict()
    return {
        "recorded": 0 if table is None else len(table),
        "survivors": 0 if ensemble is None else len(ensemble),
        **{f"excluded_{name}": excluded.get(step, 0) for name, step in STEPS.items()},
        "trials": prepared.trials,
        "trials_left_out": len(prepared.refused),
        "remarks": "\n".join(prepared.remarks),
        "digest": prepared.digest,
        "target_torque": prepared.target_torque,
        "mean_torque": prepared.mean_torque,
        **{f"alignment_{name}": effect for name, effect in effects.items()},
    }
