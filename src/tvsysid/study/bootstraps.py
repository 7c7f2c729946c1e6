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
from tvsysid.study.prepared import Prepared
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
    ensemble, data
        Realizations of the recording, and their digest.
    pathways
        Noiseless torque of each pathway, if it is known.
    realizations, contiguous
        Number of realizations in a draw, and whether they follow each other.
    bootstraps, seed
        Number of draws, and their random seed.
    """

    ensemble: Ensemble = attrs.field(repr=False)
    data: str
    pathways: Mapping[str, Array] = attrs.field(repr=False)
    realizations: int
    contiguous: bool
    bootstraps: int
    seed: int

    def scores(self) -> Scores:
        """Identify every draw; equal ones once, as a draw is a weight for each realization.

        Variables of :func:`measure` are over the draws. Seconds, warnings and failure are those of
        all draws together.
        """
        (label,), count = self.methods, len(self.ensemble)
        try:
            weights = bootstrap_weights(
                count, self.realizations, self.bootstraps, self.seed, self.contiguous
            )
            distinct, place = np.unique(weights, axis=0, return_inverse=True)
            scored = [self._draw(label, np.repeat(np.arange(count), each)) for each in distinct]
        except InputError as error:  # a block that is longer than the recording
            scored = [no_scores(self.ensemble.samples, failure=printable(str(error)))]
            place = np.zeros(self.bootstraps, dtype=int)
        rows = [scored[number] for number in place.ravel()]
        failures = [str(row["failure"]) for row in rows if row["failure"]]
        whole = f"every draw failed, the first: {failures[0]}" if len(failures) == len(rows) else ""
        return stack(rows) | {
            "seconds": np.nansum([row["seconds"] for row in scored]),
            "warnings": np.array("; ".join(self._warnings(rows, failures))),
            "failure": np.array(whole),
        }

    def _draw(self, label: str, chosen: np.ndarray) -> Scores:
        """Return the scores of one draw."""
        drawn = self.ensemble.select(chosen)
        pathways = {name: torque[chosen] for name, torque in self.pathways.items()}
        truth = Truth(np.asarray(drawn.torque[:, drawn.core]), pathways=pathways)
        return self.measure(label, drawn, truth)

    def _warnings(self, rows: Sequence[Scores], failures: Sequence[str]) -> Iterator[str]:
        """Yield each warning once, whatever its numbers, with its count."""
        if self.realizations > (count := len(self.ensemble)):
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


def bootstraps_of(
    experiment: Experiment, prepared: Sequence[Prepared]
) -> dict[tuple[int, int], Bootstraps]:
    """Return the tasks of the usable recordings, by the places of recording and analysis.

    The last methods take longest and come first.
    """
    if [item.recorded for item in prepared] != list(experiment.recordings):
        given = ", ".join(item.recorded.label for item in prepared)
        raise InputError(
            f"run: the recordings prepared are not the experiment's: {given}; give what "
            "prepared_recordings(experiment) returns"
        )
    named, tasks = experiment.named_methods, {}
    methods = {name: pickled(f"method {name}", method) for name, method in named.items()}
    digests = digests_of(named)
    for number, analysis in reversed(list(enumerate(experiment.analyses))):
        for place, item in enumerate(prepared):
            if item.ensemble is not None:
                tasks[place, number] = Bootstraps(
                    label=f"{analysis.label} of {item.recorded.label}",
                    digests={label_of(analysis.method): digests[analysis.name]},
                    methods={analysis.name: methods[analysis.name]},
                    ensemble=item.ensemble,
                    data=item.digest,
                    pathways=item.pathways,
                    realizations=analysis.realizations,
                    contiguous=analysis.contiguous,
                    bootstraps=experiment.bootstraps,
                    seed=experiment.seed_of(item.recorded, analysis.realizations),
                )
    return tasks


def results_of_bootstraps(
    experiment: Experiment,
    prepared: Sequence[Prepared],
    scores: Mapping[tuple[int, int], Scores],
) -> xr.Dataset:
    """Return the results of all analyses, and what became of each recording."""
    recordings, analyses = experiment.recordings, experiment.analyses
    preparing, every = experiment.preparation, []
    for place, number in np.ndindex(len(recordings), len(analyses)):
        item = prepared[place]
        known = {"stiffness": np.nan * item.mean_torque} | dict(item.truth)
        truth = {f"truth/{name}": values for name, values in known.items()}
        failed = {"failure": np.array(printable(item.failure))}
        every.append(scores.get((place, number), failed) | truth)
    results = dataset_of(
        every,
        {
            "recording": [each.label for each in recordings],
            "analysis": [each.label for each in analyses],
        },
        {"bootstrap": range(experiment.bootstraps)},
        {"statistic": STATISTICS},
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
    rows = [_preparation_of(item) for item in prepared]
    for name in rows[0]:
        values = np.array([row[name] for row in rows])
        unit = UNITS.get(name.partition("_")[0])
        results[name] = (
            ("recording", "time")[: values.ndim],
            values,
            {"units": unit} if unit else {},
        )
    return complete(results, EXPERIMENT, experiment=experiment.to_json())


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
