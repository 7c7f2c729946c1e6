"""Prepare files, or a virtual participant, for identification."""

from __future__ import annotations

import glob
import hashlib
import os
import pickle
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import attrs
import numpy as np

from tvsysid.errors import DataQualityWarning, InputError
from tvsysid.methods import centered_channels
from tvsysid.numerics.threads import single_thread
from tvsysid.preprocess import Preparation, prepare
from tvsysid.progress import Progress, no_progress
from tvsysid.recordings import read_usable_trials
from tvsysid.signals import Array, Ensemble, Recording
from tvsysid.simulate import PERTURBATIONS, Participant, Simulation
from tvsysid.study.experiment import Experiment, Recorded

EXCERPT_S = 10.0  # duration of the part of a recording that is drawn
PATHWAY = "tvsysid: pathway "  # channels that pass through the preparation beside those recorded


@attrs.frozen(eq=False, kw_only=True)
class Prepared:
    """One recording, ready for identification.

    Parameters
    ----------
    recorded
        The participant and perturbation.
    preparation, excerpt
        What was done to the recording, and ten seconds of it; None if nothing could be prepared.
    ensemble
        Kept realizations, mean subtracted, with the channels that methods need; None if there are
        none.
    reference
        Channel that a method takes as the applied disturbance, if any.
    target_torque, mean_torque
        Target, and mean torque of the kept realizations, in N·m, shape (time,); NaN if unknown.
    truth
        Quantities of a simulation: means over the kept realizations, shape (time,).
    pathways
        Noiseless torques of a simulation, mean subtracted, shape (realization, time).
    trials
        Number of usable trials.
    refused
        Why other trials cannot be used, by file.
    warnings, failure
        Doubts, and why nothing could be prepared.
    """

    recorded: Recorded
    preparation: Preparation | None = None
    excerpt: Recording | None = None
    ensemble: Ensemble | None = None
    reference: str | None = None
    target_torque: Array
    mean_torque: Array
    truth: Mapping[str, Array] = attrs.field(factory=dict)
    pathways: Mapping[str, Array] = attrs.field(factory=dict)
    trials: int = 0
    refused: Mapping[str, str] = attrs.field(factory=dict)
    warnings: tuple[str, ...] = ()
    failure: str = ""

    @property
    def remarks(self) -> tuple[str, ...]:
        """Trials that are left out, doubts and failure, in words."""
        left_out = (f"{name} is left out: {reason}" for name, reason in self.refused.items())
        return (*left_out, *self.warnings, *([self.failure] if self.failure else []))

    @property
    def digest(self) -> str:
        """Hash of the ensemble; empty if there is none."""
        if self.ensemble is None:
            return ""
        parts = attrs.asdict(self.ensemble, recurse=False)
        parts["channels"] = dict(parts["channels"])
        return hashlib.sha256(pickle.dumps(parts)).hexdigest()[:16]


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
    settings = experiment.preparation
    nothing = np.full(round(settings["period"] * settings["rate"]), np.nan)
    found: dict[str, Any] = {"target_torque": nothing, "mean_torque": nothing}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataQualityWarning)
        try:
            simulation = None
            if recorded.files:
                recording, found["refused"] = _read(experiment, recorded)
            else:
                perturbation = PERTURBATIONS[recorded.perturbation]
                simulation = Participant(recorded.number).simulate(perturbation=perturbation)
                recording = simulation.recording
            found["trials"] = len(recording.trials)
            found |= _prepared(experiment, recording, simulation)
        except InputError as error:
            found["failure"] = str(error)
    doubts = [str(item.message) for item in caught]
    most = max(analysis.realizations for analysis in experiment.analyses)
    if "ensemble" in found and most > (count := len(found["ensemble"])):
        doubts.append(
            f"{most} realizations are drawn from {count}: they vary less than so many recorded "
            f"ones would; draw {count} at most"
        )
    return Prepared(recorded=recorded, warnings=tuple(dict.fromkeys(doubts)), **found)


def _read(experiment: Experiment, recorded: Recorded) -> tuple[Recording, dict[str, str]]:
    """Return all usable trials as one recording, and why others cannot be used.

    Raises an InputError if there is none.
    """
    folder, settings = experiment.folder, experiment.preparation
    files: dict[Path, str] = {}
    missing = {}
    # Files are called by their place in the folder, which may be moved with all that is in it
    for pattern in map(os.path.expanduser, recorded.files):
        is_file = (folder / pattern).is_file()  # with brackets in its name, perhaps
        matches = glob.glob(pattern, root_dir=folder, recursive=True)
        found = [pattern] if is_file else sorted(matches)
        if not found:
            missing[pattern] = "no file has such a name, beside the study or where the name says"
        for name in found:
            files.setdefault((folder / name).resolve(), name)
    assert experiment.reading is not None
    reference, channels = settings["reference"], experiment.reading.channels
    target = {} if reference is None else {reference: reference}
    usable = read_usable_trials(
        {name: folder / name for name in files.values()},
        attrs.evolve(experiment.reading, channels=target | dict(channels)),
        2 * settings["ends"] + settings["period"],
    )
    refused = missing | usable.refused
    if usable.recording is None:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in refused.items())
        raise InputError(f"no trial can be used: {reasons}")
    return usable.recording, refused


def _prepared(
    experiment: Experiment, recording: Recording, simulation: Simulation | None
) -> dict[str, Any]:
    """Return the kept realizations of a recording, and what is known of them."""
    settings, methods = experiment.preparation, experiment.named_methods.values()
    known = {} if simulation is None else simulation.pathways
    pathways = {PATHWAY + name: torque for name, torque in known.items()}
    every = attrs.evolve(recording, channels={**recording.channels, **pathways})
    centered = sorted(set(centered_channels(methods)) & set(recording.channels))
    preparation = prepare(every, **settings, channels=centered)
    ensemble, inputs = preparation.ensemble, [each for method in methods for each in method.inputs]
    *_, aligned = preparation.recorded, *(step.ensemble for step in preparation.steps.values())
    cores = {name: values[:, ensemble.core] for name, values in ensemble.channels.items()}
    needed = ensemble.channels.keys() & {each.name for each in inputs}
    references = needed & {each.name for each in inputs if each.kind == "reference"}
    is_rectified = any(method.uses_recorded_angle for method in methods)
    found = {
        "preparation": preparation,
        "excerpt": excerpt(recording, settings["reference"]),
        "ensemble": attrs.evolve(
            ensemble,
            channels={name: ensemble.channels[name] for name in sorted(needed)},
            recorded_angle=ensemble.recorded_angle if is_rectified else None,
        ),
        "reference": min(references, default=None),
        "mean_torque": aligned.torque[:, aligned.core].mean(axis=0),
        "pathways": {
            name: cores[PATHWAY + name] - cores[PATHWAY + name].mean(axis=0) for name in known
        },
    }
    if simulation is not None:
        truth = simulation.truth_of(ensemble)
        found["truth"] = {name: values.mean(axis=0) for name, values in truth.items()}
    if settings["reference"] in cores:
        found["target_torque"] = cores[settings["reference"]].mean(axis=0)
    return found


def excerpt(recording: Recording, reference: str | None) -> Recording:
    """Return ten seconds from the middle of the first trial, with the target torque."""
    trial = recording.trials[0]
    count = min(round(EXCERPT_S * recording.sampling_rate), trial.stop - trial.start)
    first = trial.start + (trial.stop - trial.start - count) // 2
    part = slice(first, first + count)
    target = {} if reference is None else {"target": recording.channels[reference][part]}
    return Recording(
        recording.angle[part], recording.torque[part], recording.sampling_rate, channels=target
    )
