"""Prepare the recordings of an experiment, which are its cases, and draw bootstraps of each."""

from __future__ import annotations

import glob
import hashlib
import itertools
import os
import pickle
import warnings
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

import attrs
import numpy as np

from tvsysid.comparison import correct
from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.methods import centered_channels
from tvsysid.numerics.threads import single_thread
from tvsysid.preprocess import (
    Preparation,
    bootstrap_weights,
    excerpt,
    find_gaps,
    prepare_experiment,
)
from tvsysid.progress import Progress, no_progress
from tvsysid.recordings import read_usable_trials
from tvsysid.signals import Array, Ensemble, Recording
from tvsysid.simulate import PERTURBATIONS, Participant, Simulation
from tvsysid.study.dataset import dataset_of, labelled
from tvsysid.study.experiment import Analysis, Experiment, Recorded
from tvsysid.study.measure import Scores, Truth, mean_quantities
from tvsysid.study.tasks import Task

if TYPE_CHECKING:
    import xarray as xr

COUNTED = {
    "survivors": "",
    "excluded_alignment": "alignment",
    "excluded_task": "task component",
    "excluded_residual": "residual",
}
"""By variable that counts realizations, the step that excluded them; empty if they are kept."""

RECORDED_OVER_TIME = "target_torque", "mean_torque", "truth quantity stiffness"


@attrs.frozen(eq=False, kw_only=True)
class Prepared:
    """One recording, ready for identification.

    Parameters
    ----------
    recorded
        The participant and perturbation.
    remarks, failure
        Texts on trials that are left out, and warnings. If nothing could be prepared, ``failure``
        says why, and is the last of the remarks. Otherwise it is empty.
    preparation, excerpt
        Steps of the preparation, and ten seconds of the recording for a figure; None if nothing
        could be prepared.
    ensemble
        Kept realizations, mean subtracted; None if there are none.
    over_time
        Means over the kept realizations, each of shape (time,): ``target_torque`` and
        ``mean_torque`` in N·m, and quantities of a simulation (``"truth quantity stiffness"``).
    """

    recorded: Recorded
    remarks: tuple[str, ...] = ()
    failure: str = ""
    preparation: Preparation | None = None
    excerpt: Recording | None = None
    ensemble: Ensemble | None = None
    over_time: Mapping[str, Array] = attrs.field(factory=dict)

    @cached_property
    def digest(self) -> str:
        """Hash of the ensemble, or of why there is none."""
        return hashlib.sha256(pickle.dumps(self.ensemble or self.failure)).hexdigest()[:16]


def prepared_recordings(
    experiment: Experiment, progress: Progress = no_progress
) -> tuple[Prepared, ...]:
    """Prepare every recording of an experiment. One that cannot be used does not stop the others.

    Parameters
    ----------
    progress
        Called with the numbers of finished recordings and of all.
    """
    prepared: list[Prepared] = []
    for recorded in experiment.recordings:
        progress(len(prepared), len(experiment.recordings))
        with single_thread():  # so that the same recordings have the same digest everywhere
            prepared.append(_prepare(experiment, recorded))
    return tuple(prepared)


def _prepare(experiment: Experiment, recorded: Recorded) -> Prepared:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataQualityWarning)
        try:
            if isinstance(source := recorded.source, int):
                perturbation = PERTURBATIONS[recorded.perturbation]
                simulation = Participant(source).simulate(perturbation=perturbation)
            else:  # the truth of a person is unknown
                simulation = Simulation(_read(experiment, source), truth={}, pathways={})
            prepared = _prepare_recording(experiment, recorded, simulation)
        except InputError as error:
            prepared = Prepared(recorded=recorded, failure=str(error))
    texts = *(str(each.message) for each in caught), prepared.failure
    return attrs.evolve(prepared, remarks=tuple(dict.fromkeys(filter(None, texts))))


