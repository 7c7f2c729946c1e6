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

NOTHING = "nothing"  # digest of a recording that could not be prepared
EXCERPT_S = 10.0  # duration of the part of a recording that is drawn
TORQUE, PATHWAY = "tvsysid: recorded torque", "tvsysid: pathway "
"""Channels that pass through the preparation: torque before its mean is lost, and pathways."""


@attrs.frozen(eq=False, kw_only=True)
class Prepared:
    """One recording, ready for identification.

    Parameters
    ----------
    recorded
        The participant and perturbation.
    ensemble
        Kept realizations, mean subtracted, with the channels that methods need; None if there are
        none.
    table
        Table of :class:`~tvsysid.preprocess.Preparation`; None if nothing could be prepared.
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
    alignment
        Effect of the shifts on stiffness.
    """

    recorded: Recorded
    ensemble: Ensemble | None = None
    table: pd.DataFrame | None = None
    target_torque: Array
    mean_torque: Array
    truth: Mapping[str, Array] = attrs.field(factory=dict)
    pathways: Mapping[str, Array] = attrs.field(factory=dict)
    trials: int = 0
    refused: Mapping[str, str] = attrs.field(factory=dict)
    warnings: tuple[str, ...] = ()
    failure: str = ""
    alignment: AlignmentEffect = UNKNOWN

    @property
    def remarks(self) -> tuple[str, ...]:
        """Trials that are left out, doubts and failure, in words."""
        left_out = (f"{name} is left out: {reason}" for name, reason in self.refused.items())
        return (*left_out, *self.warnings, *([self.failure] if self.failure else []))

    @property
    def digest(self) -> str:
        """Hash of the ensemble, whatever object holds it."""
        ensemble = self.ensemble
        if ensemble is None:
            return NOTHING
        cut = ensemble.angle.shape, ensemble.sampling_rate, ensemble.context
        digest = hashlib.sha256(repr((*cut, ensemble.mean_subtracted)).encode())
        for values in (ensemble.angle, ensemble.torque, ensemble.onsets, ensemble.trials):
            digest.update(np.asarray(values).tobytes())
        channels = dict(ensemble.channels)
        if ensemble.recorded_angle is not None:
            channels["recorded_angle"] = ensemble.recorded_angle
        for name, channel in channels.items():
            digest.update(name.encode() + channel.tobytes())
        return digest.hexdigest()[:16]


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


