"""Prepare files, or a virtual participant, for identification."""

from __future__ import annotations

import glob
import hashlib
import os
import pickle
import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path

import attrs

from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.methods import centered_channels
from tvsysid.numerics.threads import single_thread
from tvsysid.preprocess import Preparation, excerpt, prepare
from tvsysid.progress import Progress, no_progress
from tvsysid.recordings import read_usable_trials
from tvsysid.signals import Array, Ensemble, Recording
from tvsysid.simulate import PERTURBATIONS, Participant, Simulation
from tvsysid.study.experiment import Experiment, Recorded
from tvsysid.study.measure import separate_truth


@attrs.frozen(eq=False, kw_only=True)
class Prepared:
    """One recording, ready for identification.

    Parameters
    ----------
    recorded
        The participant and perturbation.
    remarks, failure
        Trials that are left out, warnings, and why nothing could be prepared, in words. The failure
        is the last of the remarks; empty if there is none.
    preparation, excerpt
        What was done to the recording, and ten seconds of it, whose channel ``target`` is drawn;
        None if nothing could be prepared.
    ensemble
        Kept realizations, mean subtracted; None if there are none.
    over_time
        Means over the kept realizations, each of shape (time,): ``target_torque`` and
        ``mean_torque`` in N·m, and quantities of a simulation (``"truth quantity stiffness"``).
    pathways
        Noiseless torques of a simulation, mean subtracted, shape (realization, time).
    """

    recorded: Recorded
    remarks: tuple[str, ...] = ()
    failure: str = ""
    preparation: Preparation | None = None
    excerpt: Recording | None = None
    ensemble: Ensemble | None = None
    over_time: Mapping[str, Array] = attrs.field(factory=dict)
    pathways: Mapping[str, Array] = attrs.field(factory=dict)

    @property
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
            else:  # nothing is known of a person
                simulation = Simulation(_read(experiment, source), truth={}, pathways={})
            prepared = _of_simulation(experiment, recorded, simulation)
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
    channels = dict(reading.channels)
    if (target := settings["reference"]) is not None:
        channels.setdefault(target, target)
    shortest = 2 * settings["ends"] + settings["period"]
    trials = read_usable_trials(files, attrs.evolve(reading, channels=channels), shortest)
    for name, reason in trials.unusable.items():
        warnings.warn(f"{name} is left out: {reason}", DataQualityWarning, stacklevel=2)
    if trials.recording is None:
        raise InputError("no trial can be used")
    return trials.recording


def _of_simulation(experiment: Experiment, recorded: Recorded, simulation: Simulation) -> Prepared:
    """Return the kept realizations, and apart from them what is known of the joint."""
    recording, pathways = simulation.recording, simulation.pathways
    settings, own = experiment.preparation, recording.channels
    centered = centered_channels([each.method for each in experiment.analyses])
    every = attrs.evolve(recording, channels={**own, **pathways})
    channels = [*sorted(own.keys() & set(centered)), *pathways]
    preparation = prepare(every, **settings, channels=channels)
    *_, kept = preparation.recorded, *(step.ensemble for step in preparation.steps.values())
    means = {"mean_torque": "torque", "target_torque": settings["reference"]}
    over_time = {
        variable: kept.signal(name)[:, kept.core].mean(axis=0)
        for variable, name in means.items()
        if name
    }
    ensemble, truth = separate_truth(simulation, preparation.ensemble)
    return Prepared(
        recorded=recorded,
        preparation=preparation,
        excerpt=excerpt(recording),
        ensemble=ensemble,
        over_time=over_time | truth.scores,
        pathways=truth.pathways,
    )
