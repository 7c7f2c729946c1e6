"""Cases of an experiment: recordings, of which each bootstrap is a draw."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tvsysid.errors import InputError, printable
from tvsysid.preprocess import bootstrap_weights
from tvsysid.signals import Array, Ensemble
from tvsysid.study.dataset import EXPERIMENT, dataset_of
from tvsysid.study.experiment import Experiment
from tvsysid.study.measure import AXES, Scores, Truth, at, over
from tvsysid.study.prepared import Prepared
from tvsysid.study.tasks import Task

if TYPE_CHECKING:
    import xarray as xr

STEPS = {"alignment": "alignment", "task": "task component", "residual": "residual"}
"""Steps that exclude realizations, by the ending of the variable that counts them."""


def draw(
    ensemble: Ensemble, pathways: Mapping[str, Array], weights: NDArray[np.int64], number: int
) -> tuple[Ensemble, Truth]:
    """Return the realizations of a bootstrap; models are compared with their recorded torque.

    Parameters
    ----------
    ensemble, pathways
        All realizations, and the noiseless torque of each pathway, if it is known.
    weights
        How often each realization is in each draw, shape (draw, realization).
    """
    chosen = np.repeat(np.arange(len(ensemble)), weights[number])
    drawn = ensemble.select(chosen)
    parts = {name: torque[chosen] for name, torque in pathways.items()}
    return drawn, Truth(np.asarray(drawn.torque[:, drawn.core]), pathways=parts)


def tasks_of(
    experiment: Experiment, prepared: Sequence[Prepared]
) -> tuple[list[Task], list[Scores]]:
    """Return a task for each recording and analysis, and the failures of those that cannot be done.

    The last methods take longest and come first.
    """
    if [item.recorded for item in prepared] != list(experiment.recordings):
        raise InputError(
            "run: the recordings prepared are not the experiment's; give what "
            "prepared_recordings(experiment) returns"
        )
    tasks: list[Task] = []
    failed: list[Scores] = []
    draws = range(experiment.bootstraps)
    for analysis in reversed(experiment.analyses):
        for item in prepared:
            label, size = item.recorded.label, analysis.realizations
            try:
                if item.ensemble is None:
                    raise InputError(item.failure)
                seed = experiment.seed_of(item.recorded, size)
                weights = bootstrap_weights(
                    len(item.ensemble), size, len(draws), seed, analysis.method.contiguous
                )
            except InputError as error:
                text, place = over(failure=printable(str(error))), {"analysis": analysis.label}
                failed += [at(text, recording=label, bootstrap=each, **place) for each in draws]
                continue
            task = Task(
                axes=AXES[1],
                case=label,
                draw=partial(draw, item.ensemble, item.pathways, weights),
                draws=draws,
                methods={analysis.label: analysis.method},
                depends_on=(item.digest, weights.tobytes()),
            )
            tasks.append(task)
    return tasks, failed


def results_of(
    experiment: Experiment, prepared: Sequence[Prepared], scores: Iterable[Scores]
) -> xr.Dataset:
    """Return the results of all analyses, and what became of each recording."""
    recordings, analyses = experiment.recordings, experiment.analyses
    coordinates = {
        "recording": ("recording", [each.label for each in recordings]),
        "participant": ("recording", [each.participant for each in recordings]),
        "perturbation": ("recording", [each.perturbation for each in recordings]),
        "bootstrap": ("bootstrap", range(experiment.bootstraps)),
        "analysis": ("analysis", [each.label for each in analyses]),
        "method_key": ("analysis", [each.name for each in analyses]),
        "realizations": ("analysis", [each.realizations for each in analyses]),
    }
    truths = [
        at(over("time", truth=values), recording=item.recorded.label, quantity=name)
        for item in prepared
        for name, values in {"stiffness": np.nan * item.mean_torque, **item.truth}.items()
    ]
    period, rate = experiment.preparation["period"], experiment.preparation["rate"]
    about = {"title": EXPERIMENT, "experiment": experiment.to_json()}
    results = dataset_of([*scores, *truths], coordinates, period, rate, **about)
    results = results.sel(statistic="mean", drop=True).transpose("recording", "analysis", ...)
    facts = [_preparation_of(item) for item in prepared]
    for name in facts[0]:
        values = np.array([each[name] for each in facts])
        results[name] = ("recording", "time")[: values.ndim], values
    return results


def _preparation_of(prepared: Prepared) -> dict[str, Any]:
    """Return what became of a recording, by the names of variables."""
    preparation, ensemble = prepared.preparation, prepared.ensemble
    excluded_by = [] if preparation is None else preparation.table.excluded_by.tolist()
    return {
        "recorded": len(excluded_by),
        "survivors": 0 if ensemble is None else len(ensemble),
        **{f"excluded_{name}": excluded_by.count(step) for name, step in STEPS.items()},
        "trials": prepared.trials,
        "trials_left_out": len(prepared.refused),
        "remarks": "\n".join(prepared.remarks),
        "digest": prepared.digest,
        "target_torque": prepared.target_torque,
        "mean_torque": prepared.mean_torque,
    }