def shown(experiment: Experiment, recorded: Recorded) -> tuple[Recording, Preparation]:
    """Return an excerpt of a recording and its preparation, for figures.

    Raises
    ------
    InputError
        If the recording cannot be read or prepared.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataQualityWarning)  # reported when it was prepared
        recording, _ = _read(experiment, recorded, _simulate(recorded))
        preparation = _preparation(experiment, recording)
    return excerpt(recording, experiment.preparation.reference), preparation


def _prepare(experiment: Experiment, recorded: Recorded) -> Prepared:
    preparing = experiment.preparation
    unknown = np.full(round(preparing.period * preparing.rate), np.nan)
    prepared = Prepared(recorded=recorded, target_torque=unknown, mean_torque=unknown)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataQualityWarning)
        try:
            simulation = _simulate(recorded)
            recording, refused = _read(experiment, recorded, simulation)
            prepared = attrs.evolve(prepared, trials=len(recording.trials), refused=refused)
            preparation = _preparation(experiment, recording)
            prepared = _with_ensemble(prepared, experiment, preparation, simulation)
            _warn_of_few(len(preparation.ensemble), experiment)
        except (InputError, MemoryError) as error:
            failure = str(error) or "there is not enough memory"
            prepared = attrs.evolve(prepared, failure=failure)
    texts = dict.fromkeys(str(item.message) for item in caught)
    return attrs.evolve(prepared, warnings=tuple(texts))


def _warn_of_few(count: int, experiment: Experiment) -> None:
    most = max(analysis.realizations for analysis in experiment.analyses)
    if most > count:
        warnings.warn(
            f"{most} realizations are drawn from {count}: they vary less than so many recorded "
            f"ones would; draw {count} at most",
            DataQualityWarning,
            stacklevel=2,
        )


def _with_ensemble(
    prepared: Prepared,
    experiment: Experiment,
    preparation: Preparation,
    simulation: Simulation | None,
) -> Prepared:
    """Return a recording with its kept realizations, and what is known of them."""
    ensemble, methods = preparation.ensemble, experiment.named_methods.values()
    channels = dict(ensemble.channels)
    cores = {name: np.asarray(values[:, ensemble.core]) for name, values in channels.items()}
    truth = {} if simulation is None else simulation.truth_of(ensemble)
    inputs = {item.name for method in methods for item in method.inputs}
    is_rectified = any(method.uses_recorded_angle for method in methods)
    reference = experiment.preparation.reference
    return attrs.evolve(
        prepared,
        ensemble=attrs.evolve(
            ensemble,
            channels={name: values for name, values in channels.items() if name in inputs},
            recorded_angle=ensemble.recorded_angle if is_rectified else None,
        ),
        table=preparation.table,
        target_torque=cores[reference].mean(axis=0)
        if reference in cores
        else prepared.target_torque,
        mean_torque=cores[TORQUE].mean(axis=0),
        truth={name: values.mean(axis=0) for name, values in truth.items()},
        pathways={
            name.removeprefix(PATHWAY): torque - torque.mean(axis=0)
            for name, torque in cores.items()
            if name.startswith(PATHWAY)
        },
        alignment=effect_of_alignment(preparation),
    )


def _preparation(experiment: Experiment, recording: Recording) -> Preparation:
    centered = set(centered_channels(experiment.named_methods.values())) & set(recording.channels)
    return prepare(recording, **attrs.asdict(experiment.preparation), channels=sorted(centered))


def _simulate(recorded: Recorded) -> Simulation | None:
    if not recorded.is_virtual:
        return None
    return Participant(recorded.number).simulate(perturbation=PERTURBATIONS[recorded.perturbation])


def _read(
    experiment: Experiment, recorded: Recorded, simulation: Simulation | None
) -> tuple[Recording, dict[str, str]]:
    """Return all usable trials as one recording, and why others cannot be used.

    Raises an InputError if there is none.
    """
    channels: dict[str, Array] = {}
    refused: dict[str, str] = {}
    if simulation is not None:
        recording, methods = simulation.recording, experiment.named_methods.values()
        if any(len(method.pathway_names) > 1 for method in methods):
            channels = {PATHWAY + name: torque for name, torque in simulation.pathways.items()}
    else:
        assert experiment.reading is not None
        preparing, reference = experiment.preparation, experiment.preparation.reference
        files, missing = _files(experiment.folder, recorded.files)
        target = {} if reference is None else {reference: reference}
        reading = attrs.evolve(
            experiment.reading, channels=target | dict(experiment.reading.channels)
        )
        usable = read_usable_trials(files, reading, 2 * preparing.ends + preparing.period)
        refused = missing | usable.refused
        if usable.recording is None:
            reasons = "; ".join(f"{name}: {reason}" for name, reason in refused.items())
            raise InputError(f"no trial can be used: {reasons}")
        recording = usable.recording
    channels = {**recording.channels, TORQUE: recording.torque} | channels
    return attrs.evolve(recording, channels=channels), refused


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
    count = min(round(EXCERPT_S * recording.sampling_rate), trial.stop - trial.start)
    first = trial.start + (trial.stop - trial.start - count) // 2
    part = slice(first, first + count)
    target = {} if reference is None else {"target": recording.channels[reference][part]}
    return Recording(
        recording.angle[part], recording.torque[part], recording.sampling_rate, channels=target
    )
