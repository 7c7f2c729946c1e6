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
from tvsysid.simulate import PERTURBATIONS, Participant
from tvsysid.study.experiment import Experiment, Recorded

EXCERPT_S = 10.0  # duration of the part of a recording that is drawn


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
    target_torque, mean_torque
        Target, and mean torque of the kept realizations, in N·m, shape (time,); NaN if unknown.
    preparation, excerpt
        What was done to the recording, and ten seconds of it; None if nothing could be prepared.
    ensemble
        Kept realizations, mean subtracted, with the channels that methods need; None if there are
        none.
    reference
        Channel that a method takes as the applied disturbance, if any.
    truth
        Quantities of a simulation: means over the kept realizations, shape (time,).
    pathways
        Noiseless torques of a simulation, mean subtracted, shape (realization, time).
    """

    recorded: Recorded
    remarks: tuple[str, ...] = ()
    failure: str = ""
    target_torque: Array
    mean_torque: Array
    preparation: Preparation | None = None
    excerpt: Recording | None = None
    ensemble: Ensemble | None = None
    reference: str | None = None
    truth: Mapping[str, Array] = attrs.field(factory=dict)
    pathways: Mapping[str, Array] = attrs.field(factory=dict)

    @property
    def digest(self) -> str:
        """Hash of the ensemble; that of None if there is none."""
        return hashlib.sha256(pickle.dumps(self.ensemble)).hexdigest()[:16]


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
    settings, failure = experiment.preparation, ""
    nothing = np.full(round(settings["period"] * settings["rate"]), np.nan)
    found: dict[str, Any] = {"target_torque": nothing, "mean_torque": nothing}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataQualityWarning)
        try:
            read = _read if recorded.files else _simulate
            found |= read(experiment, recorded)
        except InputError as error:
            failure = str(error)
    texts = dict.fromkeys(str(each.message) for each in caught)
    remarks = (*texts, *([failure] if failure else []))
    return Prepared(recorded=recorded, remarks=remarks, failure=failure, **found)


def _simulate(experiment: Experiment, recorded: Recorded) -> dict[str, Any]:
    """Return the kept realizations of a virtual participant, and what is known of them."""
    simulation = Participant(recorded.number).simulate(
        perturbation=PERTURBATIONS[recorded.perturbation]
    )
    found = _prepared(experiment, simulation.recording, simulation.pathways)
    ensemble = found["preparation"].ensemble
    truth = simulation.truth_of(ensemble).items()
    return found | {
        "truth": {name: values.mean(axis=0) for name, values in truth},
        "pathways": {
            name: np.asarray(ensemble.signal(name)[:, ensemble.core])
            for name in simulation.pathways
        },
    }


def _read(experiment: Experiment, recorded: Recorded) -> dict[str, Any]:
    """Return the kept realizations of all usable trials. Warn of trials that cannot be used.

    Raise an InputError if there is none.
    """
    reading, settings = experiment.reading, experiment.preparation
    assert reading is not None
    files = {
        str(Path(name)): Path(experiment.folder, name)
        for pattern in map(os.path.expanduser, recorded.files)
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
    return _prepared(experiment, trials.recording, {})


def _prepared(
    experiment: Experiment, recording: Recording, further: Mapping[str, Array]
) -> dict[str, Any]:
    """Return the kept realizations of a recording, and signals of them.

    ``further`` channels lose their mean as the torque does.
    """
    settings, methods = experiment.preparation, experiment.named_methods.values()
    centered = sorted(set(centered_channels(methods)) & set(recording.channels))
    every = attrs.evolve(recording, channels={**recording.channels, **further})
    preparation = prepare(every, **settings, channels=[*centered, *further])
    ensemble = preparation.ensemble
    *_, aligned = preparation.recorded, *(step.ensemble for step in preparation.steps.values())
    inputs = [
        each for method in methods for each in method.inputs if each.name in recording.channels
    ]
    references = {each.name for each in inputs if each.kind == "reference"}
    is_rectified = any(method.uses_recorded_angle for method in methods)
    if (most := max(each.realizations for each in experiment.analyses)) > (count := len(ensemble)):
        text = (
            f"{most} realizations are drawn from {count}: they vary less than so many recorded "
            f"ones would; draw {count} at most"
        )
        warnings.warn(text, DataQualityWarning, stacklevel=2)
    found = {
        "preparation": preparation,
        "excerpt": excerpt(recording, settings["reference"]),
        "ensemble": attrs.evolve(
            ensemble,
            channels={
                name: ensemble.channels[name] for name in sorted({each.name for each in inputs})
            },
            recorded_angle=ensemble.recorded_angle if is_rectified else None,
        ),
        "reference": min(references, default=None),
        "mean_torque": aligned.torque[:, aligned.core].mean(axis=0),
    }
    if settings["reference"] in ensemble.channels:
        target = ensemble.signal(settings["reference"])[:, ensemble.core]
        found["target_torque"] = target.mean(axis=0)
    return found


def excerpt(recording: Recording, reference: str | None = "target") -> Recording:
    """Return ten seconds from the middle of the first trial, with the target torque if any."""
    trial, length = recording.trials[0], round(EXCERPT_S * recording.sampling_rate)
    first = max(trial.start, (trial.start + trial.stop - length) // 2)
    part = slice(first, min(first + length, trial.stop))
    target = recording.channels.get(str(reference))
    return Recording(
        recording.angle[part],
        recording.torque[part],
        recording.sampling_rate,
        recording.time[first],
        channels={} if target is None else {"target": target[part]},
    )
