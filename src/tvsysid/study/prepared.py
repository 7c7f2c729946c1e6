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
from tvsysid.study.measure import mean_quantities

TORQUE = "torque as it was recorded"  # channel that keeps its mean
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
    preparation, excerpt
        What was done to the recording, and ten seconds of it; None if nothing could be prepared.
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
    failure, found = "", {}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataQualityWarning)
        try:
            if recorded.files:
                found = _from_recording(experiment, _read(experiment, recorded), {})
            else:
                found = _from_simulation(experiment, recorded)
        except InputError as error:
            failure = str(error)
    texts = dict.fromkeys(str(each.message) for each in caught)
    remarks = (*texts, *([failure] if failure else []))
    return Prepared(recorded=recorded, remarks=remarks, failure=failure, **found)


def _from_simulation(experiment: Experiment, recorded: Recorded) -> dict[str, Any]:
    """Return the kept realizations of a virtual participant, and what is known of them."""
    simulation = Participant(recorded.number).simulate(
        perturbation=PERTURBATIONS[recorded.perturbation]
    )
    found = _from_recording(experiment, simulation.recording, simulation.pathways)
    for name, values in mean_quantities(simulation, found["ensemble"]).items():
        found["over_time"][f"truth quantity {name}"] = values
    return found


def _read(experiment: Experiment, recorded: Recorded) -> Recording:
    """Return all usable trials. Warn of trials that cannot be used.

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
    return trials.recording


def _from_recording(
    experiment: Experiment,
    recording: Recording,
    pathways: Mapping[str, Array],
) -> dict[str, Any]:
    """Return the kept realizations of a recording, and what is known of them.

    The torques of pathways are prepared with the recording, and kept apart from it.
    """
    settings, methods = experiment.preparation, experiment.named_methods.values()
    own, reference = recording.channels, settings["reference"]
    centered = sorted(set(centered_channels(methods)) & set(own))
    further = {**pathways, TORQUE: recording.torque}
    every = attrs.evolve(recording, channels={**own, **further})
    preparation = prepare(every, **settings, channels=[*centered, *pathways])
    ensemble = preparation.ensemble
    signals = {name: ensemble.signal(name)[:, ensemble.core] for name in ensemble.channels}
    over_time = {"mean_torque": signals[TORQUE].mean(axis=0)}
    if reference in signals:
        over_time["target_torque"] = signals[reference].mean(axis=0)
    return {
        "preparation": preparation,
        "over_time": over_time,
        "excerpt": excerpt(recording, str(reference)),
        "ensemble": attrs.evolve(
            ensemble, channels={name: ensemble.channels[name] for name in own}
        ),
        "pathways": {name: np.asarray(signals[name]) for name in pathways},
    }


def excerpt(recording: Recording, reference: str = "target") -> Recording:
    """Return ten seconds from the middle of the first trial, with the target torque if any."""
    trial, own = recording.trials[0], recording.channels
    length = min(round(EXCERPT_S * recording.sampling_rate), trial.stop)
    first = (trial.stop - length) // 2
    part = slice(first, first + length)
    channels = {"target": own[reference][part]} if reference in own else {}
    return Recording(
        recording.angle[part],
        recording.torque[part],
        recording.sampling_rate,
        recording.time[first],
        channels=channels,
    )
