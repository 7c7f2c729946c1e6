"""Prepare files, or a virtual participant, for identification."""

from __future__ import annotations

import glob
import hashlib
import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

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
from tvsysid.study.alignment import UNKNOWN, AlignmentEffect, effect_of_alignment
from tvsysid.study.experiment import Experiment, Recorded

if TYPE_CHECKING:
    import pandas as pd

NOTHING = "nothing"  # digest of what could not be prepared, for whatever reason
EXCERPT = 10.0  # seconds of a recording that are shown
TORQUE, PATHWAY = "tvsysid: recorded torque", "tvsysid: pathway "
"""Channels that pass through the preparation: torque before its mean is lost, and pathways."""


@attrs.frozen(eq=False)
class Prepared:
    """One recording, ready for identification.

    ``ensemble`` holds the kept realizations, mean subtracted, with the channels that methods need,
    ``account`` the table of :class:`~tvsysid.preprocess.Preparation`. Both are None where nothing
    could be prepared, and ``failure`` says why. The target torque and the mean torque of the kept
    realizations are over one realization, in N·m, shape (time,); NaN if unknown. ``truth`` has
    their means of a simulation's quantities by name; ``pathways`` the noiseless torques that the
    experiment measures, shape (realization, time), without mean. ``trials`` is the number of usable
    trials, ``refused`` says why others cannot be used, by file, and ``warnings`` names doubts.
    ``alignment`` is the effect of the shifts on stiffness.
    """

    recorded: Recorded
    ensemble: Ensemble | None
    account: pd.DataFrame | None
    target_torque: Array
    mean_torque: Array
    truth: dict[str, Array]
    pathways: Mapping[str, Array]
    trials: int
    refused: dict[str, str]
    warnings: tuple[str, ...]
    failure: str = ""
    alignment: AlignmentEffect = UNKNOWN

    @property
    def remarks(self) -> tuple[str, ...]:
        """All that should be known about it, in words."""
        left_out = (f"{name} is left out: {reason}" for name, reason in self.refused.items())
        return (*left_out, *self.warnings, *([self.failure] if self.failure else []))

    @property
    def digest(self) -> str:
        """Digest of the ensemble; other data have another one."""
        return NOTHING if self.ensemble is None else _digest(self.ensemble)


def _digest(ensemble: Ensemble) -> str:
    """Return a checksum of the data, whatever object holds them."""
    cut = ensemble.angle.shape, ensemble.sampling_rate, ensemble.context, ensemble.mean_subtracted
    found = hashlib.sha256(repr(cut).encode())
    for values in (ensemble.angle, ensemble.torque, ensemble.onsets, ensemble.trials):
        found.update(np.asarray(values).tobytes())
    recorded = (
        {} if ensemble.recorded_angle is None else {"recorded_angle": ensemble.recorded_angle}
    )
    for name, values in (dict(ensemble.channels) | recorded).items():
        found.update(name.encode() + values.tobytes())
    return found.hexdigest()[:16]


def prepared_recordings(
    experiment: Experiment, progress: Progress = no_progress
) -> tuple[Prepared, ...]:
    """Prepare every recording of an experiment; what cannot be used spoils nothing else.

    ``progress`` is called with the numbers of recordings done and in all.
    """
    done: list[Prepared] = []
    for recorded in experiment.recordings:
        progress(len(done), len(experiment.recordings))
        with single_thread():  # so that the same recordings have the same digest everywhere
            done.append(_prepared(experiment, recorded))
    return tuple(done)


