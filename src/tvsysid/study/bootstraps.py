"""Cases of an experiment: recordings, of which each bootstrap is a draw."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from tvsysid.errors import InputError, one_line
from tvsysid.preprocess import bootstrap_weights
from tvsysid.signals import Array, Ensemble
from tvsysid.study.dataset import EXPERIMENT, dataset_of, labelled
from tvsysid.study.experiment import Analysis, Experiment
from tvsysid.study.measure import Scores, Truth, stack
from tvsysid.study.prepared import Prepared
from tvsysid.study.tasks import Task

if TYPE_CHECKING:
    import xarray as xr

STEPS = {"alignment": "alignment", "task": "task component", "residual": "residual"}
"""Steps that exclude realizations, by the ending of the variable that counts them."""


def draw(
    ensemble: Ensemble, pathways: Mapping[str, Array], analysis: Analysis, seed: int, number: int
) -> tuple[Ensemble, Truth]:
    """Return the realizations of a bootstrap; models are compared with their recorded torque.

    ``ensemble`` and ``pathways`` are all realizations, and the noiseless torque of each pathway, if
    it is known.
    """
    count, is_block = len(ensemble), analysis.method.contiguous
    weights = bootstrap_weights(count, analysis.realizations, number + 1, seed, is_block)
    chosen = np.repeat(np.arange(count), weights[number])
    drawn = ensemble.select(chosen)
    parts = {name: torque[chosen] for name, torque in pathways.items()}
    return drawn, Truth(np.asarray(drawn.torque[:, drawn.core]), pathways=parts)


def tasks_of(experiment: Experiment, prepared: Sequence[Prepared]) -> list[Task]:
    """Return a task for each analysis of a recording that can be used.

    The last methods take longest and come first.
    """
    tasks = []
    for analysis in reversed(experiment.analyses):
        for item in prepared:
            seed = experiment.seed_of(item.recorded, analysis.realizations)
            if item.ensemble is not None:
                task = Task(
                    case=item.recorded.label,
                    draw=partial(draw, item.ensemble, item.pathways, analysis, seed),
                    draws=range(experiment.bootstraps),
                    methods={analysis.label: analysis.method},
                    depends_on=(item.digest, seed),
                )
                tasks.append(task)
    if not tasks:
        raise InputError(f"run: no recording can be used: {prepared[0].failure}")
    return tasks


def results_of(
    experiment: Experiment, prepared: Sequence[Prepared], measured: Iterable[tuple[Task, Scores]]
) -> xr.Dataset:
    """Return the results of all analyses, and what became of each recording."""
    import xarray as xr  # noqa: PLC0415  # heavy

    recordings, analyses = [item.recorded for item in prepared], experiment.analyses
    coordinates = {
        "recording": ("recording", [each.label for each in recordings]),
        "bootstrap": ("bootstrap", range(experiment.bootstraps)),
        "analysis": ("analysis", [each.label for each in analyses]),
        "participant": ("recording", [each.participant for each in recordings]),
        "perturbation": ("recording", [each.perturbation for each in recordings]),
        "method_key": ("analysis", [each.name for each in analyses]),
        "realizations": ("analysis", [each.realizations for each in analyses]),
    }
    period, rate = experiment.preparation["period"], experiment.preparation["rate"]
    about = {"title": EXPERIMENT, "experiment": experiment.to_json()}
    results = dataset_of(measured, coordinates, period, rate, **about)
    facts = labelled(stack([_preparation_of(item) for item in prepared]), ["recording"])
    results = results.merge(facts, join="left")
    reasons = xr.DataArray([one_line(item.failure) for item in prepared], dims="recording")
    results["failure"] = results.failure.where(results.survivors > 0, reasons)
    return results.transpose("recording", "analysis", ...)


def _preparation_of(prepared: Prepared) -> Scores:
    """Return what became of a recording, by the names of variables."""
    preparation, ensemble = prepared.preparation, prepared.ensemble
    excluded_by = [] if preparation is None else preparation.table.excluded_by.tolist()
    counts = {
        "recorded": len(excluded_by),
        "survivors": 0 if ensemble is None else len(ensemble),
        **{f"excluded_{name}": excluded_by.count(step) for name, step in STEPS.items()},
        "remarks": "\n".join(prepared.remarks),
        "digest": prepared.digest,
        "target_torque": prepared.target_torque,
        "mean_torque": prepared.mean_torque,
        "truth quantity stiffness": np.full_like(prepared.mean_torque, np.nan),
        **{f"truth quantity {name}": values for name, values in prepared.truth.items()},
    }
    return {name: np.array(value) for name, value in counts.items()}
