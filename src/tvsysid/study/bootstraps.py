"""Cases of an experiment: recordings, of which each bootstrap is a draw."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from functools import partial
from typing import TYPE_CHECKING

import attrs
import numpy as np

from tvsysid.errors import InputError
from tvsysid.preprocess import bootstrap_weights
from tvsysid.signals import Ensemble
from tvsysid.study.dataset import EXPERIMENT, dataset_of, labelled
from tvsysid.study.experiment import Analysis, Experiment
from tvsysid.study.measure import Scores, Truth, stack
from tvsysid.study.prepared import Prepared
from tvsysid.study.tasks import Task

if TYPE_CHECKING:
    import xarray as xr

COUNTED = {
    "survivors": "",
    "excluded_alignment": "alignment",
    "excluded_task": "task component",
    "excluded_residual": "residual",
}
"""Steps that exclude realizations, or none, by the variable that counts them."""

RECORDED_OVER_TIME = "target_torque", "mean_torque", "truth quantity stiffness"


def draw(prepared: Prepared, analysis: Analysis, seed: int, number: int) -> tuple[Ensemble, Truth]:
    """Return the realizations of a bootstrap, and their recorded torque as the truth."""
    ensemble, is_block = prepared.ensemble, analysis.method.contiguous
    if ensemble is None:
        raise InputError(prepared.failure)
    count = len(ensemble)
    # A draw follows from the seed after all draws before it.
    weights = bootstrap_weights(count, analysis.realizations, number + 1, seed, is_block)
    chosen = np.repeat(np.arange(count), weights[number])
    drawn = ensemble.select(chosen)
    parts = {name: torque[chosen] for name, torque in prepared.pathways.items()}
    return drawn, Truth(np.asarray(drawn.torque[:, drawn.core]), pathways=parts)


def tasks_of(experiment: Experiment, prepared: Sequence[Prepared]) -> list[Task]:
    """Return a task for each analysis of a recording.

    The last methods take longest and come first.
    """
    tasks = []
    for analysis, item in itertools.product(reversed(experiment.analyses), prepared):
        seed, ensemble = experiment.seed_of(item.recorded, analysis.realizations), item.ensemble
        if ensemble and not analysis.method.uses_recorded_angle:
            ensemble = attrs.evolve(ensemble, recorded_angle=None)
        sent = attrs.evolve(item, ensemble=ensemble, preparation=None, excerpt=None)
        task = Task(
            case=item.recorded.label,
            draw=partial(draw, sent, analysis, seed),
            draws=range(experiment.bootstraps),
            methods={analysis.label: analysis.method},
            depends_on=(item.digest, seed),
        )
        tasks.append(task)
    return tasks


def results_of(
    experiment: Experiment, prepared: Sequence[Prepared], measured: Iterable[tuple[Task, Scores]]
) -> xr.Dataset:
    """Return the results of all analyses, and what became of each recording."""
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
    unknown = dict.fromkeys(RECORDED_OVER_TIME, np.full(results.sizes["time"], np.nan))
    facts = [{**unknown, **item.over_time, **_preparation_of(item)} for item in prepared]
    return results.merge(labelled(stack(facts), ["recording"]), join="left").transpose(
        "recording", "analysis", ...
    )


def _preparation_of(prepared: Prepared) -> Scores:
    """Return what became of a recording, by the names of variables."""
    preparation = prepared.preparation
    excluded_by = preparation.table.excluded_by.tolist() if preparation else []
    counts = {name: excluded_by.count(step) for name, step in COUNTED.items()}
    facts = {**counts, "recorded": len(excluded_by), "remarks": "\n".join(prepared.remarks)}
    return {name: np.array(value) for name, value in facts.items()}