def shown(experiment: Experiment, recorded: Recorded) -> tuple[Recording, Preparation]:
    """Return an excerpt of a recording and its preparation, for figures.

    Raises if it cannot be read or prepared.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)  # told when it was prepared
        recording, _ = _recording(experiment, recorded, _simulated(recorded))
        return excerpt(recording, experiment.preparation.reference), _preparation(
            experiment, recording
        )


def _prepared(experiment: Experiment, recorded: Recorded) -> Prepared:
    samples = round(experiment.preparation.period * experiment.preparation.rate)
    unknown = np.full(samples, np.nan)
    refused: dict[str, str] = {}
    trials, failure, preparation = 0, "", None
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataQualityWarning)
        try:
            simulation = _simulated(recorded)
            recording, refused = _recording(experiment, recorded, simulation)
            trials = len(recording.trials)
            preparation = _preparation(experiment, recording)
        except (InputError, MemoryError) as error:
            failure = str(error) or "there is not enough memory"
    warned = tuple(dict.fromkeys(str(item.message) for item in caught))
    if preparation is None:
        return Prepared(
            recorded, None, None, unknown, unknown, {}, {}, trials, refused, warned, failure
        )
    ensemble = preparation.ensemble

    def over_time(name: str | None) -> Array:
        """Return the mean of a channel over the kept realizations."""
        if name is None or name not in ensemble.channels:
            return unknown
        return np.asarray(ensemble.channels[name][:, ensemble.core].mean(axis=0))

    truth = {} if simulation is None else simulation.truth_of(ensemble)
    truth = {name: values.mean(axis=0) for name, values in truth.items()}
    cores = {
        name.removeprefix(PATHWAY): np.asarray(torque[:, ensemble.core])
        for name, torque in ensemble.channels.items()
        if name.startswith(PATHWAY)
    }
    pathways = {name: torque - torque.mean(axis=0) for name, torque in cores.items()}
    wanted = {item.name for method in experiment.named_methods.values() for item in method.inputs}
    needed = [name for name in ensemble.channels if name in wanted]
    rectified = any(method.uses_recorded_angle for method in experiment.named_methods.values())
    return Prepared(
        recorded=recorded,
        ensemble=attrs.evolve(
            ensemble,
            channels={name: ensemble.channels[name] for name in needed},
            recorded_angle=ensemble.recorded_angle if rectified else None,
        ),
        account=preparation.table,
        target_torque=over_time(experiment.preparation.reference),
        mean_torque=over_time(TORQUE),
        truth=truth,
        pathways=pathways,
        trials=trials,
        refused=refused,
        warnings=warned,
        alignment=effect_of_alignment(preparation),
    )


def _preparation(experiment: Experiment, recording: Recording) -> Preparation:
    deviating = set(centered_channels(experiment.named_methods.values())) & set(recording.channels)
    return prepare(recording, **attrs.asdict(experiment.preparation), channels=sorted(deviating))


def _simulated(recorded: Recorded) -> Simulation | None:
    if not recorded.is_virtual:
        return None
    return Participant(recorded.number).simulate(perturbation=PERTURBATIONS[recorded.perturbation])


def _recording(
    experiment: Experiment, recorded: Recorded, simulation: Simulation | None
) -> tuple[Recording, dict[str, str]]:
    """Return all usable trials as one recording, and why others cannot be used.

    Raises if there is none.
    """
    if simulation is not None:
        methods = experiment.named_methods.values()
        several = any(len(method.pathway_names) > 1 for method in methods)
        pathways = simulation.pathways if several else {}
        beside = {PATHWAY + name: torque for name, torque in pathways.items()}
        return _with_torque(simulation.recording, beside), {}
    assert experiment.reading is not None
    preparing = experiment.preparation
    files, missing = _files(experiment.folder, recorded.files)
    channels = {} if preparing.reference is None else {preparing.reference: preparing.reference}
    channels |= experiment.reading.channels
    reading = attrs.evolve(experiment.reading, channels=channels)
    shortest = 2 * preparing.ends + preparing.period
    usable = read_usable_trials(files, reading, shortest)
    refused = missing | usable.refused
    if usable.recording is None:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in refused.items())
        raise InputError(f"no trial can be used: {reasons}")
    return _with_torque(usable.recording, {}), refused


def _with_torque(recording: Recording, beside: dict[str, Array]) -> Recording:
    return attrs.evolve(
        recording, channels={**recording.channels, TORQUE: recording.torque} | beside
    )


def _files(folder: Path, patterns: tuple[str, ...]) -> tuple[dict[str, Path], dict[str, str]]:
    """Return the files that match patterns, each once, by name, and the patterns without a match.

    Files are called by their place in the folder, which may be moved with all that is in it.
    """
    files: dict[Path, str] = {}
    missing = {}
    for pattern in map(os.path.expanduser, patterns):
        if not glob.has_magic(pattern) or (folder / pattern).is_file():
            found = [pattern]
        else:
            root = None if Path(pattern).is_absolute() else folder
            found = sorted(glob.glob(pattern, root_dir=root, recursive=True))
        if not found:
            missing[pattern] = (
                "no file has such a name, in the folder of the study or where the name says"
            )
        for name in found:
            files.setdefault((folder / name).resolve(), name)
    return {name: folder / name for name in files.values()}, missing


def excerpt(recording: Recording, reference: str | None) -> Recording:
    """Return ten seconds from the middle of the first trial, with the target torque."""
    trial = recording.trials[0]
    count = min(round(EXCERPT * recording.sampling_rate), trial.stop - trial.start)
    first = trial.start + (trial.stop - trial.start - count) // 2
    part = slice(first, first + count)
    target = {} if reference is None else {"target": recording.channels[reference][part]}
    return Recording(
        recording.angle[part], recording.torque[part], recording.sampling_rate, channels=target
    )