def _read(experiment: Experiment, patterns: Iterable[str]) -> Recording:
    """Return all usable trials. Warn of trials that cannot be used.

    Raise an InputError if there is none.
    """
    reading, settings = experiment.reading, experiment.preparation
    assert reading is not None
    files = {
        str(Path(name)): Path(experiment.folder, name)
        for pattern in map(os.path.expanduser, patterns)
        for name in sorted(glob.glob(pattern, root_dir=experiment.folder)) or [pattern]
    }
    channels, target = reading.channels, settings["reference"]
    if target:
        channels = {target: target, **channels}
    shortest = 2 * settings["ends"] + settings["period"]
    return read_usable_trials(files, attrs.evolve(reading, channels=channels), shortest)


def _prepare_recording(
    experiment: Experiment, recorded: Recorded, simulation: Simulation
) -> Prepared:
    """Correct and prepare a recording for all analyses.

    The truth of a simulation goes to ``over_time``.
    """
    recording, settings = simulation.recording, experiment.preparation
    needed = centered_channels([each.method for each in experiment.analyses])
    centered = [name for name in needed if name in recording.channels]
    gaps = find_gaps(recording)

    def prepare(recording: Recording) -> Preparation:
        return prepare_experiment(recording, **settings, channels=centered, gaps=gaps)

    if not isinstance(recorded.source, int):  # virtual participants have no such faults
        recording, corrections = correct(recording, lambda each: prepare(each).ensemble)
        for each in corrections:
            warnings.warn(str(each), DataQualityWarning, stacklevel=2)
    preparation = prepare(recording)
    # The ensemble after the last step, or the recorded one if there was no step
    *_, kept = preparation.recorded, *(step.ensemble for step in preparation.steps.values())
    means = {"mean_torque": "torque", "target_torque": settings["reference"]}
    over_time = {
        variable: kept.signal(name)[:, kept.core].mean(axis=0)
        for variable, name in means.items()
        if name
    }
    truth = mean_quantities(simulation, preparation.ensemble)
    return Prepared(
        recorded=recorded,
        preparation=preparation,
        excerpt=excerpt(simulation.recording),
        ensemble=preparation.ensemble,
        over_time=over_time | {f"truth quantity {name}": each for name, each in truth.items()},
    )


def draw(prepared: Prepared, analysis: Analysis, seed: int, number: int) -> tuple[Ensemble, Truth]:
    """Return the realizations of a bootstrap, and their recorded torque as the truth."""
    ensemble, is_block = prepared.ensemble, analysis.method.contiguous
    if ensemble is None:
        raise InputError(prepared.failure)
    count = len(ensemble)
    # All draws come from one random sequence, so the draws before this one are made, too.
    weights = bootstrap_weights(count, analysis.realizations, number + 1, seed, is_block)
    drawn = ensemble.select(np.repeat(np.arange(count), weights[number]))
    return drawn, Truth(drawn.torque[:, drawn.core])


def tasks_of(experiment: Experiment, prepared: Sequence[Prepared]) -> list[Task]:
    """Return a task for each analysis of a recording.

    Tasks of the last methods come first, because these take longest.
    """
    tasks = []
    for analysis, item in itertools.product(reversed(experiment.analyses), prepared):
        seed = experiment.seed_of(item.recorded, analysis.realizations)
        sent = attrs.evolve(item, preparation=None, excerpt=None)
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
    rate = experiment.preparation["rate"]
    results = dataset_of(measured, coordinates, rate, experiment=experiment.to_json())
    unknown = dict.fromkeys(RECORDED_OVER_TIME, np.full(results.sizes["time"], np.nan))
    facts = [{**unknown, **item.over_time, **_preparation_of(item)} for item in prepared]
    of_recordings = labelled(facts, {"recording": prepared})
    return results.merge(of_recordings, join="left").transpose("recording", "analysis", ...)


def _preparation_of(prepared: Prepared) -> Scores:
    """Return what became of a recording, by the names of variables."""
    preparation = prepared.preparation
    excluded_by = preparation.table.excluded_by.tolist() if preparation else []
    counts = {name: excluded_by.count(step) for name, step in COUNTED.items()}
    facts = {**counts, "recorded": len(excluded_by), "remarks": "\n".join(prepared.remarks)}
    return {name: np.array(value) for name, value in facts.items()}
